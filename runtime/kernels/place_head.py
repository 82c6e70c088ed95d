"""The head of a network in two parts. See `network.place_head`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS, fill_ends

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
def _matrix(numbers, first, rows, cols):
    """The next rows × cols of `numbers`, and where what comes after them begins."""
    return numbers[first : first + rows * cols].reshape(rows, cols), first + rows * cols


@kernel
def answer_ends(ends, spacing, sigma, places, query, parameters, units, scratch, out):
    """Encode start and goal, and write the probabilities of all blocks.

    Ends, spacing and sigma as for `encoding.encode_ends`.

    Parameters
    ----------
    places : (P², 2R) float32
        The encoder's two descriptions of each place.
    query : (15, P, P) float32
        Written: start and goal, encoded.
    parameters : (N,) float32
        In the order of `parameter_shapes`.
    units : (int, int)
        Of the hidden layers.
    scratch : ((P² + 1) (3R + sum of units + 4),) float32
        Overwritten.
    out : (2P, 2P) float32
        Written.
    """
    fill_ends(query, ends[0], ends[1], ends[2], ends[3], spacing, sigma)
    side = query.shape[1]
    flat = query.reshape(len(query), -1)
    width = places.shape[1] // 2
    way, at = _matrix(parameters, 0, END_CHANNELS - 1, width)
    way_bias, at = _matrix(parameters, at, 1, width)
    both, at = _matrix(parameters, at, width, units[0])
    both_bias, at = _matrix(parameters, at, 1, units[0])
    across, at = _matrix(parameters, at, width, units[0])
    between, at = _matrix(parameters, at, BETWEEN_CHANNELS, units[0])
    mix, at = _matrix(parameters, at, units[0], units[1])
    mix_bias, at = _matrix(parameters, at, 1, units[1])
    answer, at = _matrix(parameters, at, units[1], ANSWERS)
    answer_bias, at = _matrix(parameters, at, 1, ANSWERS)
    to_start, at = _matrix(scratch, 0, side * side, width)
    to_goal, at = _matrix(scratch, at, side * side, width)
    at_end, at = _matrix(scratch, at, 1, width)
    crossed, at = _matrix(scratch, at, 1, width)
    first, at = _matrix(scratch, at, side * side + 1, units[0])
    second, at = _matrix(scratch, at, side * side, units[1])
    last, at = _matrix(scratch, at, side * side, ANSWERS)
    crossed[:] = 0.0
    for related, n in (
        (to_start, 0),
        (to_goal, END_CHANNELS),
    ):  # each place to an end, and one end to the other
        at_end[:] = way_bias
        _add(flat[n : n + 1], places[:, width:], at_end, 0.0)
        related[:] = places[:, :width] + at_end
        _add(flat[n + 1 : n + END_CHANNELS].T, way, related, -np.inf)
        np.maximum(related, np.float32(0.0), related)
        _add(flat[END_CHANNELS - n : END_CHANNELS - n + 1], related, crossed, 0.0)
    first[-1:] = both_bias
    _add(crossed, across, first[-1:], 0.0)
    first[:-1] = first[-1]
    to_start += to_goal
    _add(flat[2 * END_CHANNELS :].T, between, first[:-1], 0.0)
    _add(to_start, both, first[:-1], 0.0)
    second[:] = mix_bias
    _add(first[:-1], mix, second, 0.0)
    last[:] = answer_bias
    _add(second, answer, last, 0.0)
    for i in range(2 * side):
        for j in range(2 * side):
            value = last[(i // 2) * side + j // 2, 2 * (i % 2) + j % 2]
            out[i, j] = np.float32(1.0) / (np.float32(1.0) + math.exp(-value))
