"""The head of a network in two parts: the answer to a query from the encoder's description of each
place.

onnxruntime runs the encoder when the map changes. A query takes a quarter of a million
multiplications, less than a call of onnxruntime costs, so they are done here. The ONNX file holds
the head too, for whoever runs it alone.
"""

import math

import numpy as np

from nnpp_edge.runtime.arrays import Planes
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS, answer_ends
from nnpp_edge.runtime.network.encoding import Point
from nnpp_edge.runtime.network.model_file import QUERY_SPACING


def parameter_shapes(sizes: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Matrices of a head in their order, as (inputs, outputs); those of one input are biases.

    `sizes` are the numbers that relate a place to an end, and the units of the two hidden layers.
    """
    relation, first, second = sizes
    way = ((END_CHANNELS - 1, relation), (1, relation))
    relations = ((relation, first), (1, first), (relation, first))
    layers = (first, second), (1, second), (second, ANSWERS), (1, ANSWERS)
    return *way, *relations, (BETWEEN_CHANNELS, first), *layers


def count_parameters(sizes: tuple[int, ...]) -> int:
    """How many numbers a head of these sizes has in all."""
    return sum(inputs * outputs for inputs, outputs in parameter_shapes(sizes))


class PlaceHead:
    """The head of these sizes, for places in a square of `side`; `parameters` (N,) float32 as
    `parameter_shapes`, which are kept and may be written until the first answer.
    """

    def __init__(self, parameters: Planes, sizes: tuple[int, ...], side: int) -> None:
        shapes = parameter_shapes(sizes)
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = np.split(parameters, ends[:-1])
        self._matrices = tuple(map(np.reshape, parts, shapes))
        self._places: Planes = np.zeros((side * side, 2 * sizes[0]), np.float32)

    def describe(self, places: Planes) -> None:
        """Take over the encoder's two descriptions of each place: (1, 2R, P, P) float32."""
        self._places[:] = places.reshape(places.shape[1], -1).T

    def answer(self, start: Point, goal: Point, sigma: float, query: Planes, out: Planes) -> None:
        """Probabilities, (2P, 2P) float32, into `out`, and into `query` what
        `encode_ends` writes.
        """
        ends = (*start, *goal)
        spacing = float(QUERY_SPACING)
        answer_ends(ends, spacing, sigma, self._places, query, self._matrices, out)
