"""The answer of `nnpp-edge plan`: for people, for programs, and as files."""

import json
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from nnpp_edge.cli.maps import size_in_words, size_of
from nnpp_edge.cli.text import Row, aligned, columns, table
from nnpp_edge.files import write_all
from nnpp_edge.runtime import Plan, Vehicle
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.planners.tour import Tour
from nnpp_edge.runtime.robots.slope.cost import unit_of
from nnpp_edge.terrain.facts import Fact, lines_of, plan_facts, values_of
from nnpp_edge.terrain.route import Route
from nnpp_edge.viz.picture import Reached, encoded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CLOSE = 0.1
"""Share of a body's limit below which what is left of it is warned of."""
_COMPARED = columns(
    "method | source | status | cost: cost .6g | gap: gap z.2% | ms: time_ms .2f | speed-up: "
    "speedup .2f | expansions"
)


@dataclass(frozen=True)
class Answer:
    """A plan on its map, what was planned beside it, and its picture."""

    plan: Plan
    route: Route
    picture: "Callable[[], Figure]"
    stops: Sequence[Cell]
    """Start, the places between in the order of visits, and goal."""
    compared: Sequence[Row] = ()
    """Figures of the plan's method and others, beside the optimum."""
    loading_included: bool = True
    """Whether the plan's times hold those of loading compiled code and the network."""
    vehicle: Vehicle | None = None
    step_cost: str = "paper"
    tour: Tour | None = None
    """Where the path leads by way of other places."""
    ended: Reached | None = None
    """Where no path leads to the goal."""
    hard_slope_deg: float = math.inf
    """Slope of a cell's fitted plane beyond which it is impassable; inf without a limit, or where
    poses decide.
    """

    @property
    def steep_steps(self) -> list[float]:
        """Degrees, up or down, of the path's steps that are steeper than the limit of slope."""
        if self.plan.along is None or not self.plan.ok:
            return []
        slopes = abs(self.plan.along.slopes_deg)
        return list(slopes[slopes > self.hard_slope_deg].tolist())

    def warn_if_close(self) -> None:
        """Warn of a body that comes close to one of its limits, and of steps that are steeper than
        the limit on the ground around a cell.
        """
        margin = values_of(self.route.facts).get("least_margin")
        if isinstance(margin, float) and margin < _CLOSE:
            row, col = self.route.along.points[self.route.standing["margin"].argmin()].tolist()
            warnings.warn(
                f"the body comes within {100.0 * margin:.1f} % of one of its limits, at cell "
                f"({row:g}, {col:g}); --set reserve=0.1 keeps a tenth of each limit free",
                stacklevel=2,
            )
        if steps := self.steep_steps:
            warnings.warn(
                f"steps of the path above {self.hard_slope_deg:g}°: {len(steps)}, the steepest "
                f"{max(steps):.1f}°. "
                "The limit is on the plane through a cell and its neighbours, not on a single step",
                stacklevel=2,
            )

    @property
    def facts(self) -> list[Fact]:
        """What is known of the path, for all outputs."""
        more = self.route.facts
        if self.vehicle is not None:
            stands = "vehicle: {} poses checked" if "tilt_deg" in self.route.standing else ""
            more.append(Fact("checks", self.plan.checks, "", stands))
        return plan_facts(self.plan, more, unit_of(self.step_cost), self._optimality())

    def figures(self, files: list[str]) -> dict[str, object]:
        """All that programs are told."""
        plan = self.plan
        steps = self.steep_steps
        figures: dict[str, object] = {
            **plan.summary(),
            **values_of(self.facts),
            "loading_included": self.loading_included,
            "start": self.stops[0],
            "goal": self.stops[-1],
            **size_of(self.route.dem),
        }
        if isfinite(self.hard_slope_deg):
            steepest = round(max(steps), 4) if steps else None
            figures["steps_above_hard_slope"] = {"count": len(steps), "steepest_deg": steepest}
        if plan.along is not None and plan.along.mobility.energy is not None:
            figures["gravity_m_s2"] = plan.along.mobility.energy.gravity_m_s2
        if tour := self.tour:
            figures["via"] = {
                "stops": tour.stops,
                "order": [each + 1 for each in tour.order],
                "given_cost": round(tour.given_cost, 6) if isfinite(tour.given_cost) else None,
                "legs": [values_of(plan_facts(leg)) for leg in tour.legs],
            }
        if self.vehicle is not None:
            figures |= {"vehicle": asdict(self.vehicle), "waypoints": self.route.stands()}
        if plan.waypoints is not None:
            figures["line"] = {
                "row_col": plan.waypoints.round(4).tolist(),
                "heading_deg": plan.waypoint_headings_deg.round(3).tolist(),
                "curvature_per_m": plan.curvatures.round(6).tolist(),
            }
        more = {
            "step_cost": None if self.step_cost == "paper" else self.step_cost,
            "compare": self.compared,
            "files": files,
        }
        figures |= {name: value for name, value in more.items() if value}
        if self.ended is not None:
            figures["reached_cells"] = int(self.ended.cells.sum())
            figures["reached_from"] = self.ended.begun
            figures["closest_cell"] = self.ended.closest
        return figures

    def text(self, files: list[str]) -> str:
        """All that people are told."""
        plan = self.plan
        why = plan.choice if plan.ok else plan.reason
        found = f"{plan.method} ({plan.source})"
        stages = [f"{name} {ms:.2f}" for name, ms in plan.timings_ms.items() if name != "total"]
        loading = ", loading included" if self.loading_included else ""
        lines = {
            str(plan.status): f"{found}: {why}" if why else found,
            "map": size_in_words(self.route.dem),
            "via": self._order(self.tour) if self.tour else "",
            **lines_of(self.facts),
            "reached": self._reached(),
            "time": f"{plan.timings_ms['total']:.2f} ms{loading} ({', '.join(stages)})",
            "written": ", ".join(files),
        }
        told = aligned(lines)
        return f"{told}\n{table(self.compared, _COMPARED)}" if self.compared else told

    def _reached(self) -> str:
        """How far a search came that found no path."""
        if self.ended is None:
            return ""
        begun = self.ended.begun
        other = "goal" if begun == "start" else "start"
        reached = f"{self.ended.cells.sum()} cells of the map, from the {begun}"
        closest = f"{self.ended.closest} is the closest to the {other}"
        limit = f"; cells steeper than {self.hard_slope_deg:g}° are impassable"
        return f"{reached}; {closest}{limit if isfinite(self.hard_slope_deg) else ''}"

    def _order(self, tour: Tour) -> str:
        """In which order the places between are visited, and what that saves."""
        cells = ", ".join(
            f"{number + 1} {cell}"
            for number, cell in zip(tour.order, tour.stops[1:-1], strict=True)
        )
        if not (self.plan.ok and 0.0 < tour.given_cost < math.inf):
            return cells
        if list(tour.order) == sorted(tour.order):
            return f"{cells}: the order given, no cheaper one was found"
        saved = 1.0 - self.plan.cost / tour.given_cost
        return f"{cells}: {100.0 * saved:.3g} % less than in the order given"

    def _optimality(self) -> str:
        """How far from the optimum the path's cost is, or may be."""
        if self.compared and (gap := self.compared[0]["gap"]) is not None:
            return f"{100.0 * gap:.2f} % above the optimum"
        bounded = 1.0 + 1e-6 < self.plan.bound < math.inf
        least = f" (no path costs less than {self.plan.lower_bound:.6g})" if bounded else ""
        return f"{self.plan.optimality}{least}"

    def save(self, paths: list[Path]) -> list[str]:
        """Write all files, or none; their names."""
        files = [str(path) for path in paths]
        write_all({path: self._content(path, files) for path in paths})
        return files

    def _content(self, path: Path, files: list[str]) -> bytes:
        """The content of a file, by its name."""
        route = self.route
        makers: dict[str, Callable[[], bytes]] = {
            "path.geojson": lambda: route.geojson(values_of(self.facts)),
            "path.csv": route.csv,
            "plan.json": lambda: json.dumps(self.figures(files), indent=1).encode(),
            "plan.png": lambda: encoded(self.picture()),
            "path.gpkg": lambda: route.geopackage(values_of(self.facts)),
        }
        return makers[path.name]()
