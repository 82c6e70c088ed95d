"""Running a network on the CPU: an ONNX file with our metadata, through onnxruntime."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import (
    ENDS_CHANNELS,
    Point,
    encode_ends,
    encode_gaussian,
)
from nnpp_edge.runtime.network.model_file import (
    METADATA_KEY,
    ModelMetadata,
    model_errors,
    model_path,
    open_session,
    read_metadata,
)
from nnpp_edge.runtime.network.place_head import ANSWERS, PlaceHead, count_parameters
from nnpp_edge.runtime.tuning import TWO_THREADS_FROM

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, SessionOptions

__all__ = ["METADATA_KEY", "OUTPUT", "ModelMetadata", "NetworkModel", "model_path"]

OUTPUT, PLACES, HEAD = "probability", "places", "head"
"""Names of the outputs; the last two are those of networks in two parts (`place_head`)."""
ASK = "ask"
"""Name of their input that says whether the head is to run, too."""
QUERY_SPACING = 8
"""Network cells between the points of an encoded query."""
DEFAULT_THREADS = 2
_ROUNDING = 1e-4
"""How far the head's answer may lie from its graph's, which adds in another order."""
Shapes = dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class _Loaded:
    """What networks that share a session have in common."""

    path: Path
    session: "InferenceSession"
    metadata: ModelMetadata
    inputs: Shapes
    outputs: Shapes
    opened_with: tuple[int, bool]
    """Threads and spinning."""
    head_parameters: NDArray[np.float32] | None = None


class NetworkModel:
    """A network ready to run, with inputs and outputs of its own. Serves one thread at a time.

    Parameters
    ----------
    model : str or Path
        Name of a shipped model, or an ONNX file with our metadata.
    threads : int
        Of onnxruntime; by default two for inputs of 256 and more (one where the process may use one core only),
        and one for smaller ones, which two threads do not make faster.
    spinning : bool
        Whether onnxruntime's threads spin after a run. They would take the cores from the search.

    Raises
    ------
    ModelError
        The file is missing, truncated, without our metadata, or its inputs do not fit the metadata. While it answers:
        its graph fails.
    """

    def __init__(self, model: str | Path = "edge", *, threads: int | None = None, spinning: bool = False) -> None:
        path = model_path(model)
        cores = min(DEFAULT_THREADS, len(os.sched_getaffinity(0)))
        metadata = read_metadata(path)
        if threads is None:
            threads = 1 if metadata.input_size < TWO_THREADS_FROM else cores
        session = open_session(path, _options(threads, spinning))
        with model_errors(path, "got one that does not fit its metadata"):
            shapes = _checked_shapes(path, session, metadata)
            self._bind(_Loaded(path, session, metadata, *shapes, (threads, spinning)))
            if metadata.encoding == "ends":
                self._split()

    def __reduce__(self) -> "tuple[Callable[[Path, int, bool], NetworkModel], tuple[Path, int, bool]]":
        """A copy opens the file again, and has been shown nothing."""
        return _reopened, (self.path, *self._loaded.opened_with)

    def share(self) -> "NetworkModel":
        """Another network on the same session: it has a map, a query and an answer of its own."""
        other = NetworkModel.__new__(type(self))
        other._bind(self._loaded)
        return other

    def set_map(self, planes: NDArray[np.float32]) -> None:
        """Show the network a map: (2, S, S) float32, mean cost and share of impassable cells, both in [0, 1]."""
        m = self.metadata
        self._encoded = False
        if m.encoding == "gaussian":
            self.inputs["input"][0, 0] = planes[0]
            return
        side, n = m.input_size // m.map_unshuffle, m.map_unshuffle
        parts = planes.reshape(2, side, n, side, n).transpose(0, 2, 4, 1, 3)
        self.inputs["map"][0] = parts.reshape(2 * n * n, side, side)

    def set_query(self, start: Point, goal: Point) -> None:
        """Show the network start and goal, (row, col) in network cells."""
        m = self.metadata
        sigma = m.sigma * m.input_size
        if m.encoding == "gaussian":
            encode_gaussian(start, goal, m.input_size, 1, sigma, self._query[1:])
        else:
            encode_ends(start, goal, m.input_size // QUERY_SPACING, QUERY_SPACING, sigma, self._query)

    def run(self, *, anew: bool = False) -> Float2D:
        """The probability that a nearly optimal path passes: (B, B) float32 in [0, 1]. The next call overwrites it.

        The encoder of a network in two parts runs only once after `set_map`, but with `anew`, for timing, again.
        """
        if self._head is None:
            self._infer()
            return self._in_place()
        self._encode(self._head, anew)
        self._head.answer(self._query, self._answer)
        return self._answer

    def answer(self, start: Point, goal: Point) -> Float2D:
        """`set_query` and `run`; for a network in two parts in one call of compiled code."""
        if self._head is None:
            self.set_query(start, goal)
            return self.run()
        self._encode(self._head)
        sigma = self.metadata.sigma * self.metadata.input_size
        self._head.answer_ends(start, goal, float(QUERY_SPACING), sigma, self._query, self._answer)
        return self._answer

    @property
    def in_parts(self) -> bool:
        """Whether the network describes the map by itself, before it knows the query."""
        return self._head is not None

    def _bind(self, loaded: _Loaded) -> None:
        """Allocate inputs and outputs once, of the shapes that the metadata implies, and bind them."""
        self._loaded, self.path = loaded, loaded.path
        self.session, self.metadata = loaded.session, loaded.metadata
        self.inputs: dict[str, NDArray[np.float32 | np.bool_]] = {
            name: np.ones(shape, np.bool_) if name == ASK else np.zeros(shape, np.float32)
            for name, shape in loaded.inputs.items()
        }
        self._outputs = {name: np.zeros(shape, np.float32) for name, shape in loaded.outputs.items()}
        self._query: NDArray[np.float32] = self.inputs.get("query", next(iter(self.inputs.values())))[0]
        self._binding = self.session.io_binding()
        for name, array in self.inputs.items():
            self._binding.bind_input(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        for name, output in self._outputs.items():
            self._binding.bind_output(name, "cpu", 0, np.float32, output.shape, output.ctypes.data)
        self._head: PlaceHead | None = None
        self._encoded = False
        if loaded.head_parameters is not None:
            self._use_head(loaded.head_parameters)

    def _use_head(self, parameters: NDArray[np.float32]) -> None:
        """From now on the session runs the encoder alone, and only when the map changes."""
        self.inputs[ASK][:] = False
        m = self.metadata
        self._head = PlaceHead(parameters, m.head, m.input_size // QUERY_SPACING)
        self._answer = np.empty((m.blocks, m.blocks), np.float32)

    def _split(self) -> None:
        """Read the head's parameters, and see that they answer what the graph does."""
        rng = np.random.default_rng(0)
        self.inputs["map"][:] = rng.random(self.inputs["map"].shape)
        far = float(self.metadata.input_size - 1)
        self.set_query((0.3 * far, 0.0), (far, 0.6 * far))
        self._infer()
        wanted, parameters, known = self._in_place(), self._outputs[HEAD].copy(), self._loaded
        self._use_head(parameters)
        if not np.abs(self.run(anew=True) - wanted).max() <= _ROUNDING:
            raise ModelError(f"{self.path}: the head's parameters are not those of its graph")
        self._loaded = replace(known, head_parameters=parameters)

    def _encode(self, head: PlaceHead, anew: bool = False) -> None:
        if anew or not self._encoded:
            self._infer()
            head.places[:] = self._outputs[PLACES].reshape(head.places.shape[1], -1).T
            self._encoded = True

    def _infer(self) -> None:
        """Run the session; ModelError where its graph fails."""
        with model_errors(self.path, "got one whose graph fails"):
            self.session.run_with_iobinding(self._binding)

    def _in_place(self) -> Float2D:
        """The session's answer with each block where it lies."""
        n, blocks = self.metadata.output_shuffle, self.metadata.blocks
        side = blocks // n
        return self._outputs[OUTPUT].reshape(n, n, side, side).transpose(2, 0, 3, 1).reshape(blocks, blocks)


def _reopened(path: Path, threads: int, spinning: bool) -> NetworkModel:
    return NetworkModel(path, threads=threads, spinning=spinning)


def _options(threads: int, spinning: bool) -> "SessionOptions":
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = True
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning else "0")
    return options


def _checked_shapes(path: Path, session: "InferenceSession", m: ModelMetadata) -> tuple[Shapes, Shapes]:
    """Shapes of inputs and outputs by the metadata; ModelError where the graph has others."""
    size, places = m.input_size, m.input_size // QUERY_SPACING
    inputs: Shapes = {"input": (1, 3, size, size)}
    if m.encoding != "gaussian":
        side = size // m.map_unshuffle
        inputs = {"map": (1, 2 * m.map_unshuffle**2, side, side), "query": (1, ENDS_CHANNELS, places, places)}
    side = m.blocks // m.output_shuffle
    outputs: Shapes = {OUTPUT: (1, m.output_shuffle**2, side, side)}
    if m.encoding == "ends":
        inputs[ASK] = (1,)
        outputs |= {PLACES: (1, 2 * m.head[0], places, places), HEAD: (count_parameters(m.head),)}
    got = {i.name: tuple(i.shape) for i in session.get_inputs()}
    if got != inputs:
        raise ModelError(f"{path}: wanted inputs {inputs} by its metadata, got {got}")
    if m.encoding == "ends" and (m.output_shuffle**2 != ANSWERS or side != places):
        raise ModelError(
            f"{path}: wanted two by two blocks to each of {places} × {places} places, "
            f"got {m.blocks} to a side, {m.output_shuffle} by {m.output_shuffle}"
        )
    got = {o.name: tuple(o.shape) for o in session.get_outputs()}
    if got != outputs:
        raise ModelError(f"{path}: wanted outputs {outputs} by its metadata, got {got}")
    return inputs, outputs
