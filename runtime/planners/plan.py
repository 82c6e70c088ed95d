"""The answer of a planner, its methods, and where a path was found."""

import math
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from nnpp_edge.runtime.arrays import Cells, Floats, Int32, curvatures, headings_along
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.options import METHODS, STILL, Entry
from nnpp_edge.runtime.search.region import Region

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nnpp_edge.runtime.map.along import Along, Line, Numbers
    from nnpp_edge.runtime.map.state import MapState
    from nnpp_edge.runtime.robots.body.arcs import Arc, Drive
    from nnpp_edge.runtime.terrain.vehicle import Vehicle

_LIKELY = (2, 4, 8)
"""Percent above the optimum that 95 of 100 measured paths keep within: of a point, of a body
(docs/results.md) and of arcs (docs/decisions/arcs.md)."""


class _Named(StrEnum):
    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise InvalidQueryError(f"method must be one of {', '.join(cls)}, got {value!r}")

    @property
    def entry(self) -> Entry:
        """All that is known of it."""
        return METHODS[self]


_make: Any = _Named  # of which type checkers know no members
_NAMES = {name.upper().replace("-", "_"): name for name in METHODS}
Method = _make("Method", {key: name for key, name in _NAMES.items() if name in STILL})
"""Ways of planning; InvalidQueryError for another name, as of `DynamicMethod`."""
DynamicMethod = _make("DynamicMethod", _NAMES)
"""Ways of replanning on a map that changes."""


class Source(StrEnum):
    """Where a path was found."""

    MAP = "map"
    """The whole map was searched because the method does so: the path is optimal."""
    REGION = "region"
    """In the first region."""
    WIDENED = "widened"
    """In a widened region, the first having failed."""
    FALLBACK = "fallback"
    """The whole map was searched because every region had failed: the path is optimal."""
    STANDING = "standing"
    """A way to a place on the path of arcs that stood before, and on along that."""


@dataclass(frozen=True)
class Plan:
    """The answer to one query. Without a path its numbers are inf, or 0 for counts.

    A plan owns its arrays: it does not change when the map or the planner does.
    """

    status: Status
    method: str
    """The method that was used; for ``auto`` the one it picked."""
    source: Source | None = None
    """Where the path was found; None where no search was made."""
    path: Cells = field(default_factory=lambda: np.empty((0, 2), np.int32), repr=False)
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT as far as the search had come, or
    empty.
    """
    cost: float = math.inf
    """Sum of the path's step costs; with ``energy`` below 0 where more is got back than drawn."""
    length: float = math.inf
    """Length of the path in cells, a diagonal step counting √2."""
    traverse_cost: float = math.inf
    """CC: sum of the costs (``paper``: T; ``length``: weights) of the path's cells."""
    lower_bound: float = 0.0
    """No path on the map costs less."""
    expansions: int = 0
    """Cells expanded, at all levels and in all regions that were tried."""
    region: Region | None = field(default=None, repr=False)
    """Where the last search at full resolution was allowed to go, if regions are kept; None for the
    whole map.
    """
    network_region: Region | None = field(default=None, repr=False)
    """The network's region at the adaptive threshold itself (NNPP, section 4.3), if regions are
    kept.
    """
    threshold: float = math.nan
    """The adaptive threshold td, of a learned region."""
    planner: str = ""
    """Name of the planner that was used: the method's, or a `DynamicPlanner`'s own for it."""
    choice: str = ""
    """Why the method was picked, or the search made as it was, where there was a choice."""
    reason: str = ""
    """Why there is no path, as far as the status does not say it; empty where there is one."""
    costs_computed: float = 1.0
    """Share of the map's cells whose cost was there when the plan was, in [0, 1]: below 1 on a map
    of elevations.
    """
    checks: int = 0
    """Poses of a vehicle that were checked for this plan."""
    waypoints: Floats | None = field(default=None, repr=False)
    """(N, 2) places (row, col), in cells, of the path freed from the grid, with both ends; None
    unless asked for.
    """
    line_cost: float = math.inf
    """The line integral of the cost along the way points, in units of `cost`; see
    `planners.refine`.
    """
    along: "Along | None" = field(default=None, repr=False)
    """The path over the ground, point by point; None where no elevations are known."""
    states: Int32 | None = field(default=None, repr=False)
    """(N,) the direction in which a body that drives arcs stands on each cell, see
    `robots.body.motions.LEGS`, and 16 more where it came backwards and a change of gear
    costs; None of others, as cells tell it."""
    vehicle: "Vehicle | None" = field(default=None, repr=False)
    """Whose path it is; None of a point."""
    known: int = 0
    """Cells from the path's first on that are known and checked: all, but on ground that is known
    coarsely.
    """
    timings_ms: dict[str, float] = field(default_factory=dict)
    """Milliseconds by stage, and ``total``."""

    @property
    def ok(self) -> bool:
        """Whether the path leads from start to goal."""
        return self.status is Status.OK

    @property
    def headings_deg(self) -> Floats:
        """(N,) degrees clockwise from grid north in which each cell is left, see
        `arrays.headings_along`; of a body that drives arcs, in which it stands there.
        """
        if self.states is None or self.along is None:
            return headings_along(self.path)
        from nnpp_edge.runtime.robots.body.arcs import heading_deg

        return np.array([heading_deg(k, self.along.sides_m) for k in self.states.tolist()])

    @cached_property
    def arcs(self) -> "tuple[Arc, ...]":
        """The pieces of a path of arcs, in order; empty for other paths."""
        if self.states is None or self.vehicle is None or self.along is None:
            return ()
        from nnpp_edge.runtime.robots.body.arcs import arcs_along

        return arcs_along(self.walked, self.vehicle, self.along.sides_m)

    @cached_property
    def drive(self) -> "Drive | None":
        """Poses along the arcs; None without any."""
        if self.states is None or self.vehicle is None or self.along is None or not len(self.path):
            return None
        from nnpp_edge.runtime.robots.body.arcs import drive_along

        return drive_along(self.walked, self.vehicle, self.along.sides_m)

    @property
    def poses(self) -> Floats:
        """(N, 3) along `arcs`, every 0.25 m or nearer: metres along columns and along rows from the
        middle of cell (0, 0), degrees clockwise from grid north; empty without arcs.
        """
        return np.empty((0, 3)) if self.drive is None else self.drive.poses

    @property
    def walked(self) -> Int32:
        """The path for `Grid.walk`: (N, 2) cells, of a body that drives arcs (N, 3) with its
        states.
        """
        if self.states is None:
            return self.path
        return np.column_stack((self.path, self.states)).astype(np.int32)

    def rest(self, first: int, end: int | None = None) -> "Plan":
        """The plan with the rest of its path, from one of its cells on, or before another."""
        states = None if self.states is None else self.states[first:end]
        return replace(
            self, path=self.path[first:end], states=states, known=max(self.known - first, 0)
        )

    @property
    def waypoint_headings_deg(self) -> Floats:
        """(N,) degrees in which each way point is left, as `headings_deg`; empty without."""
        return np.empty(0) if self.waypoints is None else headings_along(self.waypoints)

    @property
    def curvatures(self) -> Floats:
        """(N,) of the line at each way point, one over a radius in metres, or cells without
        heights: `arrays.curvatures`.
        """
        if self.waypoints is None:
            return np.empty(0)
        sides_m = (1.0, 1.0) if self.along is None else self.along.sides_m
        return curvatures(self.waypoints * sides_m)

    @property
    def line(self) -> "Line":
        """(N, 2) what is driven: way points (row, col) where the path was freed from the grid, the
        middles of a body along its arcs, else the path's cells.
        """
        if self.drive is not None and self.along is not None:
            return self.drive.poses[:, 1::-1] / self.along.sides_m
        return self.path if self.waypoints is None else self.waypoints

    def over(self, state: "MapState") -> "Plan":
        """This plan with what lies below its line on this map, of a body that drives arcs at its
        poses.
        """
        along = state.along(self.line, None if self.states is None else self.line)
        return self if along is None else replace(self, along=along)

    @property
    def numbers(self) -> "Numbers":
        """Along the way, of the whole path; all NaN without a path, or where no elevations are
        known.
        """
        if self.along is not None:
            return self.along.numbers
        from nnpp_edge.runtime.map.along import Numbers

        return Numbers.unknown()

    @property
    def ground_length_m(self) -> float:
        """Length on the ground, up and down its slopes."""
        return self.numbers.ground_length_m

    @property
    def climb_m(self) -> float:
        """Sum of all rises."""
        return self.numbers.climb_m

    @property
    def descent_m(self) -> float:
        """Sum of all falls, counted positive."""
        return self.numbers.descent_m

    @property
    def time_s(self) -> float:
        """From the vehicle's speeds; else a walker's, from the step cost."""
        return self.numbers.time_s

    @property
    def energy_j(self) -> float:
        """From the vehicle's model; NaN where it has none."""
        return self.numbers.energy_j

    @property
    def bound(self) -> float:
        """The path costs at most this many times the optimum; inf where that is unknown, or costs
        may be below 0.
        """
        if self.lower_bound > 0.0:
            return self.cost / self.lower_bound
        return 1.0 if self.cost <= self.lower_bound else math.inf

    @property
    def optimality(self) -> str:
        """How far the cost may be from the optimum: what is likely, and what is proven."""
        if self.bound <= 1.0 + 1e-6:
            return "the optimum"
        if math.isinf(self.bound):
            return f"no path costs less than {self.lower_bound:.6g}"
        likely = _LIKELY[(self.vehicle is not None) + (self.states is not None)]
        words = f"proven to be at most {self.bound:.5g} times the optimum"
        if self.bound > 1.0 + 0.01 * likely:
            words = f"likely within {likely} % of the optimum, {words}"
        return words

    def summary(self) -> dict[str, object]:
        """The plan without its arrays, ready for JSON (inf and NaN as None)."""
        line: dict[str, object] = {}
        if self.waypoints is not None:
            sharpest = f"sharpest_curvature_per_{'cell' if self.along is None else 'm'}"
            line = {
                "line_cost": _finite(self.line_cost),
                sharpest: _finite(self.curvatures.max(initial=0.0)),
            }
        return {
            "status": str(self.status),
            "method": str(self.planner or self.method),
            "source": None if self.source is None else str(self.source),
            **{
                name: _finite(getattr(self, name))
                for name in ("cost", "length", "traverse_cost", "lower_bound")
            },
            "bound": _finite(self.bound) if self.ok else None,
            "cells": len(self.path),
            **{name: _finite(number) for name, number in self.numbers._asdict().items()},
            "expansions": self.expansions,
            "threshold": _finite(self.threshold),
            "choice": self.choice,
            "reason": self.reason,
            **line,
            **({} if self.states is None else {"arcs": [asdict(arc) for arc in self.arcs]}),
            "timings_ms": {stage: round(ms, 3) for stage, ms in self.timings_ms.items()},
        }

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the path, and the region where it was kept, with matplotlib, a cell a unit; by
        default on new axes. They are labelled in metres where these are known.
        """
        from nnpp_edge.runtime.planners.plan_shown import draw

        sides_m = None if self.along is None else self.along.sides_m
        title = f"{self.status}: {self.planner or self.method}"
        return draw(self.line, self.region, title, ax, sides_m)

    def __str__(self) -> str:
        """Its figures, a line each."""
        rows: dict[str, object] = {"status": self.status, "method": self.planner or self.method}
        rows |= {
            name: value for name in ("source", "choice", "reason") if (value := getattr(self, name))
        }
        if self.ok:
            told = f"{self.cost:.6g}, {self.optimality}"
            rows |= {"cost": told, "length": f"{self.length:.6g} cells"}
        if self.waypoints is not None:
            rows["line integral"] = f"{self.line_cost:.6g}, {len(self.waypoints)} way points"
        if math.isfinite(self.ground_length_m):
            up_and_down = f"{self.climb_m:.4g} m up, {self.descent_m:.4g} m down"
            rows["on the ground"] = f"{self.ground_length_m:.6g} m, {up_and_down}"
        rows["expansions"] = self.expansions
        if "total" in self.timings_ms:
            rows["time"] = f"{self.timings_ms['total']:.3g} ms"
        return "\n".join(f"{name:<15}{value}" for name, value in rows.items())


def _finite(number: float) -> float | None:
    return round(float(number), 6) if math.isfinite(number) else None
