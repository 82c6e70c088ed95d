"""Running a network on the CPU: an ONNX file with our metadata, through onnxruntime."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.encoding import encode_gaussian, encode_pair
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.model_file import METADATA_KEY, ModelMetadata, model_path, open_session

__all__ = ["METADATA_KEY", "OUTPUT", "ModelMetadata", "NetworkModel", "model_path"]

OUTPUT = "probability"
DEFAULT_THREADS = 2
_SIZE_FOR_TWO = 256
"""Input from which on two threads are faster than one."""


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
        self._bind()

    def _bind(self) -> None:
        """Allocate inputs and output once, of the shapes that the metadata implies, and bind them."""
        m = self.metadata
        size, unshuffle, shuffle = m.input_size, m.map_unshuffle, m.output_shuffle
        self._query_side = size // 8
        shapes: dict[str, tuple[int, ...]]
        if m.encoding == "gaussian":
            shapes = {"input": (1, 3, size, size)}
        else:
            side = size // unshuffle
            shapes = {
                "map": (1, 2 * unshuffle**2, side, side),
                "query": (1, 3, self._query_side, self._query_side),
            }
        got = {i.name: tuple(i.shape) for i in self.session.get_inputs()}
        if got != shapes:
            raise ModelError(f"{self.path}: wanted inputs {shapes} by its metadata, got {got}")
        side = m.blocks // shuffle
        wanted = (1, shuffle**2, side, side)
        outputs = {o.name: tuple(o.shape) for o in self.session.get_outputs()}
        if outputs != {OUTPUT: wanted}:
            raise ModelError(f"{self.path}: wanted the output {OUTPUT} {wanted} by its metadata, got {outputs}")
        self.inputs = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
        self._output = np.zeros(wanted, np.float32)
        self._binding = self.session.io_binding()
        for name, array in self.inputs.items():
            self._binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self._binding.bind_output(OUTPUT, "cpu", 0, np.float32, wanted, self._output.ctypes.data)

    def set_map(self, planes: NDArray[np.float32]) -> None:
        """Take over a map: (2, S, S) float32, mean cost and share of impassable cells, both in [0, 1]."""
        m = self.metadata
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
            spacing = m.input_size // self._query_side
            encode_pair(start, goal, self._query_side, spacing, sigma, self.inputs["query"][0])

    def run(self) -> NDArray[np.float32]:
        """The probability that a nearly optimal path passes: (B, B) float32 in [0, 1]."""
        self.session.run_with_iobinding(self._binding)
        n, blocks = self.metadata.output_shuffle, self.metadata.blocks
        side = blocks // n
        return self._output.reshape(n, n, side, side).transpose(2, 0, 3, 1).reshape(blocks, blocks)
