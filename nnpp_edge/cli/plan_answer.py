"""The answer of `nnpp-edge plan`: for people, for programs, and as files."""

import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from math import isfinite, nan
from pathlib import Path

from nnpp_edge.cli.maps import size_in_words, size_of
from nnpp_edge.cli.text import Row, aligned, columns, duration, table, work
from nnpp_edge.files import write_all
from nnpp_edge.runtime import Plan, Vehicle
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.planners.tour import Tour
from nnpp_edge.runtime.robots.slope.cost import unit_of
from nnpp_edge.terrain.route import Facts, Leg, Route
from nnpp_edge.terrain.styles import LINE_STYLE
from nnpp_edge.viz.picture import Reached, png_bytes
from nnpp_edge.viz.sheet import Picture, metres

_PROPERTIES = ("status", "method", "source", "cost")
"""Figures that path.geojson repeats, beside those along the way."""
_CLOSE = 0.1
"""Share of a body's limit below which what is left of it is warned of."""
_ANGLES = (("pitched", "pitch"), ("rolled", "roll"), ("tilted", "tilt"))
_OF_LEGS = (*_PROPERTIES, "length_m", "time_s", "energy_j", "climb_m", "descent_m")
_COMPARED = columns(
    "method | source | status | cost: cost .6g | gap: gap z.2% | ms: time_ms .2f | speed-up: "
    "speedup .2f | expansions"
)


@dataclass(frozen=True)
class Answer:
    """A plan on its map, what was planned beside it, and its picture."""

    plan: Plan
    route: Route
    start: Cell
    goal: Cell
    picture: Callable[[], Picture]
    figure: Callable[[Sequence[tuple[str, Cell]], str], bytes]
    """Makes the figure for a paper, of the stops with their names, of a kind such as ``.pdf``."""
    names: Sequence[str]
    """Of the stops, from start to goal."""
    goals: Sequence[tuple[Cell, Plan]] = ()
    """Where several goals were given: each with its plan, the nearest first."""
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
        margin = self.route.worst.get("least_margin")
        if margin is not None and margin < _CLOSE:
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

    def figures(self, files: list[str]) -> dict[str, object]:
        plan = self.plan
        steps = self.steep_steps
        along = plan.along
        tour = self.tour
        figures: dict[str, object] = {
            **plan.summary(),
            **self.route.worst,
            "loading_included": self.loading_included,
            "start": self.start,
            "goal": self.goal,
            **size_of(self.route.dem),
        }
        if isfinite(self.hard_slope_deg):
            steepest = round(max(steps), 4) if steps else None
            figures["steps_above_hard_slope"] = {"count": len(steps), "steepest_deg": steepest}
        if along is not None and along.mobility.energy is not None:
            figures["gravity_m_s2"] = along.mobility.energy.gravity_m_s2
        if tour:
            figures["via"] = {
                "stops": tour.stops,
                "order": [each + 1 for each in tour.order],
                "given_cost": round(tour.given_cost, 6) if isfinite(tour.given_cost) else None,
                "legs": [{name: leg.summary()[name] for name in _OF_LEGS} for leg in tour.legs],
            }
        if self.vehicle is not None:
            figures |= {
                "vehicle": asdict(self.vehicle),
                "checks": plan.checks,
                "waypoints": self.route.stands(),
            }
        if plan.waypoints is not None:
            figures["line"] = {
                "row_col": plan.waypoints.round(4).tolist(),
                "heading_deg": plan.waypoint_headings_deg.round(3).tolist(),
                "curvature_per_m": plan.curvatures.round(6).tolist(),
            }
        goals = [(goal, plan.summary()) for goal, plan in self.goals]
        more = {
            "step_cost": None if self.step_cost == "paper" else self.step_cost,
            "compare": self.compared,
            "goals": [
                {"goal": goal} | {name: told[name] for name in ("status", "cost")}
                for goal, told in goals
            ],
            "files": files,
        }
        figures |= {name: value for name, value in more.items() if value}
        if self.ended is not None:
            figures["reached_cells"] = int(self.ended.cells.sum())
            figures["reached_from"] = self.ended.begun
            figures["closest_cell"] = self.ended.closest
        return figures

    def properties(self) -> dict[str, object]:
        """Figures that the path carries in files for maps."""
        figures = self.figures([])
        line = () if self.plan.waypoints is None else ("line_cost", "sharpest_curvature_per_m")
        return {
            name: figures[name]
            for name in (*_PROPERTIES, *line, *self.plan.numbers._fields, *self.route.worst)
        }

    def text(self, files: list[str]) -> str:
        lines = aligned(dict(self._lines(files)))
        return f"{lines}\n{table(self.compared, _COMPARED)}" if self.compared else lines

    def _lines(self, files: list[str]) -> Iterator[tuple[str, str]]:
        plan = self.plan
        length = metres(self.route.length_m)
        why = plan.choice if plan.ok else plan.reason
        found = f"{plan.method} ({plan.source})"
        yield str(plan.status), f"{found}: {why}" if why else found
        yield "map", size_in_words(self.route.dem)
        if self.tour:
            yield "via", self._order(self.tour)
        ends = [(at, f"{it.cost:.6g}" if it.ok else it.status) for at, it in self.goals]
        yield "goals", ", ".join(f"{at} {words}" for at, words in ends)
        if plan.ok:
            yield "path", f"{len(plan.path)} cells, {length}"
            yield from self.on_the_ground().items()
            cost = f"{plan.cost:.6g} {unit_of(self.step_cost)}".rstrip()
            yield "cost", f"{cost}, {self._optimality()}"
            if plan.waypoints is not None:
                turns = _sharpest("sharpest turn", plan.curvatures)
                count = len(plan.waypoints)
                yield "line", f"{count} way points, line integral {plan.line_cost:.6g}{turns}"
            if plan.arcs:
                back = sum(arc.length_m for arc in plan.arcs if arc.gear < 0)
                turns = _sharpest("sharpest", [abs(arc.curvature_per_m) for arc in plan.arcs])
                yield "arcs", f"{len(plan.arcs)} pieces{turns}, {metres(back)} of them backwards"
            yield "CC", f"{plan.traverse_cost:.6g}"
        elif len(plan.path):
            yield "path", f"{len(plan.path)} cells so far, {length}"
        if self.ended is not None:
            limit = f"; cells steeper than {self.hard_slope_deg:g}° are impassable"
            limited = limit if isfinite(self.hard_slope_deg) else ""
            begun = self.ended.begun
            other = "goal" if begun == "start" else "start"
            reached = f"{self.ended.cells.sum()} cells of the map, from the {begun}"
            closest = f"{self.ended.closest} is the closest to the {other}"
            yield "reached", f"{reached}; {closest}{limited}"
        if self.vehicle is not None and plan.ok and "tilt_deg" in self.route.standing:
            worst = self.route.worst
            angles = [
                f"{word} by at most {worst[f'steepest_{name}_deg'] or nan:.1f}°"
                for word, name in _ANGLES
            ]
            clear = "no clearance known"
            if (clearance := worst["least_clearance_m"]) is not None:
                clear = f"clear by at least {clearance:.2f} m"
            yield "vehicle", f"{', '.join(angles)}, {clear}, {plan.checks} poses checked"
        yield "expansions", str(plan.expansions)
        stages = [f"{name} {ms:.2f}" for name, ms in plan.timings_ms.items() if name != "total"]
        loading = ", loading included" if self.loading_included else ""
        yield "time", f"{plan.timings_ms['total']:.2f} ms{loading} ({', '.join(stages)})"
        yield "written", ", ".join(files)

    def on_the_ground(self) -> dict[str, str]:
        """Figures of the way where its heights are known."""
        numbers = self.plan.numbers
        along = self.plan.along
        if along is None or not isfinite(numbers.climb_m):
            return {}
        way = [f"{duration(numbers.time_s)} {along.time_by}"] if along.time_by else []
        if (model := along.mobility.energy) is not None:
            way.append(f"{work(numbers.energy_j)} at {model.gravity_m_s2:.3g} m/s²")
        return {
            "ground": f"{metres(numbers.ground_length_m)} long, {metres(numbers.climb_m)} up and "
            f"{metres(numbers.descent_m)} down, at most {numbers.steepest_up_deg:.1f}° up and "
            f"{numbers.steepest_down_deg:.1f}° down",
            "way": ", ".join(way),
        }

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

    @property
    def stops(self) -> Sequence[Cell]:
        """Start, the places between in the order of visits, and goal."""
        return self.tour.stops if self.tour else (self.start, self.goal)

    @property
    def named(self) -> list[tuple[str, Cell]]:
        """The stops with their names."""
        return list(zip(self.names, self.stops, strict=True))

    def save(self, paths: list[Path], older: list[Path]) -> list[str]:
        """Write all files in place of the older ones, or none; their names."""
        files = [str(path) for path in paths]
        write_all({path: self._content(path, files) for path in paths}, older)
        return files

    def _geopackage(self) -> bytes:
        """The path, its stops and its legs."""
        roles = ["start", *["via"] * (len(self.stops) - 2), "goal"]
        stations: list[tuple[Cell, Facts]] = []
        for (name, (row, col)), role in zip(self.named, roles, strict=True):
            stations.append(((row, col), {"name": name, "role": role, "row": row, "col": col}))
        legs: list[Leg] = []
        for number, leg in enumerate(self.tour.legs if self.tour else (self.plan,), 1):
            begin, end = self.names[number - 1 : number + 1]
            told = leg.summary()
            facts = {"leg": number, "from": begin, "to": end}
            if leg.along is not None and len(leg.path) > 1:
                legs.append((leg.along, facts | {name: told[name] for name in _OF_LEGS}))
        return self.route.geopackage(self.properties(), stations, legs)

    def _content(self, path: Path, files: list[str]) -> bytes:
        """The content of a file, by its name."""
        route = self.route
        makers: dict[str, Callable[[], bytes]] = {
            "path.geojson": lambda: route.geojson(self.properties()),
            "path.csv": route.csv,
            "plan.json": lambda: json.dumps(self.figures(files), indent=1).encode(),
            "plan.png": lambda: png_bytes(self.picture()),
            "path.gpkg": self._geopackage,
            "path.qml": lambda: LINE_STYLE.encode(),
            "path.gpx": lambda: route.gpx("nnpp-edge plan", self.named),
        }
        if path.stem == "figure":
            return self.figure(self.named, path.suffix)
        return makers[path.name]()


def _sharpest(what: str, curvatures_per_m: Iterable[float]) -> str:
    """The least radius among turns, for a line on them; empty without one."""
    sharpest = max(curvatures_per_m, default=0.0)
    return f", {what} of {1.0 / sharpest:.3g} m radius" if sharpest > 0.0 else ""
