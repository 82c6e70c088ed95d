"""Pictures of cost maps, plans and what can be reached, with OpenCV alone, so that the onboard
install can draw them.

Grey is traversability cost, the whiter the costlier, as in the paper; impassable cells are dark
brown. A picture is (H, W, 3) uint8 in OpenCV's order blue, green, red.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.runtime.arrays import Cells, Float2D, Floats
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.robots.body.refusal import refusals
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.viz.sheet import (
    BODY,
    CIRCLE,
    GOAL,
    INK,
    PAPER,
    START,
    Colour,
    MapDrawing,
    Picture,
    metres,
)

Mask = NDArray[np.bool_]
Shade = NDArray[np.uint8]
"""(H, W) in place of a picture's greys, or a number for each cell."""
T = TypeVar("T", bound=np.generic)

IMPASSABLE: Colour = (34, 44, 96)
REGION: Colour = (255, 230, 0)
PATH: Colour = (20, 120, 255)
OPTIMUM: Colour = (255, 90, 235)
GRID: Colour = (150, 245, 255)
POINT: Colour = (255, 255, 255)
REFUSED: tuple[tuple[Colour, str], ...] = (
    ((200, 120, 40), "unknown ground, obstacle or edge"),
    ((40, 40, 215), "too steep"),
    ((110, 60, 235), "too steep ahead"),
    ((190, 70, 220), "too steep sideways"),
    ((20, 170, 240), "rock under a wheel"),
    ((60, 150, 60), "ground touches the belly"),
)
"""Colour, and words of the legend, of ground where a limit refuses a vehicle, by its place in
`REFUSALS`.
"""
MOST_SHOWN = 1 << 20
"""Cells of a map whose poses are all checked for a picture, a tenth of a second."""
_NO_STAND = 0.45
_BAND = 0.5
"""How strongly cells are coloured where a vehicle stands in no heading, and bands of what can be
reached.
"""
_LIGHT = (315.0, 45.0)
"""Azimuth and height of the light of a hillshade, degrees."""
_SHARP = 800
"""Pixels of the longer side up to which a map is enlarged before bands are drawn on it."""


def cost_picture(cost: Float2D, shade: Shade | None = None) -> Picture:
    """A cell a pixel: grey from 0 (black) to 1 (white), or `shade`, (H, W) uint8 from `hillshade`,
    in its place.

    Impassable cells, NaN or from 1 up, are dark brown.
    """
    passable = cost < 1.0
    if shade is None:
        shade = np.where(passable, 255.0 * cost.clip(0.0), 0.0).astype(np.uint8)
    picture = np.repeat(shade[..., None], 3, axis=2)
    picture[~passable] = IMPASSABLE
    return picture


def hillshade(elevation: Float2D, cell_size_m: float, cell_width_m: float | None = None) -> Shade:
    """Relief lit from the north-west: (H, W) uint8; unknown ground as if it were flat.

    Heights are exaggerated so that the steepest tenth of the map stands out, but never flattened.
    """
    rows, cols = elevation.shape
    # np.gradient wants two rows and columns
    missing = [(0, max(2 - side, 0)) for side in elevation.shape]
    padded = np.pad(elevation, missing, mode="edge")
    slopes = np.array(np.gradient(padded, cell_size_m, cell_width_m or cell_size_m))
    south, east = slopes[:, :rows, :cols]
    tilt = np.hypot(south, east)
    steep = float(np.nanquantile(tilt, 0.9)) if np.isfinite(tilt).any() else 0.0
    gain = min(max(0.7 / max(steep, 1e-6), 1.0), 50.0)
    azimuth, height = (math.radians(angle) for angle in _LIGHT)
    toward = (math.cos(azimuth) * south - math.sin(azimuth) * east) * gain
    flat = math.sin(height)
    light = flat + math.cos(height) * toward
    light /= np.sqrt(1.0 + gain**2 * tilt**2)
    shade = 40.0 + 205.0 * np.clip(np.nan_to_num(light, nan=flat), 0.0, 1.0)
    return np.asarray(shade, np.uint8)


def cost_map_picture(cost: Float2D, *, cell_size_m: float | None = None) -> Picture:
    """A cost map (H, W) above a colour bar, a scale and the key to impassable cells."""
    drawing = MapDrawing(cost_picture(cost))
    impassable = [drawing.swatch(*each) for each in _impassable(cost)]
    return drawing.finish([[drawing.grey_bar(), *impassable, *drawing.scale(cell_size_m)]])


def plan_picture(
    cost: Float2D,
    plan: Plan,
    start: Cell,
    goal: Cell,
    *,
    via: Sequence[Cell] = (),
    shade: Shade | None = None,
    reference_path: Line | None = None,
    cell_size_m: float | None = None,
    length_m: float | None = None,
    outlines: Sequence[Line] = (),
    refused: Shade | None = None,
    point_path: Cells | None = None,
) -> Picture:
    """Draw a plan on its map: regions in translucent cyan, path, start (yellow square) and goal
    (red star).

    Parameters
    ----------
    cost : (H, W) float32
        Traversability cost; `shade`, (H, W) uint8 from `hillshade`, is drawn in its place.
    plan : Plan
        Made with its regions, if they are to be drawn.
    start, goal : (row, col)
        Drawn even where no path was found.
    via : sequence of (row, col)
        Places between, in the order in which they are visited.
    reference_path : (N, 2) int
        The exact optimum, drawn thinner.
    outlines : sequence of (N, 2) float
        Of a vehicle along the path, rows and columns, from `body_outlines`.
    refused : (H, W) uint8
        Where it stands in no heading, from `robots.body.refusal.refusals`.
    point_path : (N, 2) int
        The path of a point; beside one of arcs, of the same body that turns on the spot.
    cell_size_m, length_m : float
        For the scale and the legend; without a length it gives that in cells.
    """
    ground = cost_picture(cost, shade)
    tints = list(_tints(plan, refused))
    for mask, strength, colour, _ in tints:
        mask &= cost < 1.0
        ground[mask] = _mixed(ground[mask], strength, colour)
    drawing = MapDrawing(ground)

    # the optimum lies on the path, thinner, and its rim below: both are seen where they agree
    lines = _lines(plan, reference_path, point_path)
    for line, _, width, _ in reversed(lines):
        drawing.line(line, INK, width + 2.0)
    for line, colour, width, _ in lines:
        drawing.line(line, colour, width)
    drawing.bodies(outlines)
    for number, stop in enumerate(via, 1):
        drawing.numbered(stop, str(number))
    drawing.ends(start, goal)

    # the legend
    swatches = [
        (START, "start"),
        (GOAL, "goal"),
        *([(PAPER, "by way of")] if via else []),
        *((colour, words) for _, colour, _, words in lines),
        *([(BODY, "vehicle")] if outlines else []),
        *((_tint(shade, strength, colour), words) for _, strength, colour, words in tints),
        *_impassable(cost),
    ]
    keys = [drawing.swatch(*each) for each in swatches]
    if shade is None:
        keys.append(drawing.grey_bar())
    facts = [drawing.text_item(text) for text in _facts(plan, length_m)]
    return drawing.finish([keys, facts + drawing.scale(cell_size_m)])


def reach_picture(
    cost: Float2D,
    field: Float2D,
    levels: Sequence[tuple[float, str]],
    start: Cell,
    *,
    shade: Shade | None = None,
    cell_size_m: float | None = None,
) -> Picture:
    """Draw bands of what can be reached at what cost, the nearest first, on the cost or the relief.

    `field` is (H, W) float32, the cost of getting to each cell, inf where that is not possible;
    `levels` say where each band ends, ascending, and what the legend says of it (ASCII); `shade` is
    as of `plan_picture`.
    """
    ground = cost_picture(cost, shade)
    band = np.searchsorted([level for level, _ in levels], field)
    # along a scale from dark to light
    middles = 255 * (np.arange(len(levels)) + 0.5) / len(levels)
    scale = np.rint(middles[None]).astype(np.uint8)
    colours = cv2.applyColorMap(scale, cv2.COLORMAP_PLASMA)[0].tolist()
    for at, colour in enumerate(colours):
        ground[band == at] = _mixed(ground[band == at], _BAND, colour)

    # several pixels to a cell, so that lines between bands are thinner than cells
    fine = math.ceil(_SHARP / max(cost.shape))

    def enlarged(cells: NDArray[T]) -> NDArray[T]:
        return cells.repeat(fine, 0).repeat(fine, 1)

    ground = enlarged(ground)
    band = enlarged(band)
    edges = np.diff(band, axis=0, append=band[-1:]) != 0
    edges |= np.diff(band, axis=1, append=band[:, -1:]) != 0
    ground[edges & enlarged(cost < 1.0)] = INK

    drawing = MapDrawing(ground)
    row, col = (cell * fine + fine // 2 for cell in start)
    drawing.ends((row, col))
    bands = [
        (_tint(shade, _BAND, colour), words)
        for colour, (_, words) in zip(colours, levels, strict=True)
    ]
    swatches = [(START, "start"), *bands, *_impassable(cost)]
    keys = [drawing.swatch(*each) for each in swatches]
    side = None if cell_size_m is None else cell_size_m / fine
    return drawing.finish([keys, drawing.scale(side)])


def body_outlines(
    path: Line,
    vehicle: Vehicle,
    sides_m: tuple[float, float],
    headings_deg: Line | None = None,
) -> list[Floats]:
    """(N, 2) the body's outline, rows and columns, and a line from its front to its middle, all
    along a path.

    One at every second body length, at most a hundred; none for a path of less than two cells. Its
    headings (N,), in degrees clockwise from up the rows, are by default those to the next place.
    """
    if len(path) < 2:
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
    if headings_deg is None:
        down, right = steps[np.minimum(places, len(steps) - 1)].T
        headings = np.arctan2(right, -down)
    else:
        headings = np.radians(headings_deg[places])
    outlines = []
    for at, heading in zip(places, headings, strict=True):
        down = -math.cos(heading)
        right = math.sin(heading)
        outlines.append(path[at] + shape @ [(down, right), (-right, down)] / sides_m)
    return outlines


def refused_on(planner: Planner) -> Shade | None:
    """(H, W) the limits that refuse the planner's vehicle where it stands in no heading, see
    `robots.body.refusal.refusals`.

    None without a body, and on maps of more than `MOST_SHOWN` cells.
    """
    poses = planner.state.grid.robot.poses
    if poses is None or math.prod(planner.shape) > MOST_SHOWN:
        return None
    return refusals(poses.standing())


def png_bytes(picture: Picture) -> bytes:
    """Encode a picture as PNG."""
    return cv2.imencode(".png", picture)[1].tobytes()


def save_picture(path: Path, picture: Picture) -> None:
    """Write a PNG, whole or not at all; OutputError if it cannot be written."""
    write_whole(path, png_bytes(picture))


def _tints(plan: Plan, refused: Shade | None) -> Iterator[tuple[Mask, float, Colour, str]]:
    """Cells that are tinted: mask, how strongly, colour, and words of the legend."""
    if plan.network_region is not None:
        yield plan.network_region.mask(), 0.2, REGION, "network's region"
    if plan.region is not None:
        yield plan.region.mask(), 0.42, REGION, "region searched"
    if refused is not None:
        for limit in np.unique(refused[refused > 0]).tolist():
            yield refused == limit, _NO_STAND, *REFUSED[limit - 1]


def _lines(
    plan: Plan,
    reference_path: Line | None,
    point_path: Line | None,
) -> list[tuple[Line, Colour, float, str]]:
    """Paths that are drawn: places, colour, width, and words of the legend."""
    arcs = plan.states is not None
    freed = plan.line is not plan.path and not arcs
    words = "path of arcs" if arcs else "path freed from the grid" if freed else "path"
    other = "path with turns on the spot" if arcs else "path of a point"
    lines = (
        (plan.line, PATH, 5.0, words),
        (plan.path if freed else None, GRID, 1.5, "path of the grid"),
        (reference_path, OPTIMUM, 2.0, "exact optimum"),
        (point_path, POINT, 2.0, other),
    )
    return [
        (line, colour, width, words)
        for line, colour, width, words in lines
        if line is not None and len(line)
    ]


def _facts(plan: Plan, length_m: float | None) -> Iterator[str]:
    """Lines of the legend about the plan."""
    yield plan.method if plan.source is None else f"{plan.method} ({plan.source})"
    if not plan.ok:
        yield str(plan.status)
    if len(plan.path):
        yield f"cost {_number(plan.cost)}"
        if plan.waypoints is not None:
            yield f"line integral {_number(plan.line_cost)}"
        cells = f"{_number(plan.length)} cells"
        yield cells if length_m is None else f"length {metres(length_m)}"
    if "total" in plan.timings_ms:
        yield f"{_number(plan.timings_ms['total'])} ms"


def _number(x: float) -> str:
    """Four digits, or all of those before the point."""
    return f"{x:.0f}" if x >= 1000.0 else f"{x:.4g}"


def _impassable(cost: Float2D) -> list[tuple[Colour, str]]:
    """The key to impassable cells, if there are any."""
    return [] if (cost < 1.0).all() else [(IMPASSABLE, "impassable")]


def _tint(shade: Shade | None, strength: float, colour: Colour) -> Colour:
    """A colour laid over ground of middling lightness."""
    ground = np.full(3, 90 if shade is None else 190, np.uint8)
    return tuple(_mixed(ground, strength, colour).tolist())


def _mixed(ground: Picture, strength: float, colour: Colour) -> Picture:
    """A colour laid over the ground, which shows through."""
    return ((1.0 - strength) * ground + strength * np.array(colour)).astype(np.uint8)
