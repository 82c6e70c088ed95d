"""How a vehicle stands on the poses that its motions are checked by, in numbers: along a path, and
on one cell.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, REFUSALS
from nnpp_edge.runtime.robots.body import motions
from nnpp_edge.runtime.robots.body.poses import Poses, limits_of


class Attitudes(NamedTuple):
    """Of each cell of a path, on the leg by which it is left, the last as it is arrived at; (N,)
    float64 each.
    """

    pitch_deg: Floats
    roll_deg: Floats
    """With the wheels in the middle of their ranges, where the leg begins; nose up and left side up
    are positive.
    """
    tilt_deg: Floats
    clearance_m: Floats
    """The most that the body can be inclined on the leg, and the least that is left below it."""
    margin: Floats
    """Least share of any of the vehicle's limits that is left on the leg, its reserve included."""


class Limit(NamedTuple):
    """A figure of a pose, and what it may be at most."""

    value: float
    allowance: float


@dataclass(frozen=True)
class PoseCheck:
    """Attitude of a vehicle on one cell, and the limit that refuses it."""

    cell: Cell
    heading_deg: float
    """Clockwise from up the rows, in [0, 360)."""
    ok: bool
    refused_by: str | None
    """The first that is passed of ``unknown``, ``tilt``, ``pitch``, ``roll``, ``step`` and
    ``belly``; None if ok.
    """
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
            lines.append(
                f"  {name.rpartition('_')[0]:<6}{known:>9}, at most {most:.{digits}f}{unit}{beyond}"
            )
        return "\n".join(lines)


def attitudes(poses: Poses, path: Cells) -> Attitudes:
    """How the vehicle stands along a path of legs (N, 2), or of states (N, 3).

    A single cell counts as left along the first direction. inf or NaN where unknown cells lie
    below, unless these pass.
    """
    steps = poses.steps(path)
    found = np.full((5, len(path)), np.nan)
    full = replace(poses.vehicle, reserve=0.0).allowances
    last = (
        int(path[-1, 2]) if path.shape[1] == 3 else int(steps.headings[-1]) if len(path) > 1 else 0
    )
    standing = (
        path[-1, :2],
        poses.codes.shape[1] + last % AXIS_COUNT,
        False,
        last % (2 * AXIS_COUNT) >= AXIS_COUNT,
    )
    taken = zip(steps.cells, steps.motions, steps.reversed, steps.turned, strict=True)
    for n, (cell, motion, back, turned) in enumerate((*taken, standing)):
        figures = poses.figures((int(cell[0]), int(cell[1])), int(motion))
        found[:2, n] = (-1.0 if turned else 1.0) * figures[-1 if back else 0, 5:]
        most = figures[:, :5].max(0)
        found[2, n] = most[0]
        found[3, n] = most[4]
        most[:3] = np.degrees(np.arctan(most[:3]))
        found[4, n] = 1.0 - (most / full).max()
    found[:3] = np.degrees(np.arctan(found[:3]))
    found[3] = poses.vehicle.clearance_m - found[3]
    return Attitudes(*found)


def explain(poses: Poses, cell: Cell, heading_deg: float) -> PoseCheck:
    """How the vehicle stands on a cell with a heading, clockwise from up the rows, and what refuses
    it.

    InvalidQueryError where the cell lies outside the map, or the heading is no number.
    """
    rows, cols = poses.shape
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        raise InvalidQueryError(f"cell must lie on the map of {rows} × {cols} cells, got {cell}")
    if not math.isfinite(heading_deg):
        raise InvalidQueryError(f"heading_deg must be a number of degrees, got {heading_deg}")
    slope, pitch, roll, step, up = _standing(poses, np.array([(*cell, heading_deg)]))[0].tolist()
    values = (math.atan(slope), pitch, roll, step, up)
    most = limits_of(poses.vehicle, poses.weights)[1:6].tolist()
    fails = (
        not math.isfinite(slope + step + up),
        *(not a <= b for a, b in zip(values, most, strict=True)),
    )
    refused = next((name for name, failing in zip(REFUSALS, fails, strict=True) if failing), None)
    figures = *(math.degrees(math.atan(each)) for each in (slope, pitch, roll)), step, up
    limits = map(Limit, figures, poses.vehicle.allowances)
    return PoseCheck(cell, heading_deg % 360.0, refused is None, refused, *limits)


def costs_at(poses: Poses, places: Floats) -> Floats:
    """(N,) T of the vehicle at places (N, 3) on the map: row and column from the middle of cell (0,
    0), and degrees clockwise from up the rows; inf where it may not stand.
    """
    inside = ((places[:, :2] > -0.5) & (places[:, :2] < np.array(poses.shape) - 0.5)).all(1)
    found = np.full(len(places), np.inf)
    limits = limits_of(poses.vehicle, poses.weights).astype(np.float64)
    values = _standing(poses, places[inside])
    values[:, 0] = np.arctan(values[:, 0])
    shares = values / limits[1:6]
    found[inside] = np.where((shares <= 1.0).all(1), shares[:, [0, 4, 3]] @ limits[6:], np.inf)
    return found


def _standing(poses: Poses, places: Floats) -> Floats:
    """(N, 5) bounds of slope, pitch, roll, step and rise at places as in `costs_at`, inside the
    map.
    """
    cells = np.rint(places[:, :2])
    angles = np.radians(places[:, 2])
    offsets = (places[:, :2] - cells).tolist()
    ahead = np.column_stack((-np.cos(angles), np.sin(angles))).tolist()
    alone = [
        [motions.Pose(row, col, (down, right))]
        for (row, col), (down, right) in zip(offsets, ahead, strict=True)
    ]
    tables = motions.motions_of(poses.vehicle, poses.sides_m, alone)
    each = [
        poses.figures((row, col), n, tables)[0, :5]
        for n, (row, col) in enumerate(cells.astype(int).tolist())
    ]
    return np.array(each)


def greatest(poses: Poses, cell: Cell, motion: int) -> Floats:
    """(6,) what a motion from a cell comes to at most by each limit, in their order in `REFUSALS`.

    Degrees and metres; inf of ``unknown`` where unknown cells lie below a pose: the others are then
    of those poses that stand on known ground, NaN without any.
    """
    figures = poses.figures(cell, motion)[:, :5]
    known = np.isfinite(figures).all(1)
    most: Floats = figures[known].max(0) if known.any() else np.full(5, np.nan)
    unknown = 0.0 if known.all() else np.inf
    return np.concatenate(([unknown], np.degrees(np.arctan(most[:3])), most[3:]))
