"""Turns of a line at its way points: by how much, how sharp, and arcs in place of them."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Floats

_ARC = math.radians(15.0)
"""The most that a way point on an arc turns."""
_ACROSS_AND_DOWN = np.array((1.0, 1.0j))
"""Makes complex numbers of points, whose legs a factor turns."""
Complexes = NDArray[np.complex128]


def turns_rad(points: Floats) -> Floats:
    """(N,) by how much each way point turns the line, from 0 to π; 0 at the ends."""
    legs = np.diff(points @ _ACROSS_AND_DOWN)
    return np.pad(np.abs(_turns(legs)), 1)[: len(points)]


def _turns(legs: Complexes) -> Floats:
    """By how much each leg is turned against the one before, from -π to π."""
    return np.angle(legs[1:] * legs[:-1].conj())


def curvatures(points: Floats) -> Floats:
    """(N,) one over the radius, in cells, of the widest arc that fits into each turn; 0 at the
    ends.

    The arc touches both legs, each within the half of it that lies next to the way point.
    """
    if len(points) < 3:
        return np.zeros(len(points))
    lengths = np.hypot(*np.diff(points, axis=0).T)
    shorter = np.minimum(lengths[:-1], lengths[1:])
    found = np.zeros(len(points))
    turns = turns_rad(points)[1:-1]
    found[1:-1] = 2.0 * np.tan(0.5 * turns) / np.maximum(shorter, 1e-12)
    return found


def with_arcs(points: Floats, radius: float) -> Floats | None:
    """The line with an arc of this radius in place of each turn; None where a leg is too short for
    its arcs.
    """
    places = points @ _ACROSS_AND_DOWN
    legs = np.diff(places)
    ahead = legs / np.abs(legs)
    turns = _turns(legs)
    reach = np.pad(radius * np.tan(0.5 * np.abs(turns)), 1)
    too_short = reach[:-1] + reach[1:] > np.abs(legs)
    if too_short.any() or (np.abs(turns) > 0.9 * np.pi).any():
        return None
    parts = [places[:1]]
    for k in np.flatnonzero(np.abs(turns) > 1e-9).tolist():
        first = places[k + 1] - reach[k + 1] * ahead[k]
        to_middle = np.copysign(radius, turns[k]) * 1.0j * ahead[k]
        turned = np.linspace(0.0, turns[k], math.ceil(abs(turns[k]) / _ARC) + 1)
        parts.append(first + to_middle - to_middle * np.exp(1.0j * turned))
    line = np.concatenate((*parts, places[-1:]))
    return np.column_stack((line.real, line.imag))
