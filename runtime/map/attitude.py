"""How a vehicle stands on the poses that its motions are checked by, in numbers: along a path, and on one cell."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.poses import AXES, REFUSALS
from nnpp_edge.runtime.map import motions
from nnpp_edge.runtime.map.poses import Poses, limits_of
from nnpp_edge.runtime.terrain.vehicle import Vehicle

Floats = NDArray[np.float64]


class Attitudes(NamedTuple):
    """Of each cell of a path, on the leg by which it is left, the last as it is arrived at; (N,) float64 each."""

    pitch_deg: Floats
    """Of the plane of the wheels in the middle of their ranges, where the leg begins; nose up is positive."""
    roll_deg: Floats
    """Likewise; left side up is positive."""
    tilt_deg: Floats
    """The most that the body can be inclined on the leg, wherever in their patches the wheels touch."""
    clearance_m: Floats
    """The least that is left between belly and ground, likewise."""


class Limit(NamedTuple):
    """A figure of a pose, and what it may be at most."""

    value: float
    allowance: float


@dataclass(frozen=True)
class PoseCheck:
    """How a vehicle stands on one cell, and the limit that refuses it."""

    cell: Cell
    heading_deg: float
    """Clockwise from up the rows, in [0, 360)."""
    ok: bool
    refused_by: str | None
    """The first that is passed of ``unknown``, ``tilt``, ``pitch``, ``roll``, ``step`` and ``belly``; None if ok."""
    tilt_deg: Limit
    pitch_deg: Limit
    roll_deg: Limit
    step_m: Limit
    """Greatest difference of heights under one wheel, beyond the slope on which the body stands."""
    belly_m: Limit
    """How far the ground comes above the wheels' plane below the belly; at most the clearance."""

    def __str__(self) -> str:
        """A line for each limit."""
        lines = [f"({self.cell[0]}, {self.cell[1]}) at {self.heading_deg:g}°: "]
        lines[0] += "stands" if self.ok else f"refused by {self.refused_by}"
        for name in ("tilt_deg", "pitch_deg", "roll_deg", "step_m", "belly_m"):
            value, most = getattr(self, name)
            unit, digits = ("°", 1) if name.endswith("deg") else (" m", 2)
            known = f"{value:.{digits}f}{unit}" if math.isfinite(value) else "unknown"
            beyond = "   too much" if value > most else ""
            lines.append(f"  {name.rpartition('_')[0]:<6}{known:>9}, at most {most:.{digits}f}{unit}{beyond}")
        return "\n".join(lines)


def attitudes(poses: Poses, path: NDArray[np.int32]) -> Attitudes:
    """How the vehicle stands along a path (N, 2) of legs; a single cell counts as left along the first direction.

    inf or NaN where unknown cells lie below, unless these pass.
    """
    legs = np.diff(path, axis=0)
    legs = np.concatenate((legs, legs[-1:] if len(legs) else np.array([motions.AXES[0]])))[: len(path)]
    found = np.full((4, len(path)), np.nan)
    for number, direction in enumerate(motions.DIRECTIONS):
        chosen = (legs == direction).all(1)
        chosen[-1] = False
        arrived = (legs[-1] == direction).all() and len(path) > 0
        if not (chosen.any() or arrived):
            continue
        reverse = number >= AXES
        begin = path[chosen] + (np.array(direction) if reverse else 0)
        figures = [_figures(poses, begin, pose) for pose in _of_motion(poses.motions, number % AXES)]
        if chosen.any():
            found[:, chosen] = _worst(figures, reverse)
        if arrived:
            there = [_figures(poses, path[-1:], pose) for pose in _of_motion(poses.motions, 2 * AXES + number % AXES)]
            found[:, -1] = _worst(there, reverse)[:, 0]
    found[3] = poses.vehicle.clearance_m - found[3]
    found[:3] = np.degrees(np.arctan(found[:3]))
    return Attitudes(*found)


def explain(poses: Poses, cell: Cell, heading_deg: float) -> PoseCheck:
    """How the vehicle stands on a cell with a heading, clockwise from up the rows, and what refuses it.

    InvalidQueryError where the cell lies outside the map, or the heading is no number.
    """
    rows, cols = poses.shape
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        raise InvalidQueryError(f"cell must lie on the map of {rows} × {cols} cells, got {cell}")
    if not math.isfinite(heading_deg):
        raise InvalidQueryError(f"heading_deg must be a number of degrees, got {heading_deg}")
    angle = math.radians(heading_deg)
    pose = motions.Pose(0.0, 0.0, (-math.cos(angle), math.sin(angle)))
    tables = motions.motions_of(poses.vehicle, poses.sides_m, [[pose]])
    figures = _figures(poses, np.array([cell]), _Tables(tables, 0))
    slope, pitch, roll, step, up = (float(each[0]) for each in figures[2:])
    tilts = [math.degrees(math.atan(each)) for each in (slope, pitch, roll)]
    most = limits_of(poses.vehicle, poses.weights).astype(np.float64)
    values = math.nan, math.atan(slope), pitch, roll, step, up
    if not math.isfinite(slope + step + up):
        refused: str | None = REFUSALS[0]
    else:
        refused = next((REFUSALS[n] for n in range(1, len(REFUSALS)) if not values[n] <= most[n]), None)
    pitch_deg, roll_deg, tilt_deg = poses.vehicle.tilts_deg
    return PoseCheck(
        cell,
        heading_deg % 360.0,
        refused is None,
        refused,
        Limit(tilts[0], tilt_deg),
        Limit(tilts[1], pitch_deg),
        Limit(tilts[2], roll_deg),
        Limit(step, poses.vehicle.step_m),
        Limit(up, poses.vehicle.clearance_m),
    )


def greatest(poses: Poses, cell: Cell, motion: int) -> Floats:
    """(6,) what a motion from a cell comes to at most by each limit, in their order in `REFUSALS`.

    Degrees and metres; inf of ``unknown`` where unknown cells lie below, and then of others, or NaN.
    """
    figures = [_figures(poses, np.array([cell]), pose)[1:, 0] for pose in _of_motion(poses.motions, motion)]
    most: Floats = np.max(figures, axis=0)
    most[0], most[1:4] = 0.0 if np.isfinite(most[1:]).all() else np.inf, np.degrees(np.arctan(most[1:4]))
    return most


class _Tables(NamedTuple):
    tables: motions.Motions
    pose: int


def _of_motion(tables: motions.Motions, motion: int) -> list[_Tables]:
    first, last = tables.poses_of[motion : motion + 2].tolist()
    return [_Tables(tables, pose) for pose in range(first, last)]


def _worst(figures: list[Floats], reverse: bool) -> Floats:
    """(4, N) pitch and roll of a motion's first pose, as slopes, and the greatest slope and rise of all its poses."""
    along, across = figures[-1 if reverse else 0][:2]
    sign = -1.0 if reverse else 1.0
    slope, up = (np.max([each[n] for each in figures], axis=0) for n in (2, 6))
    return np.stack((sign * along, sign * across, slope, up))


def _figures(poses: Poses, cells: NDArray[np.int32], of: _Tables) -> Floats:
    """(7, N) slopes ahead and to the left by the wheels' ranges' middles; bounds of slope, pitch, roll, step, rise.

    The check of `kernels.poses` in NumPy, of one pose of a motion that begins at each of N cells.
    """
    tables, pose = of
    ground, vehicle = poses.heights.astype(np.float64), poses.vehicle
    margin = (poses.heights.shape[0] - poses.shape[0]) // 2
    base = cells + margin

    def at(offsets: NDArray[np.int64]) -> Floats:
        row = np.clip(base[:, None, 0] + offsets[:, 0], 0, ground.shape[0] - 1)
        col = np.clip(base[:, None, 1] + offsets[:, 1], 0, ground.shape[1] - 1)
        heights: Floats = ground[row, col]
        return heights

    with np.errstate(invalid="ignore"):
        fitted = slice(*tables.slopes_of[pose : pose + 2])
        slopes = at(tables.slope_cells[fitted]) @ tables.slope_shares[fitted].astype(np.float64)
        slopes = np.where(np.isfinite(slopes).all(1, keepdims=True), slopes, 0.0)
        wheels = len(vehicle.wheels_m)
        gradients = tables.gradients.astype(np.float64)
        ranges: list[tuple[Floats, Floats]] = []
        parts: list[tuple[Floats, Floats, slice]] = []
        for group in range(*tables.groups_of[pose : pose + 2]):
            first, fours, lines, end, cell = tables.groups[group].tolist()
            counts = np.repeat((4, 2, 1), (fours - first, lines - fours, end - lines))
            last = cell + counts.sum()
            heights = at(tables.cells[cell:last]) * tables.shares[cell:last]
            heights = np.add.reduceat(heights, np.cumsum(counts) - counts, axis=1)
            places = tables.places[first:end].astype(np.float64)
            departs = heights - slopes @ places.T
            if len(ranges) < wheels:
                ranges.append((np.fmin.reduce(departs, 1), np.fmax.reduce(departs, 1)))
            else:
                parts.append((departs, places, slice(*tables.raised_of[group : group + 2])))
        low, high = np.array(ranges).transpose(1, 0, 2)
        if not vehicle.unknown_passes:
            high = np.where(np.isnan(high), np.inf, high)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        along, across = gradients[1:3] @ middle
        more_along, more_across = gradients[3:5] @ half
        planes = []
        for departs, places, raised in parts:
            touched = low.copy()
            touched[tables.raised[raised]] = high[tables.raised[raised]]
            level, ahead, left = gradients[:3] @ touched
            plane = level[:, None] + np.outer(ahead, places[:, 0]) + np.outer(left, places[:, 1])
            planes.append(np.fmax.reduce(departs - plane, 1))
        rise = np.fmax.reduce(planes)
        carried, (sway, aside, turn) = tables.carried.astype(np.float64), tables.swept[pose].astype(np.float64)
        steep = np.stack((np.abs(along) + more_along, np.abs(across) + more_across))
        by = carried[:6].reshape(3, 2) @ steep
        steep, more_along, more_across = steep + by[:2], more_along + by[0], more_across + by[1]
        up = np.maximum(rise + by[2] + sway * steep[0] + aside * steep[1], 0.0)
        step = 2.0 * half.max(0) + carried[6:] @ steep
        most = np.stack((np.abs(slopes[:, 0] + along) + more_along, np.abs(slopes[:, 1] + across) + more_across))
        slope = np.hypot(*(most + turn * steep[::-1]))
        turned = most + turn * (np.abs(slopes.T[::-1]) + steep[::-1])
        pitch, roll = np.minimum(turned, slope)
        unknown = ~np.isfinite(slope + step + rise)
        figures = np.stack((slopes[:, 0] + along, slopes[:, 1] + across, slope, pitch, roll, step, up))
        return np.where(unknown & ~np.isfinite(figures), np.nan, figures)


__all__ = ["Attitudes", "Limit", "PoseCheck", "Vehicle", "attitudes", "explain", "greatest"]
