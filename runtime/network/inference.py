"""Running a network on the CPU: an ONNX file with our metadata, through onnxruntime."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import ENDS_CHANNELS, PAIR_CHANNELS, encode_ends, encode_gaussian, encode_pair
from nnpp_edge.runtime.network.model_file import METADATA_KEY, ModelMetadata, model_path, open_session
from nnpp_edge.runtime.network.place_head import ANSWERS, PlaceHead, count_parameters

__all__ = ["METADATA_KEY", "OUTPUT", "ModelMetadata", "NetworkModel", "model_path"]

OUTPUT, PLACES, HEAD = "probability", "places", "head"
"""Names of the outputs; the last two are those of networks in two parts (`place_head`)."""
ASK = "ask"
"""Name of their input that says whether the head is to run, too."""
QUERY_SPACING = 8
"""Network cells between the points of an encoded query."""
DEFAULT_THREADS = 2
_SIZE_FOR_TWO = 256
"""Input from which on two threads are faster than one."""
_ROUNDING = 1e-4
"""How far the head's answer may lie from its graph's, which adds in another order."""


def _options(threads: int, spinning: bool) -> Any:
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = True
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning else "0")
    return options


class NetworkModel:
    """A network ready to run. Serves one thread at a time.

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
        The file is missing, truncated, without our metadata, or its inputs do not fit the metadata.
    """

    def __init__(self, model: str | Path = "edge", *, threads: int | None = None, spinning: bool = False) -> None:
        self.path = model_path(model)
        cores = min(DEFAULT_THREADS, len(os.sched_getaffinity(0)))
        self.session = open_session(self.path, _options(threads or cores, spinning))
        text = self.session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        self.metadata = ModelMetadata.from_json(text, str(self.path))
        if threads is None and cores > 1 and self.metadata.input_size < _SIZE_FOR_TWO:
            self.session = open_session(self.path, _options(1, spinning))
        self.owner: object = None
        """Whose map was taken over last; for planners that share a model."""
        self._head: PlaceHead | None = None
        self._encoded = False
        self._bind()
        if self.metadata.encoding == "ends":
            self._split()

    def _bind(self) -> None:
        """Allocate inputs and outputs once, of the shapes that the metadata implies, and bind them."""
        m = self.metadata
        size, unshuffle, shuffle = m.input_size, m.map_unshuffle, m.output_shuffle
        self._query_side = size // QUERY_SPACING
        shapes: dict[str, tuple[int, ...]]
        if m.encoding == "gaussian":
            shapes = {"input": (1, 3, size, size)}
        else:
            side, channels = size // unshuffle, PAIR_CHANNELS if m.encoding == "pair" else ENDS_CHANNELS
            shapes = {
                "map": (1, 2 * unshuffle**2, side, side),
                "query": (1, channels, self._query_side, self._query_side),
            }
        if m.encoding == "ends":
            shapes[ASK] = (1,)
        got = {i.name: tuple(i.shape) for i in self.session.get_inputs()}
        if got != shapes:
            raise ModelError(f"{self.path}: wanted inputs {shapes} by its metadata, got {got}")
        side = m.blocks // shuffle
        wanted: dict[str, tuple[int, ...]] = {OUTPUT: (1, shuffle**2, side, side)}
        if m.encoding == "ends":
            if shuffle**2 != ANSWERS or side != self._query_side:
                raise ModelError(
                    f"{self.path}: wanted two by two blocks to each of {self._query_side} × {self._query_side} "
                    f"places, got {m.blocks} to a side, {shuffle} by {shuffle}"
                )
            wanted[PLACES] = (1, 2 * m.head[0], self._query_side, self._query_side)
            wanted[HEAD] = (count_parameters(m.head),)
        outputs = {o.name: tuple(o.shape) for o in self.session.get_outputs()}
        if outputs != wanted:
            raise ModelError(f"{self.path}: wanted outputs {wanted} by its metadata, got {outputs}")
        self.inputs: dict[str, NDArray[Any]] = {
            name: np.ones(shape, bool) if name == ASK else np.zeros(shape, np.float32)
            for name, shape in shapes.items()
        }
        self._query: NDArray[np.float32] = self.inputs.get("query", next(iter(self.inputs.values())))[0]
        self._outputs = {name: np.zeros(shape, np.float32) for name, shape in wanted.items()}
        self._binding = self.session.io_binding()
        for name, array in self.inputs.items():
            self._binding.bind_input(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        for name, array in self._outputs.items():
            self._binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)

    def _split(self) -> None:
        """From now on ask the session for the encoder's part alone, and only when the map changes."""
        rng = np.random.default_rng(0)
        self.inputs["map"][:] = rng.random(self.inputs["map"].shape)
        far = float(self.metadata.input_size - 1)
        self.set_query((0.3 * far, 0.0), (far, 0.6 * far))
        self.session.run_with_iobinding(self._binding)
        wanted = self._in_place()
        self.inputs[ASK][:] = False
        self._head = PlaceHead(self._outputs[HEAD], self.metadata.head, self._query_side)
        self._answer = np.empty_like(wanted)
        if not np.abs(self.run(anew=True) - wanted).max() <= _ROUNDING:
            raise ModelError(f"{self.path}: the head's parameters are not those of its graph")

    def set_map(self, planes: NDArray[np.float32]) -> None:
        """Take over a map: (2, S, S) float32, mean cost and share of impassable cells, both in [0, 1]."""
        m = self.metadata
        self._encoded, self.owner = False, None
        if m.encoding == "gaussian":
            self.inputs["input"][0, 0] = planes[0]
            return
        side, n = m.input_size // m.map_unshuffle, m.map_unshuffle
        parts = planes.reshape(2, side, n, side, n).transpose(0, 2, 4, 1, 3)
        self.inputs["map"][0] = parts.reshape(2 * n * n, side, side)

    def set_query(self, start: tuple[float, float], goal: tuple[float, float]) -> None:
        """Take over start and goal, (row, col) in network cells."""
        m = self.metadata
        sigma = m.sigma * m.input_size
        if m.encoding == "gaussian":
            encode_gaussian(start, goal, m.input_size, 1, sigma, self.inputs["input"][0, 1:])
        else:
            encode = encode_pair if m.encoding == "pair" else encode_ends
            encode(start, goal, self._query_side, QUERY_SPACING, sigma, self._query)

    def run(self, *, anew: bool = False) -> NDArray[np.float32]:
        """The probability that a nearly optimal path passes: (B, B) float32 in [0, 1]. The next call overwrites it.

        A network in two parts looks at the map only once after `set_map`, but with `anew`, for timing, again.
        """
        if self._head is None:
            self.session.run_with_iobinding(self._binding)
            return self._in_place()
        self._encode(self._head, anew)
        self._head.answer(self._query, self._answer)
        return self._answer

    def ask(self, start: tuple[float, float], goal: tuple[float, float]) -> NDArray[np.float32]:
        """`set_query` and `run` of a network in two parts (`in_parts`), in one call of compiled code."""
        assert self._head is not None
        self._encode(self._head)
        sigma = self.metadata.sigma * self.metadata.input_size
        self._head.answer_ends(start, goal, float(QUERY_SPACING), sigma, self._query, self._answer)
        return self._answer

    @property
    def in_parts(self) -> bool:
        """Whether the network looks at the map by itself, before it knows the query."""
        return self._head is not None

    def _encode(self, head: PlaceHead, anew: bool = False) -> None:
        if anew or not self._encoded:
            self.session.run_with_iobinding(self._binding)
            head.places[:] = self._outputs[PLACES].reshape(head.places.shape[1], -1).T
            self._encoded = True

    def _in_place(self) -> NDArray[np.float32]:
        """The session's answer with each block where it lies."""
        n, blocks = self.metadata.output_shuffle, self.metadata.blocks
        side = blocks // n
        return self._outputs[OUTPUT].reshape(n, n, side, side).transpose(2, 0, 3, 1).reshape(blocks, blocks)
