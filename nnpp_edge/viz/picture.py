"""Pictures of cost maps, plans and what can be reached, with OpenCV alone, so that the onboard
install can draw them.

Under everything lies the relief, lit from the north-west and browner where a cell costs more;
impassable cells are dark, unknown ones striped. A picture is (H, W, 3) uint8 in OpenCV's order
blue, green, red.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Bool, Cells, Float2D, Floats, headings_along
from nnpp_edge.runtime.cells import Cell, Rectangle, Sides, holding, slices, widened
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.robots.body.refusal import refusals
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.facts import metres
from nnpp_edge.viz.palette import (
    BODY,
    COST,
    ENDED,
    GOAL,
    GRID,
    IMPASSABLE,
    INK,
    OPTIMUM,
    PAPER,
    PATH,
    POINT,
    REACHED,
    REFUSED,
    REGION,
    START,
    UNKNOWN,
    Colour,
)
from nnpp_edge.viz.sheet import CIRCLE, LEAST_PIXELS, SHADES, Key, MapDrawing, Picture, swatch

Shade = NDArray[np.uint8]
"""(H, W) lightness of the relief, or a number for each cell."""
T = TypeVar("T", bound=np.generic)

MOST_SHOWN = 1 << 20
"""Cells of a map whose poses are all checked for a picture, a tenth of a second."""
_NO_STAND = 0.75
_BAND = 0.5
_TINT = 0.3
_EDGE = 0.85
"""How strongly cells are coloured where a vehicle stands in no heading, bands of what can be
reached, regions, and the edge of the network's.
"""
_DEAR = 0.65
_SHUT = 0.85
"""Likewise where a cell costs most, and where it is impassable."""
_FLAT = 185
"""Of the relief's lightness, level ground."""
_MOST_CELLS = 2000
"""Of a side that is drawn: of one twice as long every second cell, and so on."""
_AROUND = 0.15
_LEAST_AROUND = 16
"""Of the ground around a path that is shown: a share of its longer side, and cells."""
_ZOOMED = 0.5
"""Share of the map up to which a part of it is shown alone."""
_PIECE = ((0.0, 0.0), (26.0, 0.0))
"""Of a line, in the legend."""
_STRIPES = [([(at, 7), (at + 13, -6)], UNKNOWN, 2.0) for at in (0, 9)]


class Tint(NamedTuple):
    """Cells that are coloured where they can be passed."""

    cells: Bool
    strength: float
    colour: Colour
    words: str
    """Of the legend; empty for none."""


class Drawn(NamedTuple):
    """A line that is drawn, with a dark rim unless it is dark itself."""

    places: Line
    colour: Colour
    width: float
    """Points."""
    words: str
    """Of the legend."""

    @property
    def layers(self) -> tuple[tuple[Colour, float], ...]:
        """Colours and widths, the lowest first."""
        line = (self.colour, self.width)
        return (line,) if self.colour == INK else ((INK, self.width + 2.0), line)


class Reached(NamedTuple):
    """How far a search came that found no path."""

    cells: Bool
    """(H, W) those to which it came."""
    begun: str
    """Where from: ``start`` or ``goal``."""
    closest: Cell
    """The nearest of these cells to the other end."""


@dataclass(frozen=True, eq=False)
class Chart:
    """A map to draw on: what all pictures of it share."""

    cost: Float2D
    """(H, W) traversability cost; impassable where NaN or from 1 up."""
    elevation: Float2D | None = None
    """(H, W) metres, NaN where unknown; without it the ground is drawn level."""
    sides_m: Sides | None = None
    """Of a cell, along columns and along rows; None where unknown."""
    north_deg: float | None = None
    """Where grid north lies, clockwise from up the rows; None where unknown."""

    @property
    def whole(self) -> Rectangle:
        """All of the map."""
        return (0, 0, *self.cost.shape)

    def around(self, places: Line) -> Rectangle:
        """The part to show of what lies at these places (N, 2): the whole map, unless they take up
        little of it.
        """
        inside = np.clip(np.rint(places).astype(np.int64), 0, np.subtract(self.cost.shape, 1))
        row, col, rows, cols = holding(inside)
        longest = max(rows, cols)
        margin = max(math.ceil(_AROUND * longest), _LEAST_AROUND)
        high = margin + max(2 * longest // 3 - rows, 0) // 2
        wide = margin + max(2 * longest // 3 - cols, 0) // 2
        part = widened((row, col, rows, cols), (high, wide), self.cost.shape)
        return part if part[2] * part[3] <= _ZOOMED * self.cost.size else self.whole

    def ground(self, part: Rectangle, step: int, tints: Sequence[Tint] = ()) -> Picture:
        """A pixel for every `step`-th cell of a part."""

        def drawn(cells: NDArray[T]) -> NDArray[T]:
            return cells[slices(part)][::step, ::step]

        cost = drawn(self.cost)
        shade = None
        if self.elevation is not None:
            height, width = self.sides_m or (1.0, 1.0)
            shade = hillshade(drawn(self.elevation), height * step, width * step)
        picture = cost_picture(cost, shade)
        for tint in tints:
            on = drawn(tint.cells) & (cost < 1.0)
            picture[on] = mixed(picture[on], tint.strength, tint.colour)
        return picture

    def picture(
        self,
        start: Cell | None = None,
        goal: Cell | None = None,
        *,
        via: Sequence[Cell] = (),
        lines: Sequence[Drawn] = (),
        tints: Sequence[Tint] = (),
        unseen: Bool | None = None,
        outlines: Sequence[Line] = (),
        ended: Cell | None = None,
        part: Rectangle | None = None,
        facts: Iterable[str] = (),
        begin: str = "start",
        least: int = LEAST_PIXELS,
    ) -> Picture:
        """Draw a `part` of the map, by default all, with a legend.

        Lines lie one over the other, the first lowest; where a body cannot stand for what is
        `unseen` the ground is striped as where it is unknown; `outlines` of a body are left out
        where they would be dots; `ended` is where a search without a path did; the start's key is
        `begin`.
        """
        row, col, rows, cols = part = part or self.whole
        step = max(max(rows, cols) // _MOST_CELLS, 1)
        drawing = MapDrawing(self.ground(part, step, tints), (row, col), step, least=least)
        unknown = np.isnan(self.cost if self.elevation is None else self.elevation)
        stripes_say = "unknown"
        if unseen is not None and unseen.any():
            unknown |= unseen
            stripes_say = REFUSED[0][1]
        drawing.hatched(unknown[slices(part)][::step, ::step])
        there = [line for line in lines if len(line.places)]
        for line in there:
            for colour, width in line.layers:
                drawing.line(line.places[:, :2], colour, width)
        with_bodies = drawing.bodies(outlines)
        marked = [(stop, str(number), PAPER) for number, stop in enumerate(via, 1)]
        marked += [] if ended is None else [(ended, "x", ENDED)]
        for cell, sign, colour in marked:
            drawing.mark(cell, CIRCLE * 9.0, colour, sign)
        if start is not None:
            drawing.ends(start, goal)

        # the legend, with the widest line first
        keys: list[Key] = []
        for line in sorted(there, key=lambda each: -each.width):
            pieces = [(_PIECE, *layer) for layer in line.layers]
            keys.append(Key(line.words, 28.0, pieces))
        swatches = (
            (START, begin, start),
            (GOAL, "goal", goal),
            (PAPER, "by way of", via),
            (BODY, "vehicle", with_bodies),
            *((tinted(tint), tint.words, tint.words) for tint in tints),
            (ENDED, "where the search ended", ended),
            (SHUT_GROUND, "impassable", (~(self.cost < 1.0) & ~unknown).any()),
        )
        keys += [swatch(colour, words) for colour, words, shown in swatches if shown]
        if unknown.any():
            keys.append(Key(stripes_say, 22.0, _STRIPES))
        costs = cost_picture(np.linspace(0.0, 0.999, 30, dtype=np.float32)[None])[0].tolist()
        places = zip(range(7, 127, 4), costs, strict=True)
        bar = [([(x, 0), (x + 4, 0)], colour, 13.0) for x, colour in places]
        keys.append(Key("traversability cost, 0 to 1", 137.0, bar))
        scale = drawing.scale(None if self.sides_m is None else self.sides_m[1])
        return drawing.finish([keys, [*map(Key, facts), *scale, *drawing.north(self.north_deg)]])


def cost_picture(cost: Float2D, shade: Shade | None = None) -> Picture:
    """A cell a pixel: the relief, (H, W) uint8 from `hillshade`, or level ground, the browner the
    costlier; impassable cells, NaN or from 1 up, are dark.
    """
    passable = (cost < 1.0)[..., None]
    lightness = np.float32(105.0) + np.float32(0.6) * (_FLAT if shade is None else shade)
    lit = np.broadcast_to(lightness, cost.shape)[..., None]
    strength = np.where(passable, _DEAR * cost.clip(0.0)[..., None], _SHUT).astype(np.float32)
    colours = np.array((COST, IMPASSABLE), np.float32)
    colour = np.where(passable, colours[0], colours[1])
    picture: Picture = ((1.0 - strength) * lit + strength * colour).astype(np.uint8)
    return picture & SHADES


def mixed(ground: Picture, strength: float, colour: Colour) -> Picture:
    """A colour laid over the ground, which shows through."""
    return ((1.0 - strength) * ground + strength * np.array(colour)).astype(np.uint8) & SHADES


SHUT_GROUND: Colour = tuple(cost_picture(np.ones((1, 1), np.float32))[0, 0].tolist())


def hillshade(elevation: Float2D, cell_size_m: float, cell_width_m: float | None = None) -> Shade:
    """Relief lit from the north-west: (H, W) uint8; unknown ground as if it were flat.

    Heights are exaggerated so that the steepest tenth of the map stands out, but never flattened.
    """
    rows, cols = elevation.shape
    # np.gradient wants two rows and columns
    missing = [(0, max(2 - side, 0)) for side in elevation.shape]
    padded = np.pad(elevation, missing, mode="edge")
    slopes = np.nan_to_num(np.gradient(padded, cell_size_m, cell_width_m or cell_size_m))
    south, east = slopes[:, :rows, :cols]
    tilt = np.hypot(south, east)
    steep = max(float(np.quantile(tilt, 0.9)), 1e-6)
    gain = min(max(0.7 / steep, 1.0), 50.0)
    # 45 degrees high, and as much from the north as from the west
    toward = math.sqrt(0.5) + 0.5 * gain * (south + east)
    light = toward / np.hypot(1.0, gain * tilt)
    return np.asarray(40.0 + 205.0 * np.clip(light, 0.0, 1.0), np.uint8)


def plan_picture(
    chart: Chart,
    plan: Plan,
    start: Cell,
    goal: Cell,
    *,
    via: Sequence[Cell] = (),
    reference_path: Line | None = None,
    outlines: Sequence[Line] = (),
    refused: Shade | None = None,
    point_path: Cells | None = None,
    reached: Reached | None = None,
) -> Picture:
    """Draw a plan on its map: region, path, start (square) and goal (star); where these take up
    little of the map the part around them.

    Parameters
    ----------
    plan : Plan
        Made with its regions, if they are to be drawn.
    start, goal : (row, col)
        Drawn even where no path was found.
    via : sequence of (row, col)
        Places between, in the order in which they are visited.
    reference_path : (N, 2) int
        The exact optimum, drawn on the path and narrower: both are seen where they agree.
    outlines : sequence of (N, 2) float
        Of a vehicle along the path, rows and columns, from `body_outlines`; left out where they
        would be dots.
    refused : (H, W) uint8
        Where it stands in no heading, from `robots.body.refusal.refusals`.
    point_path : (N, 2) int
        The path of a point; beside one of arcs, of the same body that turns on the spot.
    reached : Reached
        Where no path was found: what the search came to is tinted, and its end marked.
    """
    lines = list(_lines(plan, reference_path, point_path))
    ended = None if reached is None else reached.closest
    stops = [each for each in (start, goal, *via, ended) if each is not None]
    drawn = [line.places[:, :2].astype(np.float64) for line in lines]
    return chart.picture(
        start,
        goal,
        via=via,
        lines=lines,
        tints=list(_tints(plan, refused, reached)),
        unseen=None if refused is None else refused == 1,
        outlines=outlines,
        ended=ended,
        part=chart.around(np.concatenate([np.array(stops, np.float64), *drawn])),
        facts=_facts(plan),
    )


def reach_picture(
    chart: Chart, field: Float2D, levels: Sequence[tuple[float, str]], start: Cell
) -> Picture:
    """Draw bands of what can be reached at what cost, the nearest first, on the part of the map
    around them.

    `field` is (H, W) float32, the cost of getting to each cell, inf where that is not possible;
    `levels` say where each band ends, ascending, and what the legend says of it (ASCII).
    """
    band = np.searchsorted([level for level, _ in levels], field)
    # along a scale from dark to light
    middles = 255 * (np.arange(len(levels)) + 0.5) / len(levels)
    scale = np.rint(middles[None]).astype(np.uint8)
    colours = cv2.applyColorMap(scale, cv2.COLORMAP_PLASMA)[0].tolist()
    tints = [
        Tint(band == at, _BAND, colour, words)
        for at, (colour, (_, words)) in enumerate(zip(colours, levels, strict=True))
    ]
    part = chart.around(np.argwhere(np.isfinite(field)).astype(np.int32))
    return chart.picture(start, tints=tints, part=part)


def body_outlines(
    path: Line,
    vehicle: Vehicle,
    sides_m: Sides,
    headings_deg: Line | None = None,
) -> list[Floats]:
    """(N, 2) the body's outline, rows and columns, and a line from its front to its middle, all
    along a path.

    One at every second body length, at most a hundred; none for a path of less than two cells. Its
    headings (N,), in degrees clockwise from up the rows, are by default those to the next place.
    """
    if len(path) < 2 or not vehicle.reach_m:
        return []
    steps = np.diff(path, axis=0) * sides_m
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*steps.T))))

    # the body in metres ahead of its middle and to its left: from the front's middle around, and
    # to the middle
    if vehicle.radius_m is not None:
        ahead, left = vehicle.radius_m * CIRCLE.T
    else:
        ahead = vehicle.length_m / 2.0 * np.array([1, 1, -1, -1, 1, 1])
        left = vehicle.width_m / 2.0 * np.array([0, 1, 1, -1, -1, 0])
    shape = np.array([*zip(ahead, left, strict=True), (0.0, 0.0)])

    # where along the path it is drawn, and how it is turned there: rows go down
    count = min(max(int(along[-1] / (4.0 * ahead.max())), 1), 100)
    places = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    headings = headings_along(path * np.array(sides_m)) if headings_deg is None else headings_deg
    outlines = []
    for at in places:
        down = -math.cos(math.radians(headings[at]))
        right = math.sin(math.radians(headings[at]))
        outlines.append(path[at] + shape @ [(down, right), (-right, down)] / sides_m)
    return outlines


def refused_on(planner: Planner) -> Shade | None:
    """(H, W) the limits that refuse the planner's vehicle where it stands in no heading, see
    `robots.body.refusal.refusals`.

    None without a body, and on maps of more than `MOST_SHOWN` cells.
    """
    poses = planner.state.grid.robot.moves.poses
    if poses is None or math.prod(planner.shape) > MOST_SHOWN:
        return None
    return refusals(poses.standing())


def png_bytes(picture: Picture) -> bytes:
    """Encode a picture as PNG."""
    return cv2.imencode(".png", picture, (cv2.IMWRITE_PNG_COMPRESSION, 4))[1].tobytes()


def _tints(plan: Plan, refused: Shade | None, reached: Reached | None) -> Iterator[Tint]:
    """Cells that are tinted."""
    if plan.network_region is not None:
        inside = plan.network_region.mask()
        within = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8))
        yield Tint(inside, _TINT / 2, REGION, "network's region, outlined")
        yield Tint(inside & (within == 0), _EDGE, REGION, "")
    if plan.region is not None:
        yield Tint(plan.region.mask(), _TINT, REGION, "region searched")
    if reached is not None:
        words = "reached from the start" if reached.begun == "start" else "leads to the goal"
        yield Tint(reached.cells, _TINT, REACHED, words)
    if refused is not None:
        for limit in np.unique(refused[refused > 1]).tolist():
            yield Tint(refused == limit, _NO_STAND, *REFUSED[limit - 1])


def _lines(plan: Plan, reference_path: Line | None, point_path: Line | None) -> Iterator[Drawn]:
    """Paths that are drawn, the lowest first."""
    arcs = plan.states is not None
    freed = plan.line is not plan.path and not arcs
    words = "path of arcs" if arcs else "path freed from the grid" if freed else "path"
    if point_path is not None:
        other = "path with turns on the spot" if arcs else "path of a point"
        yield Drawn(point_path, POINT, 2.5, other)
    if freed:
        yield Drawn(plan.path, GRID, 2.0, "path of the grid")
    yield Drawn(plan.line, PATH, 5.0, words)
    if reference_path is not None:
        yield Drawn(reference_path, OPTIMUM, 1.2, "exact optimum")


def _facts(plan: Plan) -> Iterator[str]:
    """Lines of the legend about the plan."""
    yield plan.method if plan.source is None else f"{plan.method} ({plan.source})"
    if not plan.ok:
        yield str(plan.status)
    if len(plan.path):
        yield f"cost {plan.cost:.5g}"
        if plan.waypoints is not None:
            yield f"line integral {plan.line_cost:.5g}"
        metric = plan.along is not None
        yield f"length {metres(plan.numbers.length_m) if metric else f'{plan.length:.4g} cells'}"
    if "total" in plan.timings_ms:
        yield f"{plan.timings_ms['total']:.4g} ms"


def tinted(tint: Tint) -> Colour:
    """Its colour on level ground."""
    ground = cost_picture(np.zeros((1, 1), np.float32))[0, 0]
    return tuple(mixed(ground, tint.strength, tint.colour).tolist())
