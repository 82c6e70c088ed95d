"""Running a passage network: of one file every vehicle gets a network of its own."""

import functools
import threading
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidMapError, ModelError
from nnpp_edge.runtime.network.model_file import model_errors, model_path, read_passage
from nnpp_edge.runtime.network.passage import NUMBERS, shown_numbers, unsuited, vehicle_numbers
from nnpp_edge.runtime.terrain.vehicle import Vehicle

DEFAULT = "passage"
BLOCKS, OUTPUT, VEHICLE = "blocks", "answers", "vehicle"
"""Names of the input, of the output, and of the initializer that holds the vehicle's numbers."""
ANSWER_STEPS, ANSWER_MIDDLE = 16, 128
"""Answers are logits in bytes: steps to a logit of 1, and the byte of 0."""
KEPT = 4
"""Vehicles' networks that a process keeps open."""


class VehicleNetwork:
    """The network of one vehicle on cells of one size. Any thread may call it.

    Parameters
    ----------
    content : bytes
        Of the model's file.
    numbers : (12,) float32
        The vehicle's, see `shown_numbers`.
    path : Path
        The file, for messages.
    """

    def __init__(self, content: bytes, numbers: NDArray[np.float32], path: Path) -> None:
        import onnxruntime as ort

        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        with model_errors(path, "got a file that does not load"):
            self._session = ort.InferenceSession(
                with_vehicle(content, numbers, path), options, ["CPUExecutionProvider"]
            )

    def answers(self, blocks: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(R, C, 16) bytes of (19, R, C) blocks, see `model.passage` and `logits`."""
        found: NDArray[np.uint8] = self._session.run([OUTPUT], {BLOCKS: blocks[None]})[0][0]
        return found


def logits(answers: NDArray[np.uint8]) -> NDArray[np.float32]:
    """What answers stand for: (16, R, C) float32, from -8 up to below 8."""
    steps = answers.astype(np.float32).transpose(2, 0, 1) - ANSWER_MIDDLE
    return np.ascontiguousarray(steps / np.float32(ANSWER_STEPS))


class PassageModel:
    """A passage network's file, for any vehicle in the range that it was trained for.

    Parameters
    ----------
    model : str or Path
        Name of a shipped model, or a file.

    Raises
    ------
    ModelError
        The file cannot be read.
    """

    def __init__(self, model: str | Path = DEFAULT) -> None:
        self._path = model_path(model)
        self._content = read_passage(self._path)
        self._lock = threading.Lock()
        self._of = functools.lru_cache(KEPT)(self._opened)

    def of(self, vehicle: Vehicle, sides_m: tuple[float, float]) -> VehicleNetwork:
        """The vehicle's network on cells of this height and width; InvalidMapError outside the trained range."""
        if problem := unsuited(vehicle, sides_m):
            raise InvalidMapError(f"price='network' {problem}: wanted another price, such as 'eq1'")
        with self._lock:
            return self._of(tuple(shown_numbers(vehicle_numbers(vehicle, sides_m)).tolist()))

    def _opened(self, numbers: tuple[float, ...]) -> VehicleNetwork:
        return VehicleNetwork(self._content, np.array(numbers, np.float32), self._path)


@functools.cache
def passage_model() -> PassageModel:
    """The shipped one."""
    return PassageModel()


def with_vehicle(content: bytes, numbers: NDArray[np.float32], path: Path) -> bytes:
    """A model's file with these numbers in place of those that stand in it. ModelError where there is no place."""
    name, size = VEHICLE.encode(), 4 * len(NUMBERS)
    before = b"\x42" + bytes([len(name)]) + name + b"\x4a" + bytes([size])  # name and content of a TensorProto
    at = content.find(before)
    if at < 0 or content.find(before, at + 1) >= 0:
        raise ModelError(f"{path}: wanted a passage network, got a file without one place for a vehicle's numbers")
    at += len(before)
    return content[:at] + np.ascontiguousarray(numbers, "<f4").tobytes() + content[at + size :]
