"""Pictures of a simulated drive: a still of all of it, or a film."""

import math
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import PathMessage
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.simulation.robots import Robot
from nnpp_edge.simulation.scene import Scene, SurveyedGround
from nnpp_edge.simulation.simulate import Drive
from nnpp_edge.viz.picture import IMPASSABLE, OPTIMUM, PATH, body_outlines, cost_picture
from nnpp_edge.viz.sheet import BODY, GOAL, START, Colour, MapDrawing, Picture

if TYPE_CHECKING:
    from PIL.Image import Image

DRIVEN: Colour = (70, 190, 40)
SEEN: Colour = (255, 210, 60)
_GREYS = 20
_MOST_FRAMES = 80
_FRAME_PIXELS = 480
_FRAME_MS = 100


def check_name(path: Path) -> None:
    """InvalidQueryError unless the name ends in .png or .gif; ModuleNotFoundError where Pillow is
    missing.
    """
    if path.suffix.lower() not in (".png", ".gif"):
        raise InvalidQueryError(f"a picture must be a .png or .gif file, got {path.name}")
    if path.suffix.lower() == ".gif":
        import PIL  # noqa: F401


def drive_picture(ground: SurveyedGround, drive: Drive) -> Picture:
    """Draw the true cost, the way driven, and the optimum for a robot that knew everything.

    Of a body the outline is drawn along the way; the cost of a cell is that of its best heading
    there."""
    sheet = MapDrawing(cost_picture(ground.costs()))
    sheet.line(drive.driven, DRIVEN, 4.0)
    sheet.line(drive.optimal, OPTIMUM, 2.0)
    bodies = _bodies(ground.robot, drive.driven)
    sheet.bodies(bodies)
    sheet.ends(drive.start, drive.goal)

    # the legend
    swatches = [(START, "start"), (GOAL, "goal"), (DRIVEN, "driven")]
    swatches.append((OPTIMUM, "optimum, with all known"))
    if bodies:
        swatches.append((BODY, "vehicle"))
    costs = f"cost {drive.driven_cost:.4g}, optimum {drive.optimal_cost:.4g}"
    if drive.excess is not None:
        costs += f" (+{100 * drive.excess:.1f} %)"
    facts = [drive.method, f"{drive.counters.ticks} ticks, {drive.counters.planned} plans", costs]
    keys = [sheet.swatch(*each) for each in swatches]
    scale = sheet.scale(ground.robot.sides_m[0])
    words = [sheet.text_item(fact) for fact in facts]
    return sheet.finish([keys, words + scale, [sheet.grey_bar()]])


class Film:
    """Frames of a drive: the map as the loop has it, the way driven, the robot, its path, and its
    body along that.

    At most 80 frames are kept. When there are more, every second one is dropped, and half as many
    are made from then.
    """

    def __init__(self) -> None:
        self._frames: list[Image] = []
        self._every = 1
        self._ticks = 0

    def __call__(self, scene: Scene, message: PathMessage) -> None:
        """Add the frame of a tick."""
        if self._ticks % self._every == 0 or scene.reached:
            self._frames.append(_palette(_frame(scene, message)))
            if len(self._frames) > _MOST_FRAMES:
                del self._frames[1::2]
                self._every *= 2
        self._ticks += 1

    def save(self, path: Path) -> None:
        """Write a GIF, whole or not at all; OutputError if it cannot be written."""
        content = BytesIO()
        first, *rest = self._frames
        kept = {"append_images": rest, "duration": [_FRAME_MS] * len(rest) + [2000], "loop": 0}
        first.save(content, "GIF", save_all=True, optimize=False, **kept)
        write_whole(path, content.getvalue())


def _frame(scene: Scene, message: PathMessage) -> Picture:
    robot = scene.ground.robot
    ground = cost_picture(robot.costs(scene.told))
    factor = _FRAME_PIXELS / max(ground.shape[:2])
    height, width = (round(side * factor) for side in ground.shape[:2])
    picture = cv2.resize(ground, (width, height), interpolation=cv2.INTER_NEAREST)

    # the path, the way driven, the body along the path and where it is
    driven = np.array(scene.driven)[:, :2]
    lines: list[tuple[Line, Colour, int]] = [(message.path, PATH, 2), (driven, DRIVEN, 2)]
    lines += [(outline, BODY, 1) for outline in _bodies(robot, message.path)]
    lines += [(outline, START, 2) for outline in _bodies(robot, driven)[-1:]]
    for cells, colour, width in lines:
        if len(cells):
            cv2.polylines(picture, [_pixels(cells, factor)], False, colour, width, cv2.LINE_AA)

    # what the robot sees, its goal and the robot
    row, col, rows, cols = scene.seen
    view = np.array([(row, col), (row + rows - 1, col + cols - 1)])
    first, last = _pixels(view, factor).tolist()
    cv2.rectangle(picture, first, last, SEEN, 1)
    radius = max(3, math.ceil(factor)) + 1
    (goal, place) = _pixels(np.array([scene.goal, scene.robot]), factor).tolist()
    cv2.circle(picture, goal, radius, GOAL, -1, cv2.LINE_AA)
    cv2.circle(picture, place, radius, START, -1, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def _bodies(robot: Robot, path: Line) -> list[Floats]:
    """(5, 2) outlines of the robot's body along a path, rows and columns; none of a point."""
    return [] if robot.vehicle is None else body_outlines(path, robot.vehicle, robot.sides_m)


def _pixels(cells: NDArray[np.generic], factor: float) -> Cells:
    middles = cells[:, ::-1].astype(np.float64) + 0.5
    return np.rint(middles * factor - 0.5).astype(np.int32)


def _palette(picture: Picture) -> "Image":
    """In the few colours that all frames share: then a film stores only the pixels that change."""
    from PIL import Image

    levels = np.linspace(0, 255, _GREYS).astype(int).tolist()
    greys = [(level, level, level) for level in levels]
    colours = [*greys, IMPASSABLE, PATH, BODY, DRIVEN, SEEN, GOAL, START]
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in colours for value in reversed(colour)])
    image = Image.fromarray(np.ascontiguousarray(picture[..., ::-1]))
    return image.quantize(palette=palette, dither=Image.Dither.NONE)
