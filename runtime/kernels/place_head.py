"""The head of a network in two parts. See `network.place_head`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.encoding import END_CHANNELS, fill_ends

ANSWERS = 4
"""Blocks to a place, two by two."""


@helper
def _add(values, matrix, out):
    """Add the product of values (N, inputs) and a matrix (inputs, outputs); numbers that are 0 are passed over."""
    for n in range(len(values)):
        for i in range(len(matrix)):
            value = values[n, i]
            if value != 0.0:
                for o in range(matrix.shape[1]):
                    out[n, o] += value * matrix[i, o]


@helper
def _relu(values):
    for n in range(len(values)):
        for i in range(values.shape[1]):
            values[n, i] = max(values[n, i], np.float32(0.0))


@kernel
def answer_ends(ends, spacing, sigma, places, query, layers, scratch, out):
    """Encode start and goal, and write the probabilities of all blocks.

    Parameters
    ----------
    ends, spacing, sigma
        See `encoding.encode_ends`.
    places : (P², 2R) float32
        The encoder's two descriptions of each place.
    query : (15, P, P) float32
        Written: start and goal, encoded.
    layers : tuple of (inputs, outputs) float32
        By `parameter_shapes`.
    scratch : (related, first, second, last)
        (3, P², R), (P² + 1, units), (P², units) and (P², 4) float32; overwritten.
    out : (2P, 2P) float32
        Written.
    """
    fill_ends(query, ends[0], ends[1], ends[2], ends[3], spacing, sigma)
    way, way_bias, both, both_bias, across, between, mix, mix_bias, answer, answer_bias = layers
    related, first, second, last = scratch
    side, flat = query.shape[1], query.reshape(len(query), -1)
    width = places.shape[1] // 2
    at_end, crossed = related[2, :1], related[2, 1:2]
    crossed[:] = 0.0
    for n in range(2):  # numbers that relate each place to an end, and one end to the other
        end, other = flat[n * END_CHANNELS : (n + 1) * END_CHANNELS], (1 - n) * END_CHANNELS
        at_end[:] = way_bias
        _add(end[:1], places[:, width:], at_end)
        related[n] = places[:, :width] + at_end
        _add(end[1:].T, way, related[n])
        _relu(related[n])
        _add(flat[other : other + 1], related[n], crossed)
    first[-1:] = both_bias
    _add(crossed, across, first[-1:])
    first[:-1] = first[-1]
    related[0] += related[1]
    _add(flat[2 * END_CHANNELS :].T, between, first[:-1])
    _add(related[0], both, first[:-1])
    _relu(first)
    second[:] = mix_bias
    _add(first[:-1], mix, second)
    _relu(second)
    last[:] = answer_bias
    _add(second, answer, last)
    for i in range(2 * side):
        for j in range(2 * side):
            value = last[(i // 2) * side + j // 2, 2 * (i % 2) + j % 2]
            out[i, j] = np.float32(1.0) / (np.float32(1.0) + math.exp(-value))
