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
    turns = np.abs((np.diff(headings) + np.pi) % (2.0 * np.pi) - np.pi)
    return np.concatenate(([0.0], turns, [0.0]))[: len(points)]


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
    turns = turns_rad(points)
    lengths = np.hypot(*np.diff(points, axis=0).T)
    reach = radius * np.tan(0.5 * turns)
    too_short = reach[:-1] + reach[1:] > lengths
    if too_short.any() or (turns > 0.9 * np.pi).any():
        return None
    parts = [points[:1]]
    for k in range(1, len(points) - 1):
        back = (points[k - 1] - points[k]) / lengths[k - 1]
        ahead = (points[k + 1] - points[k]) / lengths[k]
        count = math.ceil(turns[k] / _ARC)
        if count == 0:
            continue
        turn = turns[k]
        inwards = (back + ahead) / np.linalg.norm(back + ahead)
        middle = points[k] + inwards * radius / math.cos(0.5 * turn)
        first = points[k] + reach[k] * back - middle
        last = points[k] + reach[k] * ahead - middle
        turned = np.arange(count + 1)[:, None] / count * turn
        arc = np.sin(turn - turned) * first + np.sin(turned) * last
        parts.append(middle + arc / math.sin(turn))
    parts.append(points[-1:])
    return np.concatenate(parts)
