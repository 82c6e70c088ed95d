"""Running a network on the CPU: an ONNX file with our metadata, through onnxruntime."""

import functools
from collections.abc import Callable
from pathlib import Path
from weakref import finalize

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D, Planes, in_blocks
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.network.encoding import Point, encode_gaussian
from nnpp_edge.runtime.network.loading import OUTPUT, PLACES, Bound, LoadedModel, opened
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.network.place_head import PlaceHead
from nnpp_edge.runtime.reading import refused_as


class NetworkModel:
    """A network ready to run, with its own inputs and outputs. For one thread at a time.

    A file is opened once in a process, and again when it has changed: networks of the same file and
    threads share a session. A copy opens the file again, and has been shown nothing. A child that
    was forked lacks the threads of a session: only networks of one thread go on there.

    Parameters
    ----------
    model : str or Path
        Name of a shipped model, or an ONNX file with our metadata.
    threads : int
        Of onnxruntime; by default two for inputs of 256 and more (one where the process may use one
        core only), and one for smaller ones, which two threads do not make faster.

    Raises
    ------
    ModelError
        The file is missing, truncated, without our metadata, or its inputs do not fit the metadata.
        While it answers: its graph fails.
    """

    @checked(ModelError)
    def __init__(self, model: str | Path = "edge", *, threads: int | None = None) -> None:
        self.path = model_path(model)
        """Of the file."""
        loaded, self.waited = opened(self.path, threads)
        """Whether the file had to be opened, or was just being opened by another thread, which no
        query has told of yet.
        """
        self._bind(loaded)

    def __reduce__(self) -> "tuple[Callable[[Path], NetworkModel], tuple[Path]]":
        return functools.partial(NetworkModel, threads=self._loaded.threads), (self.path,)

    def share(self) -> "NetworkModel":
        """Another network on the same session: it has a map, a query and an answer of its own."""
        other = NetworkModel.__new__(type(self))
        other.path = self.path
        other.waited = False
        other._bind(self._loaded)
        return other

    def set_map(self, planes: Planes) -> None:
        """Show the network a map: (2, S, S) float32, mean cost and share of impassable cells, both
        in [0, 1].
        """
        self._encoded = False
        if self.metadata.encoding == "unseen":
            raise ModelError(
                f"{self.path}: wanted a network that answers queries, got one that prices unseen "
                "ground"
            )
        if self._head is None:
            self.inputs["input"][0, 0] = planes[0]
            return
        _, channels, side, _ = self.inputs["map"].shape
        parts = in_blocks(planes, planes.shape[1] // side).transpose(0, 2, 4, 1, 3)
        self.inputs["map"][0] = parts.reshape(channels, side, side)

    def answer(self, start: Point, goal: Point, *, anew: bool = False) -> Float2D:
        """The probability that a nearly optimal path passes: (B, B) float32 in [0, 1]. The next
        call overwrites it.

        For timing, `anew` runs the encoder of a network in two parts, too, which is else run once
        after `set_map`.
        """
        sigma = self.metadata.sigma * self.metadata.input_size
        if self._head is None:
            encode_gaussian(start, goal, sigma, self.inputs["input"][0, 1:])
            self._infer()
        else:
            if anew or not self._encoded:
                self._infer()
                self._encoded = True
            self._head.answer(start, goal, sigma, self._answer)
        return self._answer

    def answers(self) -> Planes:
        """Of a network that prices unseen ground, for its input: (3, S, S) float32, until the next
        call.
        """
        self._infer()
        answers: Planes = self._outputs[OUTPUT][0]
        return answers

    def try_out(self) -> None:
        """Answer some query by all of the network: ModelError where its graph fails."""
        if self.metadata.encoding == "unseen":
            self.answers()
        else:
            self.answer((0.0, 0.0), (1.0, 1.0), anew=True)

    @property
    def in_parts(self) -> bool:
        """Whether the network describes the map by itself, before it knows the query."""
        return self._head is not None

    def _bind(self, loaded: LoadedModel) -> None:
        """Take inputs and outputs of the shapes that the metadata implies."""
        self._loaded = loaded
        self.metadata = m = loaded.metadata
        self.session = loaded.session
        try:
            bound = loaded.idle.pop()
        except IndexError:
            bound = _bound(loaded)
        self.inputs, self._outputs, self._binding = bound
        self._encoded = False
        self._head: PlaceHead | None = None
        if loaded.head is None:
            self._answer: Float2D = self._outputs[OUTPUT][0, 0]
        else:
            self._head = PlaceHead(loaded.head, self._outputs[PLACES])
            self._answer = np.empty((m.blocks, m.blocks), np.float32)
            finalize(self, loaded.idle.append, bound)

    def _infer(self) -> None:
        """Run the session; ModelError where its graph fails."""
        with refused_as(
            ModelError, f"{self.path}: wanted an ONNX model, got one whose graph fails"
        ):
            self.session.run_with_iobinding(self._binding)


def _bound(loaded: LoadedModel) -> Bound:
    """New inputs and outputs of a network."""
    session = loaded.session
    inputs, outputs = (
        {value.name: np.zeros(value.shape, np.float32) for value in values}
        for values in (session.get_inputs(), session.get_outputs())
    )
    binding = session.io_binding()
    for name, array in inputs.items():
        binding.bind_cpu_input(name, array)
    for name, array in outputs.items():
        binding.bind_output(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
    return inputs, outputs, binding
