"""Pictures of plans and of what can be reached, with matplotlib (the extra `viz`).

Under everything lies the relief, browner where a cell costs more; impassable cells are dark,
unknown ones striped.
"""

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Array, Bool, Cells, Float2D, Floats, headings_along
from nnpp_edge.runtime.cells import Cell, Sides, slices
from nnpp_edge.runtime.errors import optional_module
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
    rgb,
)
from nnpp_edge.viz.relief import FLAT, Chart, Shade, hillshade

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

T = TypeVar("T", bound=np.generic)

MOST_SHOWN = 1 << 20
"""Cells of a map whose poses are all checked for a picture, a tenth of a second."""
_DEAR = 0.65
_NO_STAND = 0.75
_BAND = 0.5
_TINT = 0.3
"""How strongly cells are coloured where they cost most, where a vehicle stands in no heading, bands
of what can be reached, and regions.
"""
_SHADES = 16
"""Of the relief, and of the costs on it: more are hardly seen, and make a file larger."""
_MOST_CELLS = 2000
"""Of a side that is drawn: of one twice as long every second cell, and so on."""
_DPI = 100
_INCHES = 9.0
"""Of a map's longer side."""
_LEAST_BODY = 0.07
"""Inches of a vehicle's length: below, it would be a dot."""


class Reached(NamedTuple):
    """How far a search came that found no path."""

    cells: Bool
    """(H, W) those to which it came."""
    begun: str
    """Where from: ``start`` or ``goal``."""
    closest: Cell
    """The nearest of these cells to the other end."""


class MapDrawing:
    """A map on axes of matplotlib, by default those of a figure of its own, and what is drawn on
    it: the first lowest, each with its words in the legend.

    Of the map the part around `places` is shown, each (N, 2), by default all; the ground is striped
    where it is unknown, or `unseen` by a body. Its longer side has so many `inches`.
    MissingExtraError without matplotlib.
    """

    def __init__(
        self,
        chart: Chart,
        places: Sequence[Line] = (),
        *,
        unseen: Bool | None = None,
        axes: "Axes | None" = None,
        inches: float = _INCHES,
    ) -> None:
        kinds = optional_module("matplotlib.figure", "a picture", "viz")
        from matplotlib.colors import LinearSegmentedColormap, to_rgba

        self._chart = chart
        self._part = row, col, rows, cols = chart.around(places) if places else chart.whole
        self._step = step = max(max(rows, cols) // _MOST_CELLS, 1)
        self._inches = inches / max(rows, cols)
        """Of a cell."""
        if axes is None:
            figure: Figure = kinds.Figure((cols * self._inches, rows * self._inches), dpi=_DPI)
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes = axes

        # the ground, which lets stripes be seen where it is unknown
        cost = self._shown(chart.cost)
        rows, cols = cost.shape
        right = col + cols * step
        bottom = row + rows * step
        self._extent = (col - 0.5, right - 0.5, bottom - 0.5, row - 0.5)
        unknown = self._shown(chart.unknown)
        words = "unknown"
        if unseen is not None and unseen.any():
            unknown = unknown | self._shown(unseen)
            words = REFUSED[0][1]
        shut = ~(cost < 1.0)
        shade = np.full(cost.shape, FLAT, np.uint8)
        if chart.elevation is not None:
            height, width = chart.sides_m or (1.0, 1.0)
            shade = hillshade(self._shown(chart.elevation), step * height, step * width)
        greys = LinearSegmentedColormap.from_list("greys", ("0.4", "1.0"), _SHADES)
        self._layer(np.where(unknown, np.nan, shade), greys, 255.0)
        browns = [to_rgba(COST, strength) for strength in (0.0, _DEAR)]
        colours = LinearSegmentedColormap.from_list("costs", browns, _SHADES)
        cost = np.where(shut, 2.0, cost)  # above all costs
        cost[unknown] = np.nan
        self._costs = self._layer(cost, colours.with_extremes(over=IMPASSABLE))
        axes.set(xticks=[], yticks=[], autoscale_on=False)
        axes.grid(visible=False)
        self._passable = ~(shut | unknown)
        if unknown.any():
            axes.patch.set(facecolor=PAPER, edgecolor=UNKNOWN, hatch="////")
            axes.fill([], [], facecolor=PAPER, edgecolor=UNKNOWN, hatch="////", label=words)
        if (shut & ~unknown).any():
            axes.fill([], [], color=IMPASSABLE, label="impassable")

    def _shown(self, cells: NDArray[T]) -> NDArray[T]:
        """Every `step`-th cell of the part."""
        return cells[slices(self._part)][:: self._step, :: self._step]

    def _layer(
        self, image: Array, colours: "Colormap | None" = None, most: float = 1.0
    ) -> "AxesImage":
        large = self._inches * _DPI * self._step >= 1.0
        how = "nearest" if large else "auto"  # cells are enlarged as they are, and reduced smoothly
        return self.axes.imshow(
            image, colours, extent=self._extent, interpolation=how, vmin=0.0, vmax=most
        )

    def tint(self, cells: Bool, strength: float, colour: str, words: str) -> None:
        """Colour cells where they can be passed; the ground shows through."""
        on = self._shown(cells) & self._passable
        image = np.zeros((*on.shape, 4), np.uint8)
        image[on] = (*rgb(colour), round(255 * strength))
        self._layer(image)
        self.axes.fill([], [], color=colour, alpha=strength, label=words)

    def outline(self, cells: Bool, colour: str) -> None:
        """Draw a line around cells."""
        within = np.pad(cells, 1)
        rows, cols = (np.arange(side) - 1 for side in within.shape)
        self.axes.contour(cols, rows, within, levels=[0.5], colors=colour, linewidths=2.0)

    def line(
        self, places: Line, colour: str, width: float, words: str, rim: str | None = INK
    ) -> None:
        """Draw a line (N, 2) of so many points with a rim."""
        from matplotlib.patheffects import withStroke

        if not len(places):
            return
        rims = [] if rim is None else [withStroke(linewidth=width + 2.0, foreground=rim)]
        self.axes.plot(
            places[:, 1],
            places[:, 0],
            color=colour,
            linewidth=width,
            path_effects=rims,
            label=words,
        )

    def bodies(self, outlines: Sequence[Line]) -> None:
        """Draw outlines of a vehicle, unless they would be dots."""
        sizes = [np.ptp(outline, axis=0).max() for outline in outlines]
        if max(sizes, default=0.0) * self._inches < _LEAST_BODY:
            return
        # one line that is broken between them
        gap = np.full((1, 2), np.nan)
        broken = [each for outline in outlines for each in (outline, gap)]
        self.line(np.concatenate(broken), BODY, 0.9, "vehicle", PAPER)

    def mark(
        self, cell: Cell, marker: str, colour: str, words: str, size: float = 9.0, sign: str = ""
    ) -> None:
        """Draw a place by a marker of so many points, with a sign in it."""
        row, col = cell
        self.axes.plot(
            col,
            row,
            marker,
            color=colour,
            markeredgecolor=INK,
            markersize=size,
            zorder=3,
            label=words,
        )
        self.axes.text(col, row, sign, ha="center", va="center", fontsize=8, clip_on=True)

    def ends(self, start: Cell, goal: Cell, begin: str = "start") -> None:
        """Draw a square at the start, and a star at the goal."""
        self.mark(goal, "*", GOAL, "goal", size=16.0)
        self.mark(start, "s", START, begin)

    def finish(self, facts: Iterable[str] = ()) -> "Figure":
        """Add the facts and a scale bar above the map, the legend and the costs' colours beside it,
        where the figure is its own.
        """
        from matplotlib.ticker import MaxNLocator
        from matplotlib.transforms import Affine2D
        from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

        axes = self.axes
        figure: Figure = axes.figure  # type: ignore[assignment]  # none within another here
        chart = self._chart
        axes.set_title("   ".join(facts), loc="left", fontsize="medium")
        if chart.sides_m is not None:
            width_m = self._part[3] * chart.sides_m[1]
            length_m = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, width_m)[1]
            bar = AnchoredSizeBar(
                axes.transData,
                length_m / chart.sides_m[1],
                metres(length_m),
                "lower right",
                frameon=False,
                bbox_to_anchor=(1.0, 1.0),
                bbox_transform=axes.transAxes,
            )
            axes.add_artist(bar)
        if chart.north_deg is not None:
            arrow = [(-0.4, -1.0), (0.0, 1.0), (0.4, -1.0), (0.0, -0.6)]
            turned = Affine2D().rotate_deg(-chart.north_deg).transform(arrow)
            axes.plot(
                [], [], linestyle="", marker=turned, markersize=14.0, color=INK, label="grid north"
            )
        figure.colorbar(
            self._costs,
            cax=axes.inset_axes((1.01, 0.0, 0.02, 1.0)),
            label="traversability cost",
        )
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=3, frameon=False
        )
        return figure


def encoded(figure: "Figure", dpi: int = _DPI, box: object = "tight") -> bytes:
    """The figure, or a box of it, as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi, bbox_inches=box)
    return content.getvalue()


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
) -> "Figure":
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
    # the part that holds all of it
    stops = [start, goal, *via]
    if reached is not None:
        stops.append(reached.closest)
    paths = (plan.path, plan.line, reference_path, point_path)
    places = [np.array(stops, np.int32), *(path for path in paths if path is not None)]
    unseen = None if refused is None else refused == 1
    drawing = MapDrawing(chart, places, unseen=unseen)

    # areas
    if plan.network_region is not None:
        inside = plan.network_region.mask()
        drawing.tint(inside, _TINT / 2, REGION, "network's region, outlined")
        drawing.outline(inside, REGION)
    if plan.region is not None:
        drawing.tint(plan.region.mask(), _TINT, REGION, "region searched")
    if reached is not None:
        words = "reached from the start" if reached.begun == "start" else "leads to the goal"
        drawing.tint(reached.cells, _TINT, REACHED, words)
    if refused is not None:
        for limit in np.unique(refused[refused > 1]).tolist():
            drawing.tint(refused == limit, _NO_STAND, *REFUSED[limit - 1])

    # paths
    arcs = plan.states is not None
    freed = plan.line is not plan.path and not arcs
    if point_path is not None:
        other = "path with turns on the spot" if arcs else "path of a point"
        drawing.line(point_path, POINT, 1.8, other)
    if freed:
        drawing.line(plan.path, GRID, 1.5, "path of the grid")
    words = "path of arcs" if arcs else "path freed from the grid" if freed else "path"
    drawing.line(plan.line, PATH, 4.0, words)
    if reference_path is not None:
        drawing.line(reference_path, OPTIMUM, 0.9, "exact optimum", None)

    # places
    drawing.bodies(outlines)
    for number, stop in enumerate(via, 1):
        words = "by way of" if number == 1 else ""
        drawing.mark(stop, "o", PAPER, words, size=13.0, sign=str(number))
    if reached is not None:
        drawing.mark(reached.closest, "X", ENDED, "where the search ended")
    drawing.ends(start, goal)
    return drawing.finish(_facts(plan))


def _facts(plan: Plan) -> Iterator[str]:
    """What stands above the map about the plan."""
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


def reach_picture(
    chart: Chart, field: Float2D, levels: Sequence[tuple[float, str]], start: Cell
) -> "Figure":
    """Draw bands of what can be reached at what cost, the nearest first, on the part of the map
    around them.

    `field` is (H, W) float32, the cost of getting to each cell, inf where that is not possible;
    `levels` say where each band ends, ascending, and what the legend says of it.
    """
    drawing = MapDrawing(chart, [np.argwhere(np.isfinite(field))])  # type: ignore[list-item]

    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    band = np.searchsorted([level for level, _ in levels], field)
    for at, (_, words) in enumerate(levels):
        colour = to_hex(colormaps["plasma"]((at + 0.5) / len(levels)))
        drawing.tint(band == at, _BAND, colour, words)
    drawing.mark(start, "s", START, "start")
    return drawing.finish()


def body_outlines(
    path: Line,
    vehicle: Vehicle | None,
    sides_m: Sides,
    headings_deg: Line | None = None,
) -> list[Floats]:
    """(N, 2) the body's outline, rows and columns, and a line from its front to its middle, all
    along a path.

    One at every second body length, at most a hundred; none of a point, nor for a path of less than
    two cells. Its headings (N,), in degrees clockwise from up the rows, are by default those to the
    next place.
    """
    if vehicle is None or not vehicle.reach_m or len(path) < 2:
        return []
    steps = np.diff(path, axis=0) * sides_m
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*steps.T))))

    # the body in metres ahead of its middle and to its left: from the front's middle around, and
    # to the middle
    if vehicle.radius_m is not None:
        turn = np.linspace(0.0, 2.0 * math.pi, 33)
        ahead = vehicle.radius_m * np.cos(turn)
        left = vehicle.radius_m * np.sin(turn)
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
