"""Answers to the page: the site, a path with its figures and profile, methods side by side, a mended path."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.map.slope_cost import unit_of
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.terrain.route import Route
from nnpp_edge.view import layers
from nnpp_edge.view.mending import Mended
from nnpp_edge.view.messages import Change, Compare, Layer, Mend, Message, Move, Open, Paint, Undo
from nnpp_edge.view.site import Site
from nnpp_edge.view.trial import Compared, Trial
from nnpp_edge.view.words import command_of, python_of

Answer = dict[str, object]
MOST_PIXELS = 2048
_LEAST_PIXELS = 64


class Answerer:
    """Answers one tab's messages. Serves one thread at a time."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self._pixels = MOST_PIXELS

    def answer(self, message: Message) -> list[Answer | bytes]:
        """Messages for the page, in order; bytes are the layer that the one before announces.

        What cannot be done is an answer too, in one line, and leaves everything as it was.
        """
        try:
            return [_numbered(each, message.number) for each in self._answer(message)]
        except (NnppEdgeError, MemoryError) as error:
            text = str(error) if isinstance(error, NnppEdgeError) else "not enough memory"
            return [{"type": "problem", "number": message.number, "text": text}]

    def _answer(self, message: Message) -> list[Answer | bytes]:
        trial = self.trial
        match message:
            case Open():
                self._pixels = min(max(message.pixels, _LEAST_PIXELS), MOST_PIXELS)
                return [opening(trial), path_answer(trial), *self._layer("relief"), *self._layer("cost")]
            case Move():
                trial.change({message.end: message.to})
                return [path_answer(trial)]
            case Change():
                another = trial.change(dict(message.values))
                return [path_answer(trial), *(self._layer("cost") if another else ())]
            case Layer():
                return self._layer(message.name)
            case Compare():
                return self._compared(message.method)
            case Paint():
                trial.paint(message.part)
                return [path_answer(trial), *self._layer("cost")]
            case Mend():
                return [mended_answer(trial.mend())]
            case Undo():
                if message.all:
                    trial.clear()
                else:
                    trial.undo()
                return [path_answer(trial), *self._layer("cost")]

    def _layer(self, name: str) -> list[Answer | bytes]:
        dem, pixels = self.trial.site.dem, self._pixels
        if name == "cost":
            return _layer_answer(name, layers.costs(self.trial.landscape.cost, pixels))
        return _layer_answer(name, (layers.relief if name == "relief" else layers.slope)(dem, pixels))

    def _compared(self, method: str) -> list[Answer | bytes]:
        compared = self.trial.compare(method)
        region, told = compared.plan.region, [compared_answer(method, compared, self.trial.site)]
        if region is None:
            return [*told]
        return [*told, *_layer_answer(f"region {method}", layers.region(region, self._pixels))]


def opening(trial: Trial) -> Answer:
    """The site as the page shows it, and the controls' first values."""
    site, asked = trial.site, trial.asked
    bodies = {}
    for name, body in site.bodies.items():
        bodies[name] = {
            "time": body.mobility.time is not None,
            "energy": body.mobility.energy is not None,
            "clearance": body.vehicle.clearance_m if body.vehicle is not None and body.has_body else None,
            "max_tilt": body.vehicle.max_tilt_deg if body.vehicle is not None and body.has_body else None,
        }
    return {
        "type": "opening",
        "name": site.dem.source.name,
        "shape": site.dem.shape,
        "sides_m": site.sides_m,
        "bodies": bodies,
        "asked": msgspec.to_builtins(asked),
    }


def path_answer(trial: Trial) -> Answer:
    """The newest plan: its figures, its line, what lies along it, and how to ask for it elsewhere."""
    plan, asked, site = trial.plan, trial.asked, trial.site
    answer: Answer = {
        "type": "path",
        "figures": {**plan.summary(), "line_cost": _rounded(plan.line_cost)},
        "ok": plan.ok,
        "unit": unit_of(asked.slope_cost),
        "on_foot": trial.landscape.mobility.time is None,
        "asked": msgspec.to_builtins(asked),
        "start": asked.start,
        "goal": asked.goal,
        "obstacles": asked.obstacles,
        "rows": [],
        "cols": [],
        "warnings": trial.landscape.warnings,
        "command": command_of(site, asked),
        "python": python_of(site, asked),
    }
    if plan.along is None or not len(plan.path):
        return answer
    route, along = Route.of(plan.line, plan.along, trial.landscape.cost, site.dem), plan.along
    rows, cols = along.points.T
    answer |= {"rows": _list(rows, 2), "cols": _list(cols, 2), "distance_m": _list(along.distance_m, 1)}
    answer |= {"height_m": _list(along.heights_m, 2), "cost": _list(np.minimum(route.cost, 1.0), 3)}
    if plan.waypoints is not None:
        answer |= {"waypoints": np.round(plan.waypoints, 2).tolist(), "grid": plan.path.tolist()}
    return answer


def compared_answer(method: str, compared: Compared, site: Site) -> Answer:
    """A row of the table of methods; `share` is the region's of the map, None for the whole map."""
    plan, region = compared.plan, compared.plan.region
    rows, cols = site.dem.shape
    return {
        "type": "compared",
        "method": method,
        "by": str(plan.planner or plan.method),
        "status": str(plan.status),
        "source": None if plan.source is None else str(plan.source),
        "cost": _rounded(plan.cost),
        "gap": compared.gap,
        "time_ms": round(compared.time_ms, 3),
        "expansions": plan.expansions,
        "share": None if region is None else region.area() / (rows * cols),
        "line": plan.line.tolist(),
    }


def mended_answer(mended: Mended) -> Answer:
    """Effect of an obstacle on the path before, and the work of two exact searches."""

    def took(plan: Plan) -> Answer:
        return {"status": str(plan.status), "ms": plan.timings_ms.get("total"), "expansions": plan.expansions}

    searches = {"mended": took(mended.mended), "afresh": took(mended.afresh)}
    return {"type": "mended", "footing": mended.footing, **searches}


def _layer_answer(name: str, layer: layers.Layer) -> list[Answer | bytes]:
    rows, cols = layer.shape
    return [{"type": "layer", "name": name, "rows": rows, "cols": cols}, layer.tobytes()]


def _numbered(answer: Answer | bytes, number: int) -> Answer | bytes:
    return answer if isinstance(answer, bytes) else {**answer, "number": number}


def _list(values: NDArray[np.float64] | NDArray[np.float32], digits: int) -> list[float | None]:
    """Rounded, ready for JSON: None for what is not finite."""
    found: list[float | None] = np.round(values.astype(np.float64), digits).tolist()
    if np.isfinite(values).all():
        return found
    return [None if each is None or not math.isfinite(each) else each for each in found]


def _rounded(number: float) -> float | None:
    return round(number, 6) if math.isfinite(number) else None
