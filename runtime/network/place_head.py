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


def layers_of(parameters: Floats, sizes: tuple[int, ...]) -> tuple[Floats, ...]:
    """The matrices of `parameter_shapes`, of a head whose (N,) parameters stand in a row."""
    shapes = parameter_shapes(sizes)
    parts = np.split(parameters, np.cumsum([inputs * outputs for inputs, outputs in shapes])[:-1])
    return tuple(part.reshape(shape).copy() for part, shape in zip(parts, shapes, strict=True))


class PlaceHead:
    """The head of these layers, for places in a square of `side`."""

    def __init__(self, layers: tuple[Floats, ...], side: int) -> None:
        self._layers = layers
        relation, (first, second) = layers[0].shape[1], layers[6].shape
        self._places: Floats = np.zeros((side * side, 2 * relation), np.float32)
        needed = (3, side**2, relation), (side**2 + 1, first), (side**2, second), (side**2, ANSWERS)
        self._scratch = tuple(np.empty(shape, np.float32) for shape in needed)

    def describe(self, places: Floats) -> None:
        """Take over the encoder's two descriptions of each place: (1, 2R, P, P) float32."""
        self._places[:] = places.reshape(places.shape[1], -1).T

    def answer(self, start: Point, goal: Point, sigma: float, query: Floats, out: Floats) -> None:
        """Probabilities, (2P, 2P) float32, into `out`, and into `query` what `encode_ends` writes."""
        state = self._places, query, self._layers, self._scratch
        answer_ends((*start, *goal), float(QUERY_SPACING), sigma, *state, out)
