"""Answers to the page: the path with its figures and profile, a method beside others, layers.

A layer is a byte a pixel, with no more pixels than a screen has, whatever the map. The page colours it
(`page/layers.js`); nothing is compressed on the way to this machine's own browser.
"""

import math
import threading
from functools import lru_cache
from typing import Annotated, Literal

import cv2
import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError
from nnpp_edge.runtime.kernels.poses import REFUSALS
from nnpp_edge.runtime.map.slope_cost import unit_of
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from nnpp_edge.view.asked import Asked, Method, Site, command_of
from nnpp_edge.view.landscape import Landscape, painted
from nnpp_edge.viz.picture import REFUSED, hillshade

IMPASSABLE, UNKNOWN = 255, 0
"""Of a pixel of costs, and of one of the relief."""
FIRST_REFUSED = 249
"""Of a pixel of costs where the first of `REFUSALS` refuses the vehicle; the others follow."""
_STEEPEST_DEG = 40.0
"""Slope from which on its layer grows no stronger."""
_BLOCKED = 0.25
"""Share of a pixel's cells from which on it is impassable."""
_MOST_LANDSCAPES = 2
"""That are kept; each holds a planner's memory."""
Answer = dict[str, object]
Layer = NDArray[np.uint8]


class Question(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of the page's requests."""

    want: Literal["path", "relief", "slope", "cost", "compare"]
    asked: Asked
    method: Method = "auto"
    """To compare."""
    pixels: Annotated[int, Meta(ge=64, le=2048)] = 1024
    """Of a side of a layer, at most."""


class Answerer:
    """Answers the page, one question at a time, whichever threads ask."""

    def __init__(self, site: Site, first: Asked) -> None:
        self.site, self.first = site, first
        self._lock = threading.Lock()
        self._landscapes = lru_cache(_MOST_LANDSCAPES)(lambda asked: Landscape(site, asked))

    def landscape(self, asked: Asked) -> Landscape:
        """The map that is asked of, with its obstacles."""
        rest = {"start": (0, 0), "goal": (0, 0), "method": "auto", "refine": False, "obstacles": ()}
        rest |= {"start_heading_deg": None, "goal_heading_deg": None}
        found = self._landscapes(msgspec.structs.replace(asked, **rest))
        found.lay(asked.obstacles)
        return found

    def opening(self) -> bytes:
        """JSON of the site as the page shows it, and of the first question."""
        dem, bodies = self.site.dem, {}
        for name, body in self.site.bodies.items():
            vehicle = body.vehicle if body.has_poses else None
            bodies[name] = {
                "time": body.mobility.time is not None,
                "energy": body.mobility.energy is not None,
                "arcs": body.has_arcs,
                "clearance_m": vehicle and vehicle.clearance_m,
                "max_tilt_deg": vehicle and vehicle.max_tilt_deg,
            }
        refused = [{"colour": colour[::-1], "words": words} for colour, words in REFUSED]
        shown = {
            "refused": refused,
            "name": dem.source.name,
            "shape": dem.shape,
            "sides_m": (dem.cell_size_m, dem.cell_width_m),
        }
        return msgspec.json.encode(shown | {"bodies": bodies, "asked": self.first})

    def answer(self, question: bytes) -> bytes:
        """A line of JSON, then the bytes of the ``layer`` whose shape it holds, if it does.

        What cannot be done is an answer too, a ``problem`` in one line.
        """
        layer: Layer | None = None
        try:
            with self._lock:
                answer, layer = self._answer(_decode(question))
        except (NnppEdgeError, MemoryError) as error:
            answer = {"problem": str(error) if isinstance(error, NnppEdgeError) else "not enough memory"}
        if layer is None:
            return msgspec.json.encode(answer) + b"\n"
        return msgspec.json.encode(answer | {"layer": layer.shape}) + b"\n" + layer.tobytes()

    def _answer(self, question: Question) -> tuple[Answer, Layer | None]:
        asked, dem, pixels = question.asked, self.site.dem, question.pixels
        sides = dem.cell_size_m, dem.cell_width_m
        if question.want == "relief":
            return {}, relief(dem.elevation, sides, pixels)
        if question.want == "slope":
            return {}, slope(dem.elevation, sides, pixels)
        landscape = self.landscape(asked)
        if question.want == "cost":
            cost = np.where(painted(dem.shape, asked.obstacles), np.float32(np.inf), landscape.cost)
            refused = landscape.refused()
            layer = costs(cost, pixels, refused)
            return {"refused": [] if refused is None else np.unique(refused[refused > 0]).tolist()}, layer
        if question.want == "compare":
            plan, time_ms = landscape.compare(asked, question.method)
            region = None if plan.region is None else plan.region.mask()
            answer = {name: plan.summary()[name] for name in ("status", "method", "cost", "expansions")}
            answer |= {"time_ms": round(time_ms, 3), "line": plan.line.tolist()}
            answer["share"] = None if region is None else float(region.mean())
            return answer, None if region is None else (smaller(region, pixels) * 255.0).astype(np.uint8)
        return path_answer(self.site, asked, landscape, landscape.plan(asked, asked.method)), None


def path_answer(site: Site, asked: Asked, landscape: Landscape, plan: Plan) -> Answer:
    """A plan: its figures, its line, what lies along it, and how to ask for it elsewhere."""
    answer: Answer = {
        "figures": plan.summary(),
        "ok": plan.ok,
        "unit": unit_of(asked.step_cost),
        "on_foot": asked.chosen(site).mobility.time is None,
        "rows": [],
        "cols": [],
        "warnings": landscape.warnings,
        "command": command_of(site, asked),
    }
    if plan.along is None or not len(plan.path):
        return answer
    rows, cols = plan.along.points.T
    cost = landscape.cost[np.rint(rows).astype(int), np.rint(cols).astype(int)]
    columns = {"rows": (rows, 2), "cols": (cols, 2), "distance_m": (plan.along.distance_m, 1)}
    columns |= {"height_m": (plan.along.heights_m, 2), "cost": (np.minimum(cost, 1.0), 3)}
    answer |= {name: np.round(values.astype(float), digits).tolist() for name, (values, digits) in columns.items()}
    if plan.drive is not None:
        answer["gears"] = plan.drive.gears.tolist()
    if plan.waypoints is not None:
        answer |= {"waypoints": np.round(plan.waypoints, 2).tolist(), "grid": plan.path.tolist()}
    return answer


def relief(elevation: Float2D, sides_m: tuple[float, float], pixels: int) -> Layer:
    """Hillshade, 40 to 245; `UNKNOWN` where fewer than half of a pixel's heights are known."""
    factor, known = max(max(elevation.shape) / pixels, 1.0), np.isfinite(elevation)
    share, total = smaller(known, pixels), smaller(np.where(known, elevation, np.float32(0.0)), pixels)
    mean = np.where(share > 0.5, total / np.maximum(share, np.float32(0.5)), np.float32(np.nan))
    grey = hillshade(mean, *(factor * side for side in sides_m))
    grey[np.isnan(mean)] = UNKNOWN
    return grey


def slope(elevation: Float2D, sides_m: tuple[float, float], pixels: int) -> Layer:
    """Inclination of the cells, from 0 to 255 at `_STEEPEST_DEG`; 0 where unknown."""
    slopes = np.nan_to_num(terrain_terms(elevation, sides_m[0], cell_width_m=sides_m[1])[0])
    return np.asarray(np.minimum(smaller(slopes, pixels) * 255.0 / math.radians(_STEEPEST_DEG), 255.0), np.uint8)


def costs(cost: Float2D, pixels: int, refused: Layer | None = None) -> Layer:
    """Traversability costs, from 0 to 248; `IMPASSABLE` where a pixel's cells are, by a quarter of them.

    Where a vehicle stands in no heading on a quarter of them, `refused` from `map.refusal.refusals`, the limit that
    refuses it on most, from `FIRST_REFUSED` on.
    """
    passable = cost < 1.0
    strength = smaller(np.where(passable, cost, np.float32(0.0)), pixels) * (FIRST_REFUSED - 1)
    if refused is not None:
        shares = np.stack([smaller(refused == 1 + limit, pixels) for limit in range(len(REFUSALS))])
        strength = np.where(shares.sum(0) > _BLOCKED, FIRST_REFUSED + shares.argmax(0), strength)
    strength[smaller(~passable, pixels) > _BLOCKED] = IMPASSABLE
    return strength.astype(np.uint8)


def smaller(values: NDArray[np.float32] | NDArray[np.bool_], pixels: int) -> Float2D:
    """Means of the cells below each pixel, at most so many a side."""
    numbers: Float2D = values.astype(np.float32, copy=False)
    rows, cols = numbers.shape
    if (factor := max(rows, cols) / pixels) > 1.0:
        size = max(round(cols / factor), 1), max(round(rows / factor), 1)
        numbers = np.asarray(cv2.resize(numbers, size, interpolation=cv2.INTER_AREA), np.float32)
    return numbers


_DECODER = msgspec.json.Decoder(Question)


def _decode(text: bytes) -> Question:
    try:
        question: Question = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise InvalidQueryError(f"a question cannot be read: {error}") from None
    return question
