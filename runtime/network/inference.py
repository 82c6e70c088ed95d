"""Running a network on the CPU: an ONNX file with our metadata, through onnxruntime."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.deadline import Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import Point, encode_ends, encode_gaussian
from nnpp_edge.runtime.network.loading import (
    ASK,
    HEAD,
    OUTPUT,
    PLACES,
    QUERY_SPACING,
    LoadedModel,
    blocks_in_place,
    opened,
    places_in_rows,
)
from nnpp_edge.runtime.network.model_file import METADATA_KEY, ModelMetadata, model_errors, model_path
from nnpp_edge.runtime.network.place_head import PlaceHead

__all__ = ["ASK", "HEAD", "METADATA_KEY", "OUTPUT", "PLACES", "ModelMetadata", "NetworkModel", "model_path"]

_FORGET = 0.9


class NetworkModel:
    """A network ready to run, with inputs and outputs of its own. Serves one thread at a time.

    A file is opened once in a process, and again when it has changed: networks of the same file, threads and spinning
    share a session. In a forked child a session of several threads, which the child lacks, is opened again.

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

    @checked(ModelError)
    def __init__(self, model: str | Path = "edge", *, threads: int | None = None, spinning: bool = False) -> None:
        self.path = model_path(model)
        """Of the file."""
        loaded, self.waited = opened(self.path, threads, spinning)
        """Whether the file had to be opened, or was just being opened by another thread."""
        self._bind(loaded)

    def __reduce__(self) -> "tuple[Callable[[Path, int, bool], NetworkModel], tuple[Path, int, bool]]":
        """A copy opens the file again, and has been shown nothing."""
        return _reopened, (self.path, self._loaded.threads, self._loaded.spinning)

    def share(self) -> "NetworkModel":
        """Another network on the same session: it has a map, a query and an answer of its own."""
        other = NetworkModel.__new__(type(self))
        other.path, other.waited = self.path, False
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

    def check_time(self, deadline: Deadline) -> None:
        """OutOfTimeError where an answer needs a run, whose fastest so far took longer than there is time left.

        Each time a tenth is taken off what is expected, so that one slow run does not count for ever.
        """
        if not self._encoded and deadline.left_s <= self._loaded.fastest_s:
            self._loaded.fastest_s *= _FORGET
            raise OutOfTimeError

    def _bind(self, loaded: LoadedModel) -> None:
        """Allocate inputs and outputs once, of the shapes that the metadata implies, and bind them."""
        self.metadata = m = loaded.metadata
        self.inputs: dict[str, NDArray[np.float32 | np.bool_]] = {
            name: np.zeros(shape, np.bool_ if name == ASK else np.float32) for name, shape in loaded.inputs.items()
        }
        self._outputs = {name: np.zeros(shape, np.float32) for name, shape in loaded.outputs.items()}
        self._query: NDArray[np.float32] = self.inputs.get("query", next(iter(self.inputs.values())))[0]
        self._use_session(loaded)
        self._head: PlaceHead | None = None
        self._encoded = False
        if loaded.head_parameters is not None:
            self._head = PlaceHead(loaded.head_parameters, m.head, m.input_size // QUERY_SPACING)
            self._answer = np.empty((m.blocks, m.blocks), np.float32)

    def _use_session(self, loaded: LoadedModel) -> None:
        """Bind inputs and outputs to this session; of a network in two parts it runs the encoder alone."""
        self._loaded, self.session = loaded, loaded.session
        self._binding = self.session.io_binding()
        for name, array in self.inputs.items():
            self._binding.bind_input(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        for name, output in self._outputs.items():
            self._binding.bind_output(name, "cpu", 0, np.float32, output.shape, output.ctypes.data)

    def _encode(self, head: PlaceHead, anew: bool = False) -> None:
        if anew or not self._encoded:
            self._infer()
            head.places[:] = places_in_rows(self._outputs[PLACES])
            self._encoded = True

    def _infer(self) -> None:
        """Run the session; ModelError where its graph fails."""
        if self._loaded.lacks_threads():
            self._open_again()
        began = time.perf_counter()
        with model_errors(self.path, "got one whose graph fails"):
            self.session.run_with_iobinding(self._binding)
        self._loaded.fastest_s = min(time.perf_counter() - began, self._loaded.fastest_s or math.inf)

    def _open_again(self) -> None:
        """Take a session of this process; ModelError where the file is another by now."""
        loaded, _ = opened(self.path, self._loaded.threads, self._loaded.spinning)
        if loaded.identity != self._loaded.identity:
            raise ModelError(
                f"{self.path}: wanted the file that was opened before this process was forked, got another"
            )
        self._use_session(loaded)

    def _in_place(self) -> Float2D:
        """The session's answer with each block where it lies."""
        return blocks_in_place(self._outputs[OUTPUT], self.metadata)


def _reopened(path: Path, threads: int, spinning: bool) -> NetworkModel:
    return NetworkModel(path, threads=threads, spinning=spinning)
