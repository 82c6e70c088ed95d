"""The head of a network in two parts: the answer to a query from the encoder's description of each
place.

onnxruntime runs the encoder when the map changes. A query takes a quarter of a million
multiplications, less than a call of onnxruntime costs, so they are done here. The ONNX file holds
the head's parameters beside its metadata.
"""

import base64
import math

import numpy as np

from nnpp_edge.runtime.arrays import Float32s, Planes
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS, ENDS_CHANNELS
from nnpp_edge.runtime.kernels.place_head import ANSWERS, answer_ends
from nnpp_edge.runtime.network.encoding import Point
from nnpp_edge.runtime.network.model_file import QUERY_SPACING

Matrices = tuple[Planes, ...]
"""The parameters of a head, as `parameter_shapes`."""


def parameter_shapes(sizes: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Matrices of a head in their order, as (inputs, outputs); those of one input are biases.

    `sizes` are the numbers that relate a place to an end, and the units of the two hidden layers.
    """
    relation, first, second = sizes
    return (
        # a place in relation to an end
        (END_CHANNELS - 1, relation),
        (1, relation),
        # what both relations, and what lies between the ends, give to the first layer
        (relation, first),
        (1, first),
        (relation, first),
        (BETWEEN_CHANNELS, first),
        # from the first layer to the second, and to the answers
        (first, second),
        (1, second),
        (second, ANSWERS),
        (1, ANSWERS),
    )


def text_of(parameters: Float32s) -> str:
    """Parameters (N,) as text, for a file's metadata."""
    return base64.b64encode(parameters.astype("<f4").tobytes()).decode()


def matrices_of(text: str, sizes: tuple[int, ...]) -> Matrices:
    """The parameters of a head of these sizes; ValueError where the text does not hold them."""
    parameters = np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32)
    shapes = parameter_shapes(sizes)
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    if not np.isfinite(parameters).all():
        raise ValueError("wanted finite parameters of its head, got others")
    return tuple(map(np.reshape, np.split(parameters, ends[:-1]), shapes))


class PlaceHead:
    """The head with these parameters, over the encoder's two descriptions of each place,
    (1, 2R, P, P) float32, as they are when it answers.
    """

    def __init__(self, matrices: Matrices, places: Planes) -> None:
        self._matrices = matrices
        _, channels, *square = places.shape
        self._places = places.reshape(channels, -1)
        self._query: Planes = np.zeros((ENDS_CHANNELS, *square), np.float32)

    def answer(self, start: Point, goal: Point, sigma: float, out: Planes) -> None:
        """Probabilities, (2P, 2P) float32, into `out`."""
        answer_ends(
            (*start, *goal),
            float(QUERY_SPACING),
            sigma,
            self._places,
            self._query,
            self._matrices,
            out,
        )
