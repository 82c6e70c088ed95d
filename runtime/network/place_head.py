"""The head of a network in two parts: the answer to a query from the encoder's description of each place.

onnxruntime runs the encoder when the map changes. A query takes a quarter of a million multiplications, less than a
call of onnxruntime costs, so they are done here. The ONNX file holds the head too; both are compared at load.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS, answer_ends
from nnpp_edge.runtime.network.encoding import Point
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

Floats = NDArray[np.float32]


def parameter_shapes(sizes: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Matrices of a head in their order, as (inputs, outputs); those of one input are biases.

    `sizes` are the numbers that relate a place to an end, and the units of the two hidden layers.
    """
    relation, first, second = sizes
    way, relations = ((END_CHANNELS - 1, relation), (1, relation)), ((relation, first), (1, first), (relation, first))
    layers = (first, second), (1, second), (second, ANSWERS), (1, ANSWERS)
    return *way, *relations, (BETWEEN_CHANNELS, first), *layers


def count_parameters(sizes: tuple[int, ...]) -> int:
    """How many numbers a head of these sizes has in all."""
    return sum(inputs * outputs for inputs, outputs in parameter_shapes(sizes))


class PlaceHead:
    """The head's parameters and scratch memory, for places in a square of `side`.

    `parameters` are (N,) float32, all of `parameter_shapes` in a row.
    """

    def __init__(self, parameters: Floats, sizes: tuple[int, ...], side: int) -> None:
        relation, first, second = sizes
        self.places: Floats = np.zeros((side * side, 2 * relation), np.float32)
        """The encoder's two descriptions of each place."""
        self._parameters, self._units = np.array(parameters, np.float32), (first, second)
        self._scratch = np.empty(2 * side * side * relation + 3 * max(first, second, relation), np.float32)

    def answer(self, start: Point, goal: Point, sigma: float, query: Floats, out: Floats) -> None:
        """Probabilities, (2 · side, 2 · side) float32, into `out`, and into `query` what `encode_ends` writes."""
        state = self.places, query, self._parameters, self._units, self._scratch
        answer_ends((*start, *goal), float(QUERY_SPACING), sigma, *state, out)
