"""Pictures of a simulated drive: a still of all of it, or a film."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.loop.messages import PathMessage
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.simulation.scene import Scene
from nnpp_edge.simulation.simulate import DriveOutcome
from nnpp_edge.terrain.obstacles import covered
from nnpp_edge.viz.palette import (
    BODY,
    DRIVEN,
    GOAL,
    IMPASSABLE,
    INK,
    OPTIMUM,
    PAPER,
    PATH,
    SEEN,
    START,
    rgb,
)
from nnpp_edge.viz.picture import MapDrawing, body_outlines, encoded
from nnpp_edge.viz.relief import Chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

_GROUND_COLOURS = 48
_MOST_FRAMES = 80
_FRAME_INCHES = 4.8
_FRAME_MS = 100


def film_of(path: Path | None) -> "Film | None":
    """A film where the picture is to be a .gif; InvalidQueryError unless it is that or a .png,
    MissingExtraError where it cannot be drawn.
    """
    kind = path.suffix.lower() if path else ".png"
    if path and kind not in (".png", ".gif"):
        raise InvalidQueryError(f"a picture must be a .png or .gif file, got {path.name}")
    if path:
        optional_module("matplotlib", "--picture", "viz")
    return Film() if kind == ".gif" else None


def drive_picture(ground: SurveyedGround, drive: DriveOutcome) -> "Figure":
    """Draw the true ground, the way driven, and the optimum for a robot that knew everything.

    Of a body the outline is drawn along the way; the cost of a cell is that of its best heading
    there.
    """
    drawing = MapDrawing(
        _chart(ground, ground.costs()), [drive.driven, drive.optimal, np.array([drive.goal])]
    )
    drawing.line(drive.driven, DRIVEN, 4.0, "driven")
    drawing.line(drive.optimal, OPTIMUM, 0.9, "optimum, with all known", None)
    robot = ground.ground
    drawing.bodies(body_outlines(drive.driven, robot.vehicle, robot.sides_m))
    drawing.ends(drive.start, drive.goal)

    costs = f"cost {drive.driven_cost:.4g}, optimum {drive.optimal_cost:.4g}"
    if drive.excess is not None:
        costs += f" (+{100 * drive.excess:.1f} %)"
    facts = [drive.method, f"{drive.counters.ticks} ticks, {drive.counters.planned} plans", costs]
    return drawing.finish(facts)


def _chart(ground: SurveyedGround, cost: Float2D) -> Chart:
    """The ground to draw on."""
    return Chart(cost, ground.heights, ground.ground.sides_m, ground.north_deg)


class Film:
    """Frames of a drive: the map as the loop has it, the way driven, the robot, its path, and its
    body along that.

    At most 80 frames are kept. When there are more, every second one is dropped, and half as many
    are made from then.
    """

    def __init__(self) -> None:
        self._frames: list[Image] = []
        self._colours: Image | None = None
        self._every = 1
        self._ticks = 0

    def __call__(self, scene: Scene, message: PathMessage) -> None:
        """Add the frame of a tick."""
        if self._ticks % self._every == 0 or scene.reached:
            from PIL import Image

            image = Image.open(BytesIO(_frame(scene, message))).convert("RGB")
            self._colours = self._colours or _palette(image)
            self._frames.append(image.quantize(palette=self._colours, dither=Image.Dither.NONE))
            if len(self._frames) > _MOST_FRAMES:
                del self._frames[1::2]
                self._every *= 2
        self._ticks += 1

    def gif(self) -> bytes:
        """All of it."""
        content = BytesIO()
        first, *rest = self._frames
        kept = {"append_images": rest, "duration": [_FRAME_MS] * len(rest) + [2000], "loop": 0}
        first.save(content, "GIF", save_all=True, optimize=False, **kept)
        return content.getvalue()


def _frame(scene: Scene, message: PathMessage) -> bytes:
    """The map as the loop has it, which to a body is no higher inside an obstacle than at its
    rim: that is shut as a whole.
    """
    from matplotlib.transforms import Bbox

    told = scene.ground.costs_on(scene.told)
    told = covered(told, (0, 0, *told.shape), scene.obstacles.blocks, np.inf)
    drawing = MapDrawing(_chart(scene.ground, told), inches=_FRAME_INCHES)

    # the path, the way driven, the body along the path and where it is, and what it sees
    driven = np.array(scene.driven)[:, :2]
    row, col, rows, cols = scene.seen
    bottom = row + rows - 1
    right = col + cols - 1
    view = np.array([(row, col), (row, right), (bottom, right), (bottom, col), (row, col)])
    drawing.line(view, SEEN, 2.0, "seen")
    drawing.line(message.path, PATH, 2.8, "planned")
    drawing.line(driven, DRIVEN, 2.8, "driven")
    robot = scene.ground.ground
    outlines = body_outlines(message.path, robot.vehicle, robot.sides_m, message.headings_deg)
    drawing.bodies(outlines)
    drawing.ends(scene.robot, scene.goal, "robot")

    # all frames have the same margins
    figure = drawing.finish()
    width, height = figure.get_size_inches()
    return encoded(figure, box=Bbox.from_extents(-0.2, -1.0, width + 0.8, height + 0.3))


def _palette(image: "Image") -> "Image":
    """The few colours that all frames share: then a film stores only the pixels that change."""
    from PIL import Image

    ground = image.quantize(_GROUND_COLOURS).getpalette() or []
    drawn = (INK, IMPASSABLE, PAPER, PATH, BODY, DRIVEN, SEEN, GOAL, START)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*ground, *(value for colour in drawn for value in rgb(colour))])
    return palette
