"""Why a vehicle's body cannot stand on a cell, or get from where it can to the rest of a map: by
which limit.
"""

import numpy as np

from nnpp_edge.runtime.arrays import Bool, UInt8, UInt16
from nnpp_edge.runtime.cells import Cell, apart, slices, widened
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, REFUSALS, UNKNOWN
from nnpp_edge.runtime.robots.body import motions
from nnpp_edge.runtime.robots.body.attitude import greatest
from nnpp_edge.runtime.robots.body.poses import Poses

_AROUND = 32
"""Cells around the place where a search came closest, of whose steps is counted by which limit they
are refused.
"""
_WORDS = (
    "unknown ground, an obstacle or the map's edge lies below it",
    "it tilts by {}",
    "it pitches by {}",
    "it rolls by {}",
    "heights under a wheel differ by {}",
    "the ground comes {} above the plane of its wheels",
)
"""Faults that each limit refuses."""
_KEYS = ("", "max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m", "clearance_m")


def refusals(codes: UInt16) -> UInt8:
    """(H, W) of the codes of `Poses.standing`: 0 where the body stands in some direction.

    Else 1 + the limit, by its place in `REFUSALS`, that refuses it in most.
    """
    limits = range(len(REFUSALS))
    counts = np.stack([(codes == FAILS + limit).sum(0, dtype=np.uint8) for limit in limits])
    return np.where((codes < FAILS).any(0), 0, 1 + counts.argmax(0)).astype(np.uint8)


def why_blocked(poses: Poses, cell: Cell) -> str:
    """By which limit the body is refused on a cell where it stands in no direction."""
    codes = poses.standing([cell[0]])[:, 0, cell[1]]
    limit = int(np.bincount(codes - FAILS).argmax())
    axes = np.flatnonzero(codes == FAILS + limit).tolist()
    least = min(greatest(poses, cell, poses.codes.shape[1] + axis)[limit] for axis in axes)
    headings = "any heading" if len(axes) == AXIS_COUNT else f"{len(axes)} of {AXIS_COUNT} headings"
    return f"in {headings} {_refused(poses, limit, least, '{} or more')}"


def why_ended(poses: Poses, reached: Bool, end: Cell, *, by_legs: bool, from_goal: bool) -> str:
    """Where the cells (H, W) that a search reached come closest to an end, and why no closer.

    `by_legs` alone: told is the limit that refuses most of the legs near there, from cells that
    were reached to others that are no farther from the end, and the nearest of these legs. Else the
    search, of states, lacked a turn there.
    """
    rows, cols = poses.shape
    rows_away = np.arange(rows)[:, None] - end[0]
    cols_away = np.arange(cols) - end[1]
    away = rows_away**2 + cols_away**2
    closest = row, col = divmod(int(np.where(reached, away, np.inf).argmin()), cols)
    here = (row, col, 1, 1)
    begun, other = ("goal", "start") if from_goal else ("start", "goal")
    told = (
        f"the search from the {begun} got to {closest}, {apart(here, end)} cells from the {other}"
    )
    codes = poses.codes.reshape(rows + 2, cols + 2, -1)
    turns = np.flatnonzero(codes[row + 1, col + 1, AXIS_COUNT : 2 * AXIS_COUNT] >= FAILS)
    if len(turns) and not by_legs:
        values = greatest(poses, closest, AXIS_COUNT + int(turns[0]))
        limit = int((values / (1.0, *poses.vehicle.allowances)).argmax())
        why = _refused(poses, limit, values[limit], "up to {}")
        return f"{told}. It cannot turn on the spot there: {why}"
    # limits that refuse legs around it, -1 of those that lead elsewhere
    top, left, height, width = widened(here, (_AROUND, _AROUND), poses.shape)
    legs = codes[slices((top + 1, left + 1, height, width))][..., :AXIS_COUNT]
    refused = legs.astype(np.int64) - FAILS
    sides = np.pad(reached + 2 * (~reached & (away <= away[closest])), 2)
    one = sides[slices((top + 2, left + 2, height, width))]
    for axis, (down, right) in enumerate(motions.AXIS_LEGS):
        two = sides[slices((top + 2 + down, left + 2 + right, height, width))]
        refused[one * two != 2, axis] = -1
    found = refused[refused >= 0]
    if not len(found):
        return told
    limit = int(np.bincount(found).argmax())
    places = np.argwhere(refused == limit) + np.array((top, left, 0))
    nearest = np.abs(places[:, :2] - closest).max(1).argmin()
    i, j, axis = places[nearest].tolist()
    down, right = motions.AXIS_LEGS[axis]
    leg = [(i, j), (i + down, j + right)]
    first, last = leg if reached[i, j] else leg[::-1]
    why = _refused(poses, limit, greatest(poses, (i, j), axis)[limit], "up to {}")
    told += f". Near there {len(places)} of {len(found)} refused steps fail by {REFUSALS[limit]}"
    return f"{told}, such as from {first} to {last}: {why}"


def _refused(poses: Poses, limit: int, value: float, form: str) -> str:
    """The fault that a limit refuses, its value put into `form`, and the vehicle's key that allows
    less.
    """
    if limit == UNKNOWN:
        return _WORDS[limit]
    key = _KEYS[limit]
    unit = "°" if key.endswith("deg") else " m"
    if getattr(poses.vehicle, key) is None:
        key = "max_tilt_deg" if unit == "°" else "clearance_m"
    told = _WORDS[limit].format(form.format(f"{value:.4g}{unit}"))
    return f"{told}, and {key} is {poses.vehicle.allowances[limit - 1]:g}"
