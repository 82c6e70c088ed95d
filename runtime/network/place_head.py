"""The head of a network in two parts: the answer to a query from the encoder's description of each place.

onnxruntime runs the encoder when the map changes. A query then takes a quarter of a million multiplications, less
than a call of onnxruntime costs where its code has left the caches; so they are done here. The ONNX file holds the
head too, and a test at load sees that both say the same.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.place_head import ANSWERS, answer_ends, answer_query
from nnpp_edge.runtime.network.encoding import BETWEEN_CHANNELS, END_CHANNELS, Point

__all__ = ["ANSWERS", "PlaceHead", "count_parameters", "parameter_shapes"]

Floats = NDArray[np.float32]


def parameter_shapes(sizes: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the head's parameters in their order; matrices are (inputs, outputs).

    `sizes` are the numbers that relate a place to an end, and the units of the two hidden layers.
    """
    relation, first, second = sizes
    return {
        "way": (END_CHANNELS - 1, relation),
        "way_bias": (relation,),
        "both": (relation, first),
        "both_bias": (first,),
        "across": (relation, first),
        "between": (BETWEEN_CHANNELS, first),
        "mix": (first, second),
        "mix_bias": (second,),
        "answer": (second, ANSWERS),
        "answer_bias": (ANSWERS,),
    }


def count_parameters(sizes: tuple[int, ...]) -> int:
    """How many numbers a head of these sizes has in all."""
    return sum(math.prod(shape) for shape in parameter_shapes(sizes).values())


class PlaceHead:
    """The head's parameters and scratch memory, for places in a square of `side`.

    Parameters
    ----------
    parameters : (N,) float32
        `count_parameters` numbers, in the order of `parameter_shapes`.
    sizes : (int, int, int)
        As for `parameter_shapes`.
    side : int
        Places to a side of the map.
    """

    def __init__(self, parameters: Floats, sizes: tuple[int, ...], side: int) -> None:
        relation, first, second = sizes
        self.places: Floats = np.zeros((side * side, 2 * relation), np.float32)
        """The encoder's two descriptions of each place."""
        self._parameters = np.array(parameters, np.float32)
        self._units = first, second
        self._scratch = np.empty(2 * side * side * relation + 3 * max(first, second, relation), np.float32)

    def answer(self, query: Floats, out: Floats) -> None:
        """Probabilities for an encoded query, (15, side, side) float32, into (2 · side, 2 · side) float32."""
        answer_query(self.places, query, self._parameters, self._units, self._scratch, out)

    def answer_ends(
        self, start: Point, goal: Point, spacing: float, sigma: float, query: Floats, out: Floats
    ) -> None:
        """Encode start and goal as `encoding.encode_ends` does, into `query`, and answer."""
        ends = (*start, *goal)
        answer_ends(ends, spacing, sigma, self.places, query, self._parameters, self._units, self._scratch, out)
