"""Pictures of a simulated drive: a still of all of it, or a film."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Floats
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import PathMessage
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.simulation.scene import Scene
from nnpp_edge.simulation.simulate import DriveOutcome
from nnpp_edge.terrain.obstacles import covered
from nnpp_edge.viz.palette import BODY, DRIVEN, GOAL, INK, OPTIMUM, PAPER, PATH, SEEN, START
from nnpp_edge.viz.picture import SHUT_GROUND, Chart, Drawn, body_outlines
from nnpp_edge.viz.sheet import Picture

if TYPE_CHECKING:
    from PIL.Image import Image

_GROUND_COLOURS = 48
_MOST_FRAMES = 80
_FRAME_PIXELS = 480
_FRAME_MS = 100


def film_of(path: Path | None) -> "Film | None":
    """A film where the picture is to be a .gif; InvalidQueryError unless it is that or a .png,
    ModuleNotFoundError where Pillow is missing.
    """
    kind = path.suffix.lower() if path else ".png"
    if path and kind not in (".png", ".gif"):
        raise InvalidQueryError(f"a picture must be a .png or .gif file, got {path.name}")
    if kind == ".png":
        return None
    import PIL  # noqa: F401

    return Film()


def drive_picture(ground: SurveyedGround, drive: DriveOutcome) -> Picture:
    """Draw the true ground, the way driven, and the optimum for a robot that knew everything.

    Of a body the outline is drawn along the way; the cost of a cell is that of its best heading
    there.
    """
    lines = [
        Drawn(drive.driven, DRIVEN, 5.0, "driven"),
        Drawn(drive.optimal, OPTIMUM, 1.2, "optimum, with all known"),
    ]
    costs = f"cost {drive.driven_cost:.4g}, optimum {drive.optimal_cost:.4g}"
    if drive.excess is not None:
        costs += f" (+{100 * drive.excess:.1f} %)"
    facts = [drive.method, f"{drive.counters.ticks} ticks, {drive.counters.planned} plans", costs]
    chart = _chart(ground, ground.costs())
    ways = [line.places[:, :2].astype(np.float64) for line in lines]
    return chart.picture(
        drive.start,
        drive.goal,
        lines=lines,
        outlines=_bodies(ground, drive.driven),
        part=chart.around(np.concatenate((*ways, np.array([drive.goal])))),
        facts=facts,
    )


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

            picture = _frame(scene, message)
            self._colours = self._colours or _palette(picture)
            image = Image.fromarray(np.ascontiguousarray(picture[..., ::-1]))
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


def _frame(scene: Scene, message: PathMessage) -> Picture:
    """The map as the loop has it, which to a body is no higher inside an obstacle than at its
    rim: that is shut as a whole.
    """
    told = scene.ground.costs_on(scene.told)
    told = covered(told, (0, 0, *told.shape), scene.obstacles.blocks, np.inf)
    chart = _chart(scene.ground, told)

    # the path, the way driven, the body along the path and where it is, and what it sees
    driven = np.array(scene.driven)[:, :2]
    row, col, rows, cols = scene.seen
    bottom = row + rows - 1
    right = col + cols - 1
    view = np.array([(row, col), (row, right), (bottom, right), (bottom, col), (row, col)])
    lines = [
        Drawn(view, SEEN, 2.0, "seen"),
        Drawn(message.path, PATH, 3.0, "planned"),
        Drawn(driven, DRIVEN, 3.0, "driven"),
    ]
    return chart.picture(
        scene.robot,
        scene.goal,
        lines=lines,
        outlines=_bodies(scene.ground, message.path, message.headings_deg),
        begin="robot",
        least=_FRAME_PIXELS,
    )


def _bodies(ground: SurveyedGround, path: Line, headings_deg: Line | None = None) -> list[Floats]:
    """As `body_outlines`; none of a point."""
    vehicle = ground.ground.vehicle
    if vehicle is None:
        return []
    return body_outlines(path, vehicle, ground.ground.sides_m, headings_deg)


def _palette(picture: Picture) -> "Image":
    """The few colours that all frames share: then a film stores only the pixels that change."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(picture[..., ::-1]))
    ground = image.quantize(_GROUND_COLOURS).getpalette() or []
    drawn = (INK, PAPER, SHUT_GROUND, PATH, BODY, DRIVEN, SEEN, GOAL, START)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*ground, *(value for colour in drawn for value in reversed(colour))])
    return palette
