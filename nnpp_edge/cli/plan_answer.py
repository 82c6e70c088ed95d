"""What `nnpp-edge plan` answers: for people, for programs, and as files."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import asdict, dataclass
from math import isfinite, nan
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import click

from nnpp_edge.cli.cost_summary import MapSize

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.cells import Cell
    from nnpp_edge.runtime.planners.plan import Plan
    from nnpp_edge.runtime.planners.tour import Tour
    from nnpp_edge.runtime.terrain.vehicle import Vehicle
    from nnpp_edge.terrain.georeference import Place
    from nnpp_edge.terrain.route import Route
    from nnpp_edge.viz.sheet import Cells

_MOST_UNEQUAL_SIDES = 0.02
"""Cells whose sides differ by more than this share are warned of."""
_PROPERTIES = ("status", "method", "source", "cost")
"""Figures that path.geojson repeats, beside those along the way."""
_ANGLES = (("pitched", "pitch"), ("rolled", "roll"), ("tilted", "tilt"))
_COMPARED = ("method", "source", "status", "cost", "length", "expansions")
"""Figures of a plan that the comparison repeats."""


@dataclass(frozen=True)
class Compared:
    """A method's plan beside that of exact A*; times are medians."""

    plan: Plan
    exact: Plan
    time_ms: float
    exact_time_ms: float

    @property
    def gap(self) -> float | None:
        """Share by which the plan costs more than the optimum; None without both paths."""
        if not (self.plan.ok and self.exact.ok):
            return None
        above = self.plan.cost - self.exact.cost
        return above / abs(self.exact.cost) if self.exact.cost else 0.0  # below 0 where energy is got back

    def figures(self) -> dict[str, object]:
        """Ready for JSON."""
        summary = self.plan.summary()
        speedup = None if self.gap is None else self.exact_time_ms / self.time_ms
        own = {"gap": self.gap, "time_ms": self.time_ms, "speedup": speedup}
        return {**{name: summary[name] for name in _COMPARED}, **own}

    def row(self) -> list[str]:
        """For people."""
        cost = gap = speedup = "–"
        if self.plan.ok:
            cost = f"{self.plan.cost:.6g}"
        if self.gap is not None:
            gap, speedup = f"{100.0 * self.gap:.2f} %", f"{self.exact_time_ms / self.time_ms:.2f}"
        ends = [str(self.plan.method), str(self.plan.source), str(self.plan.status)]
        return [*ends, cost, gap, f"{self.time_ms:.2f}", speedup, str(self.plan.expansions)]


class Near(NamedTuple):
    """A part of a map, from its first cell on: what lies around a start or goal."""

    origin: Cell
    elevation: Float2D
    cost: Float2D


class Planned(NamedTuple):
    """An answer, and what to draw and to say of its map."""

    answer: Answer
    cost: Float2D
    """Of the map, or of one whose cells are `factor` times as large."""
    shade: NDArray[np.uint8] | None
    factor: int
    near: Near
    """The whole map, or what lies around an end that is impassable."""


def refuse_impassable(place: Place) -> NoReturn:
    """InvalidMapError for a map without a passable cell; for programs, the status as well."""
    from nnpp_edge.runtime.errors import InvalidMapError

    if click.get_current_context().params["as_json"]:
        click.echo(json.dumps({"status": "INVALID_MAP"}))
    raise InvalidMapError(f"{place.source}: wanted a map to plan on, got {MapSize.of(place)}, all impassable")


def warn_if_not_square(place: Place) -> None:
    """Warn of cells whose sides differ."""
    size, width = place.cell_size_m, place.cell_width_m
    if abs(size - width) > _MOST_UNEQUAL_SIDES * size:
        warnings.warn(
            f"cells are {size:.4g} m from north to south and {width:.4g} m from east to west. Slopes and the path's "
            "length in metres allow for it; the search takes cells as square",
            stacklevel=2,
        )


def warn_if_steep(answer: Answer) -> None:
    """Warn of steps that are steeper than the limit on the ground around a cell."""
    if steps := answer.steep_steps:
        warnings.warn(
            f"steps of the path above {answer.hard_slope_deg:g}°: {len(steps)}, the steepest {max(steps):.1f}°. "
            "The limit is on the plane through a cell and its neighbours, not on a single step",
            stacklevel=2,
        )


@dataclass(frozen=True)
class WindowsRead:
    """What planning on a map that is read by windows took."""

    gigabytes: float
    """Of heights, as they are stored uncompressed."""
    read_again: float
    """Cells read again, as a share of the map's."""
    map_s: float
    """Seconds for reading all heights once and making the coarse levels."""
    peak_memory_gb: float
    """Of the whole process."""

    def __str__(self) -> str:
        again = f"{100 * self.read_again:.1f} % of the cells again"
        return (
            f"{self.gigabytes:.2f} GB by windows, {again}, coarse levels in {self.map_s:.1f} s, peak memory "
            f"{self.peak_memory_gb:.2f} GB"
        )


@dataclass(frozen=True)
class Answer:
    """A plan on its map, and what was planned beside it."""

    plan: Plan
    route: Route
    start: Cell
    goal: Cell
    goals: list[tuple[Cell, Plan]]
    """Where several goals were given: each with its plan, the nearest first."""
    compared: list[Compared]
    exact_path: Cells | None
    """The exact optimum where another method was compared with it."""
    loading_included: bool
    """Whether the plan's times hold those of loading compiled code and the network."""
    windows: WindowsRead | None = None
    """What was read, where the map was read by windows."""
    vehicle: Vehicle | None = None
    """Whose poses the path goes by; None for a point."""
    stands: NDArray[np.bool_] | None = None
    """(H, W) cells on which the vehicle stands in some heading, for the picture."""
    point_path: Cells | None = None
    """The optimum of a point between the same ends, for the picture."""
    step_cost: str = "paper"
    """By which steps cost."""
    tour: Tour | None = None
    """Where the path leads by way of other places."""
    reached: int | None = None
    """Cells that can be reached from the start, where no path leads to the goal."""
    hard_slope_deg: float = math.inf
    """Slope of a cell's fitted plane beyond which it is impassable; inf without a limit, or where poses decide."""

    @property
    def steep_steps(self) -> list[float]:
        """Degrees, up or down, of the path's steps that are steeper than the limit of slope."""
        if self.plan.along is None or not self.plan.ok:
            return []
        slopes = abs(self.plan.along.slopes_deg)
        return list(slopes[slopes > self.hard_slope_deg].tolist())

    def figures(self, files: list[str]) -> dict[str, object]:
        """Ready for JSON."""
        plan = self.plan
        figures: dict[str, object] = {
            **plan.summary(),
            **self.route.worst,
            "loading_included": self.loading_included,
            "start": self.start,
            "goal": self.goal,
            **asdict(MapSize.of(self.route.dem)),
        }
        if isfinite(self.hard_slope_deg):
            steps = self.steep_steps
            steepest = round(max(steps), 4) if steps else None
            figures["steps_above_hard_slope"] = {"count": len(steps), "steepest_deg": steepest}
        if plan.along is not None and plan.along.mobility.energy is not None:
            figures["gravity_m_s2"] = plan.along.mobility.energy.gravity_m_s2
        if self.step_cost != "paper":
            figures["step_cost"] = self.step_cost
        if self.compared:
            figures["compare"] = [compared.figures() for compared in self.compared]
        if self.reached is not None:
            figures["reached_cells"] = self.reached
        if self.tour:
            figures["via"] = self._via()
        if self.goals:
            plans = ((goal, plan.summary()) for goal, plan in self.goals)
            figures["goals"] = [{"goal": goal, "status": s["status"], "cost": s["cost"]} for goal, s in plans]
        if self.windows:
            figures["windows"] = asdict(self.windows)
        if self.vehicle is not None:
            figures["vehicle"] = asdict(self.vehicle)
            figures["checks"] = plan.checks
            figures["waypoints"] = self.route.stands()
        if plan.waypoints is not None:
            figures["line"] = {
                "row_col": plan.waypoints.round(4).tolist(),
                "heading_deg": plan.waypoint_headings_deg.round(3).tolist(),
                "curvature_per_m": plan.curvatures.round(6).tolist(),
            }
        if files:
            figures["files"] = files
        return figures

    def _line(self) -> str:
        """Of the way points, in words."""
        plan, sharpest = self.plan, self.plan.curvatures.max(initial=0.0)
        turns = f", sharpest turn of {1.0 / sharpest:.3g} m radius" if sharpest > 0.0 else ""
        points = 0 if plan.waypoints is None else len(plan.waypoints)
        return f"{points} way points, line integral {plan.line_cost:.6g}{turns}"

    def text(self, files: list[str]) -> str:
        """For people."""
        from nnpp_edge.progress import render_table
        from nnpp_edge.runtime.map.slope_cost import unit_of
        from nnpp_edge.viz.sheet import metres

        plan, length = self.plan, metres(self.route.length_m)
        why = plan.choice if plan.ok else plan.reason
        lines = {str(plan.status): f"{plan.method} ({plan.source})" + (f": {why}" if why else "")}
        lines["map"] = str(MapSize.of(self.route.dem))
        if self.tour:
            lines["via"] = self._order()
        if self.goals:
            results = (f"{goal} {f'{plan.cost:.6g}' if plan.ok else plan.status}" for goal, plan in self.goals)
            lines["goals"] = ", ".join(results)
        if plan.ok:
            lines["path"] = f"{len(plan.path)} cells, {length}"
            lines |= self.on_the_ground()
            cost = f"{plan.cost:.6g} {unit_of(self.step_cost)}".rstrip()
            lines["cost"] = f"{cost}, {self._optimality()}"
            if plan.waypoints is not None:
                lines["line"] = self._line()
            lines["CC"] = f"{plan.traverse_cost:.6g}"
        elif len(plan.path):
            lines["path"] = f"{len(plan.path)} cells so far, {length}"
        if self.reached is not None:
            lines["reached"] = f"{self.reached} cells of the map, from the start"
        if self.vehicle is not None and plan.ok and "tilt_deg" in self.route.standing:
            lines["vehicle"] = self._worst()
        lines["expansions"] = str(plan.expansions)
        stages = ", ".join(f"{name} {ms:.2f}" for name, ms in plan.timings_ms.items() if name != "total")
        loading = ", loading included" if self.loading_included else ""
        lines["time"] = f"{plan.timings_ms['total']:.2f} ms{loading} ({stages})"
        if self.windows:
            lines["read"] = str(self.windows)
        if files:
            lines["written"] = ", ".join(files)
        text = "\n".join(f"{name:<12}{value}" for name, value in lines.items())
        if not self.compared:
            return text
        header = ("method", "source", "status", "cost", "gap", "ms", "speed-up", "expansions")
        return text + "\n" + render_table(header, [compared.row() for compared in self.compared])

    def properties(self) -> dict[str, object]:
        """Figures that the path carries in files for maps."""
        figures = self.figures([])
        line = () if self.plan.waypoints is None else ("line_cost", "sharpest_curvature_per_m")
        return {name: figures[name] for name in (*_PROPERTIES, *line, *self.plan.numbers._fields, *self.route.worst)}

    def on_the_ground(self) -> dict[str, str]:
        """What is known of the way where its heights are."""
        from nnpp_edge.viz.sheet import metres

        numbers, along = self.plan.numbers, self.plan.along
        if along is None or not isfinite(numbers.climb_m):
            return {}
        lines = {
            "ground": f"{metres(numbers.ground_length_m)} long, {metres(numbers.climb_m)} up and "
            f"{metres(numbers.descent_m)} down, at most {numbers.steepest_up_deg:.1f}° up and "
            f"{numbers.steepest_down_deg:.1f}° down",
        }
        energy, model = "", along.mobility.energy
        if model is not None:
            energy = f", {numbers.energy_j / 1000.0:.4g} kJ at {model.gravity_m_s2:.3g} m/s²"
        lines["way"] = f"{duration(numbers.time_s)} {along.time_by}{energy}"
        return lines

    def _via(self) -> dict[str, object]:
        """The tour, ready for JSON."""
        assert self.tour is not None
        names = ("status", "method", "source", "cost", "length_m", "time_s", "energy_j", "climb_m", "descent_m")
        legs = [{name: leg.summary()[name] for name in names} for leg in self.tour.legs]
        given = self.tour.given_cost
        return {
            "stops": self.tour.stops,
            "order": [each + 1 for each in self.tour.order],
            "given_cost": round(given, 6) if isfinite(given) else None,
            "legs": legs,
        }

    def _order(self) -> str:
        """In which order the places between are visited, and what that saves."""
        tour = self.tour
        assert tour is not None
        cells = ", ".join(f"{number + 1} {cell}" for number, cell in zip(tour.order, tour.stops[1:-1], strict=True))
        if not (self.plan.ok and tour.given_cost > 0.0):
            return cells
        return f"{cells}: {100.0 * (1.0 - self.plan.cost / tour.given_cost):.1f} % less than in the order given"

    def _worst(self) -> str:
        """The steepest that the vehicle may stand on the path, its least clearance, and the poses checked."""
        worst = self.route.worst
        angles = [f"{word} by at most {worst[f'steepest_{name}_deg'] or nan:.1f}°" for word, name in _ANGLES]
        clearance = worst["least_clearance_m"]
        clear = "no clearance known" if clearance is None else f"clear by at least {clearance:.2f} m"
        return f"{', '.join(angles)}, {clear}, {self.plan.checks} poses checked"

    def _optimality(self) -> str:
        """How far from the optimum the path's cost is, or may be."""
        if self.plan.bound <= 1.0 + 1e-6:
            return "the optimum"
        if self.compared and self.compared[0].gap is not None:
            return f"{100.0 * self.compared[0].gap:.2f} % above the optimum"
        least = f"{self.plan.lower_bound:.6g}"
        if math.isinf(self.plan.bound):
            return f"no path costs less than {least}"
        return f"at most {self.plan.bound:.3f} times the optimum (no path costs less than {least})"


def duration(seconds: float) -> str:
    """A time for people."""
    if seconds < 60.0:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    parts = ((hours, "h"), (minutes, "min"), (0 if hours else rest, "s"))
    return " ".join(f"{number} {unit}" for number, unit in parts if number)
