"""The head of a network in two parts. See `network.place_head`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import helper, kernel
from nnpp_edge.runtime.kernels.encoding import BETWEEN_CHANNELS, END_CHANNELS, fill_ends

ANSWERS = 4
"""Blocks to a place, two by two."""


@helper
def _matrix(numbers, first, rows, cols):
    """The next rows × cols of `numbers`, and where what comes after them begins."""
    return numbers[first : first + rows * cols].reshape(rows, cols), first + rows * cols


@helper
def _relate(places, query, way, bias, at_end, related):
    """Numbers that relate each place to an end: relu(place + what lies at the end + the way there)."""
    side, width = query.shape[1], way.shape[1]
    for c in range(width):
        at_end[c] = bias[c]
    for p in range(side * side):
        share = query[0, p // side, p % side]
        if share > 0.0:
            for c in range(width):
                at_end[c] += share * places[p, width + c]
    for p in range(side * side):
        i, j = p // side, p % side
        down, right, apart = query[1, i, j], query[2, i, j], query[3, i, j]
        wide, sharp = query[4, i, j], query[5, i, j]
        for c in range(width):
            total = (
                places[p, c] + at_end[c] + down * way[0, c] + right * way[1, c] + apart * way[2, c]
                + wide * way[3, c] + sharp * way[4, c]
            )  # fmt: skip
            related[p, c] = max(total, np.float32(0.0))


@helper
def _across(share, related, across, out):
    """Add to `out` what one end, where `share` is not 0, is to the other by way of `across`."""
    side = share.shape[0]
    for p in range(side * side):
        weight = share[p // side, p % side]
        if weight > 0.0:
            for c in range(related.shape[1]):
                factor = weight * related[p, c]
                for h in range(len(out)):
                    out[h] += factor * across[c, h]


@kernel
def answer_ends(ends, spacing, sigma, places, query, parameters, units, scratch, out):
    """Encode start and goal, and write the probabilities of all blocks.

    Parameters
    ----------
    ends, spacing, sigma
        See `encoding.encode_ends`.
    places : (P², 2R) float32
        The encoder's two descriptions of each place.
    query : (15, P, P) float32
        Written: start and goal, encoded.
    parameters : (N,) float32
        In the order of `parameter_shapes`.
    units : (int, int)
        Of the hidden layers.
    scratch : (2P²R + 3 max(R, *units),) float32
        Overwritten.
    out : (2P, 2P) float32
        Written.
    """
    fill_ends(query, ends[0], ends[1], ends[2], ends[3], spacing, sigma)
    first_units, second_units = units
    side, ends, width = query.shape[1], END_CHANNELS, places.shape[1] // 2
    way, at = _matrix(parameters, 0, ends - 1, width)
    way_bias, at = _matrix(parameters, at, 1, width)
    both, at = _matrix(parameters, at, width, first_units)
    both_bias, at = _matrix(parameters, at, 1, first_units)
    across, at = _matrix(parameters, at, width, first_units)
    between, at = _matrix(parameters, at, BETWEEN_CHANNELS, first_units)
    mix, at = _matrix(parameters, at, first_units, second_units)
    mix_bias, at = _matrix(parameters, at, 1, second_units)
    answer, at = _matrix(parameters, at, second_units, ANSWERS)
    answer_bias, at = _matrix(parameters, at, 1, ANSWERS)
    of_start, at = _matrix(scratch, 0, side * side, width)
    of_goal, at = _matrix(scratch, at, side * side, width)
    layers, at = _matrix(scratch, at, 3, max(first_units, second_units, width))
    base, first, second = layers[0, :first_units], layers[1, :first_units], layers[2, :second_units]
    _relate(places, query[:ends], way, way_bias[0], layers[1], of_start)
    _relate(places, query[ends : 2 * ends], way, way_bias[0], layers[1], of_goal)
    base[:] = both_bias[0]
    _across(query[ends], of_start, across, base)
    _across(query[0], of_goal, across, base)
    for p in range(side * side):
        i, j = p // side, p % side
        a, b, c = query[2 * ends, i, j], query[2 * ends + 1, i, j], query[2 * ends + 2, i, j]
        for h in range(first_units):
            first[h] = base[h] + a * between[0, h] + b * between[1, h] + c * between[2, h]
        for r in range(width):
            value = of_start[p, r] + of_goal[p, r]
            if value > 0.0:
                for h in range(first_units):
                    first[h] += value * both[r, h]
        second[:] = mix_bias[0]
        for h in range(first_units):
            value = first[h]
            if value > 0.0:
                for s in range(second_units):
                    second[s] += value * mix[h, s]
        one, two, three, four = answer_bias[0, 0], answer_bias[0, 1], answer_bias[0, 2], answer_bias[0, 3]
        for s in range(second_units):  # four sums at a time: none waits for the other
            value = max(second[s], np.float32(0.0))
            one += value * answer[s, 0]
            two += value * answer[s, 1]
            three += value * answer[s, 2]
            four += value * answer[s, 3]
        out[2 * i, 2 * j], out[2 * i, 2 * j + 1] = one, two
        out[2 * i + 1, 2 * j], out[2 * i + 1, 2 * j + 1] = three, four
    for i in range(2 * side):
        for j in range(2 * side):
            out[i, j] = np.float32(1.0) / (np.float32(1.0) + math.exp(-out[i, j]))
