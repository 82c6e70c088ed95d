"""Answers to the page: the path with its figures and profile, a method beside others, layers.

A layer is a byte a pixel, with no more pixels than a screen has, whatever the map. The page colours
it (`page/layers.js`); nothing is compressed on the way to this machine's own browser.
"""

import math
import threading
from contextlib import suppress
from functools import lru_cache
from typing import Annotated, Literal

import cv2
import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Sides
from nnpp_edge.runtime.compiled import notice
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError
from nnpp_edge.runtime.kernels.poses import REFUSALS
from nnpp_edge.runtime.options import STEP_COSTS, STILL
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.robots.slope.cost import unit_of
from nnpp_edge.runtime.terrain.traversability import terms_in_words, terrain_terms
from nnpp_edge.terrain.coordinates import lonlat_at
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.facts import lines_of, plan_facts, values_of
from nnpp_edge.terrain.route import Route, places_of
from nnpp_edge.view.asked import Asked, Site, command_of
from nnpp_edge.view.landscape import Landscape, painted
from nnpp_edge.viz.palette import REFUSED, rgb
from nnpp_edge.viz.picture import refused_on
from nnpp_edge.viz.relief import hillshade

IMPASSABLE = 255
UNKNOWN = 0
"""Of a pixel of costs, and of one of the relief."""
FIRST_REFUSED = 249
"""Of a pixel of costs where the first of `REFUSALS` refuses the vehicle; the others follow."""
_STEEPEST_DEG = 40.0
"""Slope from which on its layer grows no stronger."""
_BLOCKED = 0.25
"""Share of a pixel's cells from which on it is impassable."""
_STANDING = ("heading_deg", "tilt_deg", "clearance_m")
"""How a vehicle stands along the path, for the page."""
_MEASURES = ("length_m", "width_m", "radius_m")
_DAY_S = 86400
_TIMES_S = (1, 5, 15, 60, 300, 900, 1800, 3600, 7200, 14400, 28800, _DAY_S, 5 * _DAY_S, 20 * _DAY_S)
"""Of which bands of what can be reached are as wide as one."""
_MOST_LANDSCAPES = 2
"""That are kept; each holds a planner's memory."""
Answer = dict[str, object]
Layer = NDArray[np.uint8]


class Question(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of the page's requests."""

    want: Literal["path", "relief", "slope", "cost", "reach", "compare", "place", "file"]
    asked: Asked
    method: Method = Method.AUTO
    """To compare."""
    pixels: Annotated[int, Meta(ge=64, le=2048)] = 1024
    """Of a side of a layer, at most."""
    at: Cell = (0, 0)
    within: float = math.inf
    """The most that reaching a place may cost."""
    format: Literal["geojson", "gpkg"] = "geojson"
    """Of the file; `at` is the place that is asked about."""


_DECODER = msgspec.json.Decoder(Question)


class Answerer:
    """Answers the page, one question at a time, whichever threads ask."""

    notice = ""
    """A line on whatever is being waited for, such as kernels that are compiled: of the process, as
    they are.
    """

    def __init__(self, site: Site, first: Asked) -> None:
        self.site = site
        self.first = first
        self._lock = threading.Lock()
        self._landscapes = lru_cache(_MOST_LANDSCAPES)(lambda asked: Landscape(site, asked))

    def landscape(self, asked: Asked) -> Landscape:
        """The map that is asked of, with its obstacles."""
        found = self._landscapes(asked.of_the_map)
        found.lay(asked.obstacles)
        return found

    def opening(self) -> bytes:
        """JSON of the site as the page shows it, and of the first question."""
        dem = self.site.dem
        bodies = {}
        for name, body in self.site.bodies.items():
            vehicle = body.posed
            bodies[name] = {
                "time": body.mobility.time is not None,
                "energy": body.mobility.energy is not None,
                "arcs": body.has_arcs,
                "clearance_m": vehicle and vehicle.clearance_m,
                "outline": body.vehicle
                and {name: getattr(body.vehicle, name) for name in _MEASURES},
                "max_tilt_deg": vehicle and vehicle.max_tilt_deg,
            }
        shown = {
            "refused": [{"colour": rgb(colour), "words": words} for colour, words in REFUSED],
            "name": dem.source.name,
            "shape": dem.shape,
            "sides_m": (dem.cell_size_m, dem.cell_width_m),
            "methods": STILL,
            "step_costs": STEP_COSTS,
            "bodies": bodies,
            "asked": self.first,
        }
        return msgspec.json.encode(shown)

    def answer(self, question: bytes) -> bytes:
        """A line of JSON, then the bytes of the ``layer`` whose shape it holds, or of the ``file``,
        if it does.

        What cannot be done is an answer too, a ``problem`` in one line.
        """
        more: Layer | bytes | None = None
        try:
            with refused_as(InvalidQueryError, "a question cannot be read"):
                asked = _DECODER.decode(question)
            with self._lock:
                answer, more = self._answer(asked)
        except (NnppEdgeError, MemoryError) as error:
            words = "not enough memory" if isinstance(error, MemoryError) else str(error)
            answer = {"problem": words}
        Answerer.notice = ""
        notice.say_once.cache_clear()  # more may have to be compiled for the next
        if isinstance(more, np.ndarray):
            answer |= {"layer": more.shape}
        return msgspec.json.encode(answer) + b"\n" + (b"" if more is None else bytes(more))

    def _answer(self, question: Question) -> tuple[Answer, Layer | bytes | None]:
        asked = question.asked
        dem = self.site.dem
        pixels = question.pixels
        sides = dem.cell_size_m, dem.cell_width_m
        if question.want == "relief":
            return {}, relief(dem.elevation, sides, pixels)
        if question.want == "slope":
            return {}, slope(dem.elevation, sides, pixels)
        landscape = self.landscape(asked)
        if question.want == "place":
            words = place_in_words(dem, question.at)
            if not landscape.planner.is_passable(question.at):
                why = landscape.planner.state.grid.robot.stance.why_blocked(question.at)
                words.append(f"it cannot stand: {why}" if why else "impassable")
            return {"words": words}, None
        if question.want == "cost":
            cost = np.where(painted(dem.shape, asked.obstacles), np.float32(np.inf), landscape.cost)
            refused = refused_on(landscape.planner)
            limits = [] if refused is None else np.unique(refused[refused > 0]).tolist()
            layer = costs(cost, pixels, refused)
            layer[smaller(np.isnan(dem.elevation), pixels) > _BLOCKED] = UNKNOWN
            return {"refused": limits}, layer
        if question.want == "reach":
            field = landscape.planner.reach(asked.start, question.within)
            return reach(field, pixels, unit_of(asked.step_cost) == "s")
        if question.want == "compare":
            plan, time_ms = landscape.compare(asked, question.method)
            told = plan.summary()
            answer = {name: told[name] for name in ("status", "method", "cost", "expansions")}
            answer |= {"time_ms": round(time_ms, 3), "line": plan.line.tolist(), "share": None}
            if plan.region is None:
                return answer, None
            region = plan.region.mask()
            answer["share"] = float(region.mean())
            return answer, (smaller(region, pixels) * 255.0).astype(np.uint8)
        plan = landscape.plan(asked, asked.method)
        if question.want == "file":
            name = f"{self.site.path.stem}-path.{question.format}"
            return {"file": name}, file_of(dem, asked, plan, landscape, question.format)
        return path_answer(self.site, asked, landscape, plan), None


def path_answer(site: Site, asked: Asked, landscape: Landscape, plan: Plan) -> Answer:
    """A plan: its figures, its line, what lies along it, and how to ask for it elsewhere."""
    unit = unit_of(asked.step_cost)
    route = None
    if plan.along is not None and len(plan.path):
        route = Route.of_plan(plan, landscape.cost, site.dem, landscape.poses)
    facts = plan_facts(plan, route.facts if route else (), unit)
    answer: Answer = {
        "figures": plan.summary(),
        "facts": list(lines_of(facts).items()),
        "ok": plan.ok,
        "unit": unit,
        "rows": [],
        "cols": [],
        "warnings": landscape.warnings,
        "command": command_of(site, asked),
    }
    if plan.status.endswith("BLOCKED") and landscape.poses is None:
        end = asked.start if plan.status.startswith("START") else asked.goal
        why = f"{plan.reason}: {ground_in_words(site.dem, end)}"
        answer["figures"] = plan.summary() | {"reason": why}
    if plan.along is None or route is None:
        return answer
    rows, cols = plan.along.points.T
    for name, values, digits in (
        ("rows", rows, 2),
        ("cols", cols, 2),
        ("distance_m", plan.along.distance_m, 1),
        ("height_m", plan.along.heights_m, 2),
        ("cost", np.minimum(route.cost, 1.0), 3),
        *((name, route.standing[name], 2) for name in _STANDING if name in route.standing),
    ):
        rounded = values.astype(float).round(digits).tolist()
        answer[name] = [each if math.isfinite(each) else None for each in rounded]
    if plan.drive is not None:
        answer["gears"] = plan.drive.gears.tolist()
    if plan.waypoints is not None:
        answer |= {"waypoints": np.round(plan.waypoints, 2).tolist(), "grid": plan.path.tolist()}
    return answer


def file_of(dem: Dem, asked: Asked, plan: Plan, landscape: Landscape, form: str) -> bytes:
    """A file with a path; InvalidQueryError without one."""
    if not plan.ok or plan.along is None:
        raise InvalidQueryError("there is no path to save")
    route = Route.of_plan(plan, landscape.cost, dem, landscape.poses)
    figures = values_of(plan_facts(plan, route.facts))
    return route.geopackage(figures) if form == "gpkg" else route.geojson(figures)


def place_in_words(dem: Dem, cell: Cell) -> list[str]:
    """Where a cell lies, and how steep it is; InvalidQueryError for none of the map."""
    if not (0 <= cell[0] < dem.shape[0] and 0 <= cell[1] < dem.shape[1]):
        raise InvalidQueryError(f"a place must lie on the map of {dem.shape} cells, got {cell}")
    at = places_of(dem, np.array([cell]))
    words = ["row {}, column {}".format(*cell), "x {:.9g}, y {:.9g}".format(*at[0])]
    with suppress(NnppEdgeError):  # no coordinate system, or nothing that knows it
        sides = zip(lonlat_at(dem, at)[0].tolist(), ("EW", "NS"), strict=True)
        angles = [f"{abs(angle):.6f}° {side[angle < 0]}" for angle, side in sides]
        words.append(", ".join(angles))
    return [*words, ground_in_words(dem, cell)]


def ground_in_words(dem: Dem, cell: Cell) -> str:
    """Height of a cell, and the terms of its cost."""
    terms = terms_in_words(dem.elevation, cell, (dem.cell_size_m, dem.cell_width_m))
    return f"height {dem.elevation[cell]:.2f} m, {terms}" if terms else "its height is unknown"


def reach(field: Float2D, pixels: int, in_seconds: bool = False) -> tuple[Answer, Layer]:
    """Cells that can be reached, width and number of bands of cost, and each pixel's: 1 the
    nearest, 0 nowhere.
    """
    known = np.isfinite(field)
    mean = mean_of_known(field, pixels)
    most = float(field[known].max(initial=0.0)) or 1.0
    power = 10.0 ** math.floor(math.log10(most / 8))  # eight bands at most, of a round width
    round_steps = [times * power for times in (1, 2, 5, 10, 20)]
    if in_seconds:
        round_steps = [*_TIMES_S, *round_steps]
    step = next(each for each in round_steps if most <= 8 * each)
    bands = 1.0 + np.maximum(mean, 0.0) / step
    layer = np.nan_to_num(bands).astype(np.uint8)
    return {"cells": int(known.sum()), "step": step, "bands": math.ceil(most / step)}, layer


def relief(elevation: Float2D, sides_m: Sides, pixels: int) -> Layer:
    """Hillshade, 40 to 245; `UNKNOWN` where fewer than half of a pixel's heights are known."""
    factor = max(max(elevation.shape) / pixels, 1.0)
    mean = mean_of_known(elevation, pixels)
    grey = hillshade(mean, *(factor * side for side in sides_m))
    grey[np.isnan(mean)] = UNKNOWN
    return grey


def slope(elevation: Float2D, sides_m: Sides, pixels: int) -> Layer:
    """Inclination of the cells, from 0 to 255 at `_STEEPEST_DEG`; 0 where unknown."""
    slopes = np.nan_to_num(terrain_terms(elevation, sides_m[0], cell_width_m=sides_m[1])[0])
    return np.asarray(
        np.minimum(smaller(slopes, pixels) * 255.0 / math.radians(_STEEPEST_DEG), 255.0), np.uint8
    )


def costs(cost: Float2D, pixels: int, refused: Layer | None = None) -> Layer:
    """Traversability costs, from 0 to 248; `IMPASSABLE` where a pixel's cells are, by a quarter of
    them.

    Where a vehicle stands in no heading on a quarter of them, `refused` from
    `robots.body.refusal.refusals`, the limit that refuses it on most, from `FIRST_REFUSED` on.
    """
    passable = cost < 1.0
    strength = smaller(np.where(passable, cost, np.float32(0.0)), pixels) * (FIRST_REFUSED - 1)
    if refused is not None:
        shares = np.stack([smaller(refused == 1 + limit, pixels) for limit in range(len(REFUSALS))])
        strength = np.where(shares.sum(0) > _BLOCKED, FIRST_REFUSED + shares.argmax(0), strength)
    strength[smaller(~passable, pixels) > _BLOCKED] = IMPASSABLE
    return strength.astype(np.uint8)


def mean_of_known(values: Float2D, pixels: int) -> Float2D:
    """Means of the finite cells below each pixel; NaN where these are not more than half of all."""
    known = np.isfinite(values)
    share = smaller(known, pixels)
    total = smaller(np.where(known, values, np.float32(0.0)), pixels)
    return np.where(share > 0.5, total / np.maximum(share, np.float32(0.5)), np.float32(np.nan))


def smaller(values: NDArray[np.float32] | NDArray[np.bool_], pixels: int) -> Float2D:
    """Means of the cells below each pixel, at most so many a side."""
    numbers: Float2D = values.astype(np.float32, copy=False)
    rows, cols = numbers.shape
    if (factor := max(rows, cols) / pixels) > 1.0:
        size = max(round(cols / factor), 1), max(round(rows / factor), 1)
        numbers = np.asarray(cv2.resize(numbers, size, interpolation=cv2.INTER_AREA), np.float32)
    return numbers
