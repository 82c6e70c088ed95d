"""Pictures of cost maps and plans, with OpenCV alone, so that the onboard install can draw them.

Grey is traversability cost, the whiter the costlier, as in the paper; impassable cells are dark brown.
A picture is (H, W, 3) uint8 in OpenCV's order blue, green, red.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.viz.sheet import INK, Cells, Colour, MapDrawing, Picture, metres

Mask = NDArray[np.bool_]

IMPASSABLE: Colour = (34, 44, 96)
REGION: Colour = (255, 230, 0)
PATH: Colour = (20, 120, 255)
OPTIMUM: Colour = (255, 90, 235)
GRID: Colour = (150, 245, 255)
BODY: Colour = (120, 255, 190)
POINT: Colour = (255, 255, 255)
_NO_STAND = 0.45
"""How strongly cells are coloured where a vehicle stands in no heading."""
_LIGHT = (315.0, 45.0)
"""Azimuth and height of the light of a hillshade, degrees."""


class BodyDrawing(NamedTuple):
    """A vehicle in a picture."""

    outlines: Sequence[NDArray[np.float64]]
    """Of the body along the path, rows and columns; from `body_outlines`."""
    stands: Mask | None = None
    """(H, W) cells where it stands in some heading; None where that is not known."""
    point_path: Cells | None = None
    """(N, 2) the path of a point, drawn dashed."""


_NO_BODY = BodyDrawing(())


def cost_picture(cost: Float2D) -> Picture:
    """A cell a pixel: grey from 0 (black) to 1 (white); impassable cells, NaN or from 1 up, in dark brown."""
    passable = cost < 1.0
    grey = np.clip(np.where(passable, cost, 0.0) * 255.0, 0.0, 255.0).astype(np.uint8)
    return with_obstacles(grey, passable)


def hillshade(elevation: Float2D, cell_size_m: float, cell_width_m: float | None = None) -> NDArray[np.uint8]:
    """Relief lit from the north-west: (H, W) uint8; unknown ground as if it were flat.

    Heights are exaggerated so that the steepest tenth of the map stands out, but never flattened.
    """
    rows, cols = (max(n, 2) for n in elevation.shape)  # np.gradient wants two
    padded = np.pad(elevation, [(0, rows - elevation.shape[0]), (0, cols - elevation.shape[1])], mode="edge")
    south, east = np.gradient(padded, cell_size_m, cell_width_m or cell_size_m)
    tilt = np.hypot(south, east)[: elevation.shape[0], : elevation.shape[1]]
    steep = float(np.nanquantile(tilt, 0.9)) if np.isfinite(tilt).any() else 0.0
    gain = min(max(0.7 / max(steep, 1e-6), 1.0), 50.0)
    azimuth, height = (math.radians(angle) for angle in _LIGHT)
    toward = (math.cos(azimuth) * south - math.sin(azimuth) * east) * gain
    light = (math.sin(height) + math.cos(height) * toward) / np.sqrt(1.0 + gain**2 * (south**2 + east**2))
    light = np.nan_to_num(light, nan=math.sin(height))[: elevation.shape[0], : elevation.shape[1]]
    return np.asarray(40.0 + 205.0 * np.clip(light, 0.0, 1.0)).astype(np.uint8)


def cost_map_picture(cost: Float2D, *, cell_size_m: float | None = None, title: str = "") -> Picture:
    """A cost map (H, W) above a colour bar, a scale and the key to impassable cells; the title is ASCII."""
    drawing = MapDrawing(cost_picture(cost))
    items = [drawing.text_item(title)] if title else []
    items.append(drawing.grey_bar())
    if not (cost < 1.0).all():
        items.append(drawing.swatch(IMPASSABLE, "impassable"))
    return drawing.finish([items + drawing.scale(cell_size_m)])


def plan_picture(
    cost: Float2D,
    plan: Plan,
    *,
    start: tuple[int, int] | None = None,
    goal: tuple[int, int] | None = None,
    via: Sequence[tuple[int, int]] = (),
    shade: NDArray[np.uint8] | None = None,
    reference_path: Cells | None = None,
    cell_size_m: float | None = None,
    length_m: float | None = None,
    body: BodyDrawing = _NO_BODY,
) -> Picture:
    """A plan on its map: regions in translucent cyan, path, start (yellow square) and goal (red star).

    Parameters
    ----------
    cost : (H, W) float32
        Traversability cost; `shade`, (H, W) uint8 from `hillshade`, is drawn in its place.
    plan : Plan
        Made with its regions, if they are to be drawn. Start and goal are by default the ends of its path.
    via : sequence of (row, col)
        Places between, in the order in which they are visited.
    reference_path : (N, 2) int
        The exact optimum, drawn dashed.
    cell_size_m, length_m : float
        For the scale and the legend; without a length it gives that in cells.
    """
    regions = [
        (region, strength, words)
        for region, strength, words in (
            (plan.network_region, 0.2, "network's region"),
            (plan.region, 0.42, "region searched"),
        )
        if region is not None
    ]
    passable = cost < 1.0
    ground = cost_picture(cost) if shade is None else with_obstacles(shade, passable)
    if body.stands is not None:
        mask = passable & ~body.stands
        ground[mask] = mixed(ground[mask], _NO_STAND, IMPASSABLE)
    for region, strength, _ in regions:
        mask = region.mask() & passable
        ground[mask] = mixed(ground[mask], strength)
    drawing = MapDrawing(ground)
    keys = []
    # the optimum lies on the path, thinner, and its rim below: both are seen where they agree
    lines: list[tuple[Line, Colour, float, bool]] = [(plan.line, PATH, 4.0, False)]
    if freed := plan.line is not plan.path:
        lines.append((plan.path, GRID, 1.5, True))
    if reference_path is not None:
        lines.append((reference_path, OPTIMUM, 2.0, True))
    if body.point_path is not None:
        lines.append((body.point_path, POINT, 2.0, True))
    lines = [line for line in lines if len(line[0])]
    for rim in (True, False):
        for path, colour, width, dashed in reversed(lines) if rim else lines:
            drawing.line(path, INK if rim else colour, width + 2.0 * rim, dashed)
    for outline in body.outlines:
        drawing.line(outline, INK, 2.5)
        drawing.line(outline, BODY, 1.2)
    if len(plan.path):
        keys.append(drawing.line_key(PATH, "path freed from the grid" if freed else "path"))
        start = start or (int(plan.path[0, 0]), int(plan.path[0, 1]))
        goal = goal or (int(plan.path[-1, 0]), int(plan.path[-1, 1]))
    if freed:
        keys.append(drawing.line_key(GRID, "path of the grid", dashed=True))
    if len(body.outlines):
        keys.append(drawing.line_key(BODY, "vehicle"))
    if reference_path is not None and len(reference_path):
        keys.append(drawing.line_key(OPTIMUM, "exact optimum", dashed=True))
    if body.point_path is not None and len(body.point_path):
        keys.append(drawing.line_key(POINT, "path of a point", dashed=True))
    for number, stop in enumerate(via, 1):
        drawing.numbered(drawing.at(stop), str(number))
    if via:
        keys.insert(0, drawing.symbol_key(lambda middle: drawing.numbered(middle, "1"), "by way of"))
    if goal is not None:
        drawing.star(drawing.at(goal))
        keys.insert(0, drawing.symbol_key(drawing.star, "goal"))
    if start is not None:
        drawing.square(drawing.at(start))
        keys.insert(0, drawing.symbol_key(drawing.square, "start"))
    middling = 190 if shade is not None else 90
    for _, strength, words in regions:
        keys.append(drawing.swatch(tuple(mixed(np.full(3, middling, np.uint8), strength).tolist()), words))
    if body.stands is not None and not body.stands.all():
        tint = mixed(np.full(3, middling, np.uint8), _NO_STAND, IMPASSABLE)
        keys.append(drawing.swatch(tuple(tint.tolist()), "stands in no heading"))
    if not passable.all():
        keys.append(drawing.swatch(IMPASSABLE, "impassable"))
    if shade is None:
        keys.append(drawing.grey_bar())
    facts = [drawing.text_item(text) for text in _facts(plan, length_m)]
    return drawing.finish([keys, facts + drawing.scale(cell_size_m)])


def body_outlines(path: Cells, vehicle: Vehicle, sides_m: tuple[float, float]) -> list[NDArray[np.float64]]:
    """(N, 2) the body's outline, rows and columns, and a line from its front to its middle, all along a path.

    One at every second body length, at most a hundred; none for a path of less than two cells.
    """
    if len(path) < 2:
        return []
    steps = np.diff(path, axis=0) * sides_m
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*steps.T))))
    shape = _outline(vehicle)
    count = min(max(int(along[-1] / (4.0 * shape[:, 0].max())), 1), 100)
    outlines = []
    for at in np.searchsorted(along, np.linspace(0.0, along[-1], count + 1)).tolist():
        step = steps[min(at, len(steps) - 1)]
        ahead = step / np.hypot(*step)
        left = np.array((-ahead[1], ahead[0]))  # rows go down
        outlines.append(path[at] + (shape @ np.array((ahead, left))) / sides_m)
    return outlines


def _outline(vehicle: Vehicle) -> NDArray[np.float64]:
    """(N, 2) metres ahead of the body's middle and to its left: from the front's middle around, and to the middle."""
    if vehicle.radius_m is not None:
        turns = np.linspace(0.0, 2.0 * math.pi, 33)
        around = vehicle.radius_m * np.column_stack((np.cos(turns), np.sin(turns)))
    else:
        corners = np.array([(1, 0), (1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)])
        around = corners * (vehicle.length_m / 2.0, vehicle.width_m / 2.0)
    return np.concatenate((around, np.zeros((1, 2))))


def png_bytes(picture: Picture) -> bytes:
    """A picture as a PNG; OutputError if it is none."""
    done, content = cv2.imencode(".png", picture)
    if not done:
        raise OutputError(f"a picture could not be encoded as PNG ({picture.shape} {picture.dtype})")
    return content.tobytes()


def save_picture(path: Path, picture: Picture) -> None:
    """Write a PNG, whole or not at all; OutputError if it cannot be written."""
    write_whole(path, png_bytes(picture))


def _facts(plan: Plan, length_m: float | None) -> Iterator[str]:
    """Lines of the legend about the plan."""
    yield plan.method if plan.source is None else f"{plan.method} ({plan.source})"
    if not plan.ok:
        yield str(plan.status)
    if len(plan.path):
        yield f"cost {_number(plan.cost)}"
        if plan.waypoints is not None:
            yield f"line integral {_number(plan.line_cost)}"
        yield f"{_number(plan.length)} cells" if length_m is None else f"length {metres(length_m)}"
    if "total" in plan.timings_ms:
        yield f"{_number(plan.timings_ms['total'])} ms"


def _number(x: float) -> str:
    """Four digits, or all of those before the point."""
    return f"{x:.0f}" if x >= 1000.0 else f"{x:.4g}"


def with_obstacles(grey: NDArray[np.uint8], passable: Mask) -> Picture:
    picture = np.repeat(grey[..., None], 3, axis=2)
    picture[~passable] = IMPASSABLE
    return picture


def mixed(ground: NDArray[np.uint8], strength: float, colour: Colour = REGION) -> NDArray[np.uint8]:
    """A colour laid over the ground, which shows through."""
    return ((1.0 - strength) * ground + strength * np.array(colour)).astype(np.uint8)
