"""The head of a network in two parts. See `network.place_head`."""

import math

import numpy as np
from numpy import float32, inf

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.encoding import END_CHANNELS, fill_ends

ANSWERS = 4
"""Blocks to a place, two by two."""


@helper
def _add(values, matrix, out, above):
    """Add the product of the values (N, inputs) above a number and a matrix (inputs, outputs)."""
    for n in range(len(values)):
        for i in range(len(matrix)):
            value = values[n, i]
            if value > above:
                for o in range(matrix.shape[1]):
                    out[n, o] += value * matrix[i, o]


@helper
def _layer(values, matrix, bias, out):
    """Write the next layer: the bias and the product of the values above 0 and a matrix."""
    out[:] = bias
    _add(values, matrix, out, 0.0)


@helper
def _put_answers(last, side, out):
    """Write probabilities (2 side, 2 side), of what the last layer has of each place."""
    for i in range(2 * side):
        for j in range(2 * side):
            place = (i // 2) * side + j // 2
            value = last[place, 2 * (i % 2) + j % 2]
            out[i, j] = float32(1.0) / (float32(1.0) + math.exp(-value))


@kernel
def answer_ends(ends, spacing, sigma, places, query, matrices, out):
    """Encode start and goal, and write the probabilities of all blocks.

    Ends, spacing and sigma as for `encoding.encode_ends`.

    Parameters
    ----------
    places : (P², 2R) float32
        The encoder's two descriptions of each place.
    query : (15, P, P) float32
        Written: start and goal, encoded.
    matrices : tuple of float32 arrays
        The head's parameters, in the order of `parameter_shapes`.
    out : (2P, 2P) float32
        Written.
    """
    fill_ends(query, *ends, spacing, sigma)
    side = query.shape[1]
    count = side * side
    flat = query.reshape(len(query), -1)
    width = places.shape[1] // 2
    way, way_bias, both, both_bias, across, between = matrices[:6]
    mix, mix_bias, answer, answer_bias = matrices[6:]
    # what is computed
    to_start = np.empty((count, width), float32)
    to_goal = np.empty_like(to_start)
    at_end = np.empty((1, width), float32)
    crossed = np.zeros((1, width), float32)
    first = np.empty((count + 1, both.shape[1]), float32)
    second = np.empty((count, mix.shape[1]), float32)
    last = np.empty((count, ANSWERS), float32)
    # each place in relation to an end, and one end to the other
    for related, n in ((to_start, 0), (to_goal, END_CHANNELS)):
        _layer(flat[n : n + 1], places[:, width:], way_bias, at_end)
        related[:] = places[:, :width] + at_end
        _add(flat[n + 1 : n + END_CHANNELS].T, way, related, -inf)
        np.maximum(related, float32(0.0), related)
        other = END_CHANNELS - n
        _add(flat[other : other + 1], related, crossed, 0.0)
    # the hidden layers; the last row of the first is what both ends give to every place
    of_places = first[:-1]
    of_ends = first[-1:]
    _layer(crossed, across, both_bias, of_ends)
    of_places[:] = first[-1]
    to_start += to_goal
    _add(flat[2 * END_CHANNELS :].T, between, of_places, 0.0)
    _add(to_start, both, of_places, 0.0)
    _layer(of_places, mix, mix_bias, second)
    _layer(second, answer, answer_bias, last)
    _put_answers(last, side, out)
