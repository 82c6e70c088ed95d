"""The head of a network in two parts. See `network.place_head`.

All arrays have a row a channel and a column a place, so that the innermost loops go along places.
"""

import math

import numpy as np
from numpy import float32

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.encoding import END_CHANNELS, fill_ends

ANSWERS = 4
"""Blocks to a place, two by two."""


@helper
def _add(values, matrix, out):
    """Add the product of the values (inputs, N) and a matrix (inputs, outputs) to (outputs, N)."""
    for o in range(matrix.shape[1]):
        for i in range(len(matrix)):
            weight = matrix[i, o]
            for n in range(values.shape[1]):
                out[o, n] += weight * values[i, n]


@helper
def _read(values, weights, out):
    """Add the values (W, N) at an end, by the weights (N,), of which few are above 0, to (W, 1)."""
    for n in range(len(weights)):
        if weights[n] > 0.0:
            for w in range(len(values)):
                out[w, 0] += weights[n] * values[w, n]


@helper
def _put_answers(last, side, out):
    """Write probabilities (2 side, 2 side), of what the last layer has of each place."""
    for i in range(2 * side):
        for j in range(2 * side):
            place = (i // 2) * side + j // 2
            value = last[2 * (i % 2) + j % 2, place]
            out[i, j] = float32(1.0) / (float32(1.0) + math.exp(-value))


@kernel
def answer_ends(ends, spacing, sigma, places, query, matrices, out):
    """Encode start and goal, and write the probabilities of all blocks.

    Ends, spacing and sigma as for `encoding.fill_ends`.

    Parameters
    ----------
    places : (2R, P²) float32
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
    flat = query.reshape(len(query), count)
    width = len(places) // 2
    way, way_bias, both, both_bias, across, between = matrices[:6]
    mix, mix_bias, answer, answer_bias = matrices[6:]
    # what is computed
    related = np.empty((2, width, count), float32)
    crossed = np.zeros((width, 1), float32)
    first = np.empty((both.shape[1], count), float32)
    second = np.empty((mix.shape[1], count), float32)
    last = np.empty((ANSWERS, count), float32)
    # each place in relation to an end, and one end to the other
    for end, n in enumerate((0, END_CHANNELS)):
        at_end = way_bias.T.copy()
        _read(places[width:], flat[n], at_end)
        related[end] = places[:width] + at_end
        _add(flat[n + 1 : n + END_CHANNELS], way, related[end])
        np.maximum(related[end], float32(0.0), related[end])
        _read(related[end], flat[END_CHANNELS - n], crossed)
    # the hidden layers; the first begins with what both ends give to every place
    of_ends = both_bias.T.copy()
    _add(crossed, across, of_ends)
    first[:] = of_ends
    _add(flat[2 * END_CHANNELS :], between, first)
    _add(related[0] + related[1], both, first)
    np.maximum(first, float32(0.0), first)
    second[:] = mix_bias.T
    _add(first, mix, second)
    np.maximum(second, float32(0.0), second)
    last[:] = answer_bias.T
    _add(second, answer, last)
    _put_answers(last, side, out)
