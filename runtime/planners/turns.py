"""Turns of a line at its way points: by how much, how sharp, and arcs in place of them."""

import math

import numpy as np

from nnpp_edge.runtime.arrays import Floats

_ARC = math.radians(15.0)
"""The most that a way point on an arc turns."""


def turns_rad(points: Floats) -> Floats:
    """(N,) by how much each way point turns the line, from 0 to π; 0 at the ends."""
    legs = np.diff(points, axis=0)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    return np.pad(np.abs(_turned(headings)), 1)[: len(points)]


def curvatures(points: Floats) -> Floats:
    """(N,) one over the radius, in cells, of the widest arc that fits into each turn; 0 at the
    ends.

    The arc touches both legs, each within the half of it that lies next to the way point.
    """
    if len(points) < 3:
        return np.zeros(len(points))
    lengths = np.hypot(*np.diff(points, axis=0).T)
    shorter = np.minimum(lengths[:-1], lengths[1:])
    turns = turns_rad(points)[1:-1]
    return np.pad(2.0 * np.tan(0.5 * turns) / np.maximum(shorter, 1e-12), 1)


def with_arcs(points: Floats, radius: float) -> Floats | None:
    """The line with an arc of this radius in place of each turn; None where a leg is too short for
    its arcs.
    """
    legs = np.diff(points, axis=0)
    lengths = np.hypot(*legs.T)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    turns = _turned(headings)
    # from where an arc touches a leg to its way point; none at the ends of the line
    reach = np.pad(radius * np.tan(0.5 * np.abs(turns)), 1)
    too_short = reach[:-1] + reach[1:] > lengths
    if too_short.any() or (np.abs(turns) > 0.9 * np.pi).any():
        return None
    parts = [points[:1]]
    for k, turn in enumerate(turns):
        count = math.ceil(abs(turn) / _ARC)
        begin = points[k + 1] - reach[k + 1] / lengths[k] * legs[k]
        along = headings[k] + np.linspace(0.0, turn, count + 1)
        arc = np.column_stack((np.sin(along), -np.cos(along)))
        parts.append(begin + math.copysign(radius, turn) * (arc - arc[0]))
    parts.append(points[-1:])
    return np.concatenate(parts)


def _turned(headings: Floats) -> Floats:
    """By how much each heading differs from the one before, in [-π, π)."""
    turned: Floats = (np.diff(headings) + np.pi) % (2.0 * np.pi) - np.pi
    return turned
