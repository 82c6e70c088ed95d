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
from nnpp_edge.runtime.robots.body.poses import Poses


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
    """Clockwise from grid north, in [0, 360)."""
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
        outcome = "stands" if self.ok else f"refused by {self.refused_by}"
        lines = [f"{self.cell} at {self.heading_deg:g}°: {outcome}"]
        for name in ("tilt_deg", "pitch_deg", "roll_deg", "step_m", "belly_m"):
            value, most = getattr(self, name)
            form = "{:.1f}°" if name.endswith("deg") else "{:.2f} m"
            known = form.format(value) if math.isfinite(value) else "unknown"
            beyond = "   too much" if value > most else ""
            kind = name.rpartition("_")[0]
            lines.append(f"  {kind:<6}{known:>9}, at most {form.format(most)}{beyond}")
        return "\n".join(lines)


def attitudes(poses: Poses, path: Cells) -> Attitudes:
    """How the vehicle stands along a path of legs (N, 2), or of states (N, 3).

    A single cell counts as left along the first direction. inf or NaN where unknown cells lie
    below, unless these pass.
    """
    steps = poses.steps(path)
    full = replace(poses.vehicle, reserve=0.0).allowances
    headings = path[:, 2] if path.shape[1] == 3 else np.append(0, steps.headings)
    last = int(headings[-1])
    standing = poses.codes.shape[1] + last % AXIS_COUNT
    turned = last % (2 * AXIS_COUNT) >= AXIS_COUNT
    taken = zip(steps.cells, steps.motions, steps.reversed, steps.turned, strict=True)
    found = []
    for (row, col), motion, back, around in (*taken, (path[-1, :2], standing, False, turned)):
        figures = poses.figures((int(row), int(col)), int(motion))
        middle = (-1.0 if around else 1.0) * figures[-1 if back else 0, 5:]
        *slopes, step, rise = figures[:, :5].max(0)
        angles = np.degrees(np.arctan((*middle, *slopes)))
        used = np.array((*angles[2:], step, rise)) / full
        found.append((*angles[:3], poses.vehicle.clearance_m - rise, 1.0 - used.max()))
    return Attitudes(*np.array(found).T)


def explain(poses: Poses, cell: Cell, heading_deg: float) -> PoseCheck:
    """How the vehicle stands on a cell with a heading, clockwise from grid north, and what refuses
    it.

    InvalidQueryError where the cell lies outside the map, or the heading is no number.
    """
    rows, cols = poses.shape
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        raise InvalidQueryError(f"cell must lie on the map of {rows} × {cols} cells, got {cell}")
    if not math.isfinite(heading_deg):
        raise InvalidQueryError(f"heading_deg must be a number of degrees, got {heading_deg}")
    angle = math.radians(heading_deg)
    pose = motions.MotionPose(0.0, 0.0, -math.cos(angle), math.sin(angle))
    tables = motions.motions_of(poses.vehicle, poses.sides_m, [[pose]])
    slope, pitch, roll, step, rise, *_ = poses.figures(cell, 0, tables)[0].tolist()
    unknown = 0.0 if math.isfinite(slope + step + rise) else math.inf
    values = (unknown, math.atan(slope), pitch, roll, step, rise)
    within = (values <= poses.limits[: len(REFUSALS)]).tolist()
    refused = None if all(within) else REFUSALS[within.index(False)]
    angles = [math.degrees(math.atan(each)) for each in (slope, pitch, roll)]
    limits = map(Limit, (*angles, step, rise), poses.vehicle.allowances)
    return PoseCheck(cell, heading_deg % 360.0, refused is None, refused, *limits)


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
