"""An episode on a map that changes, as pictures and as an animated one (Fig. 16)."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.benchmarks.dynamic_episode import Episode, Patch
from nnpp_edge.reproduction.pictures import (
    OPTIMUM,
    PATH,
    Cells,
    bare,
    draw_ends,
    draw_mark,
    draw_path,
    map_legend,
    new_figure,
    tinted,
)
from nnpp_edge.reproduction.regions import PaperRegions, optimal_path
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.network.inference import NetworkModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

_CHANGED, _DRIVEN, _OLD = "#ff3b1f", "#ff9e3d", "#b8b8b8"
_PAUSE_MS, _STEP_MS = 1100, 90
_SHADES = 40


@dataclass(frozen=True)
class View:
    """One plan of an episode."""

    cost: Float2D
    region: NDArray[np.bool_]
    """The network's, at the adaptive threshold td, by the paper's rule."""
    path: Cells
    """In the network's region; empty where it holds none."""
    optimum: Cells
    """The optimal path, which the robot follows."""
    patches: tuple[Patch, ...]
    """What has changed since the plan before."""


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def view_episode(episode: Episode, model: NetworkModel) -> list[View]:
    """What is shown of each plan."""
    views = []
    for at, step in enumerate(episode.steps):
        cost = episode.map_at(at)
        views.append(view_plan(cost, (step.start, episode.goal), model, step.patches))
    return views


def view_plan(cost: Float2D, query: Endpoints, model: NetworkModel, patches: tuple[Patch, ...] = ()) -> View:
    """What is shown of a query by the paper's method with this network."""
    regions = PaperRegions(cost, model)
    region, _ = regions.find(query)
    path, optimum = optimal_path(regions.grid, query, region), optimal_path(regions.grid, query)
    assert optimum is not None
    return View(cost, region.mask(), np.empty((0, 2), np.int32) if path is None else path, optimum, patches)


def driven(views: Sequence[View], stride: int) -> Cells:
    """The robot's way: so many cells of each path, and the last one to its end."""
    return np.concatenate([*(view.optimum[:stride] for view in views[:-1]), views[-1].optimum])


def draw_view(axes: "Axes", view: View, *, before: View | None = None) -> None:
    """A plan: map, region, optimal path, path in the region; and the path before, where that is another."""
    axes.imshow(tinted(view.cost, view.region), interpolation="nearest")
    if before is not None:
        draw_path(axes, before.optimum, _OLD, 1.2, "path before", ":")
        _outline(axes, view.patches)
    draw_path(axes, view.optimum, OPTIMUM, 3.0, "optimal path")
    draw_path(axes, view.path, PATH, 1.2, "path in the region")
    draw_ends(axes, view.optimum[0], view.optimum[-1])


def draw_driven(axes: "Axes", views: Sequence[View], stride: int) -> None:
    """The way that the robot went, on the last map."""
    way = driven(views, stride)
    axes.imshow(tinted(views[-1].cost), interpolation="nearest")
    draw_path(axes, way, _DRIVEN, 2.2, "driven")
    draw_ends(axes, way[0], way[-1])


def legend(figure: "Figure", axes: "Axes", *, changes: bool = True) -> None:
    """Below the figure, of what was drawn on `axes`, and of regions and, if wanted, changes."""
    map_legend(figure, axes, "network's region at td", columns=4, changed=_CHANGED if changes else "")


def animate(views: Sequence[View], stride: int, cells_a_frame: int) -> bytes:
    """The episode as a GIF: the map changes, the path is replanned, the robot drives on.

    The robot drives `stride` cells between two plans, and `cells_a_frame` from one picture to the next.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure = new_figure(4.6, 4.8)
    figure.set_layout_engine("none")  # nothing shifts from frame to frame
    canvas = FigureCanvasAgg(figure)
    shots, durations_ms = [], []
    for duration_ms in _scenes(figure, views, stride, cells_a_frame):
        canvas.draw()  # type: ignore[no-untyped-call]
        shots.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))  # type: ignore[no-untyped-call]
        durations_ms.append(duration_ms)
    # one palette for all: only what moves differs from frame to frame, and only that is stored
    palette = _palette()
    frames = [shot.quantize(palette=palette, dither=Image.Dither.NONE) for shot in shots]
    content = io.BytesIO()
    frames[0].save(
        content, format="GIF", save_all=True, append_images=frames[1:], duration=durations_ms, loop=0, optimize=False
    )
    return content.getvalue()


def _scenes(figure: "Figure", views: Sequence[View], stride: int, cells_a_frame: int) -> Iterator[int]:
    """Draw picture after picture; for how many milliseconds each is to be seen."""
    way = np.empty((0, 2), np.int32)
    for at, view in enumerate(views):
        if at:
            axes = _empty(figure, f"{frame(at)}: the map has changed")
            axes.imshow(tinted(view.cost, views[at - 1].region), interpolation="nearest")
            draw_path(axes, views[at - 1].optimum[stride:], OPTIMUM, 2.4)
            _outline(axes, view.patches)
            draw_path(axes, way, _DRIVEN, 2.0)
            draw_ends(axes, view.optimum[0], view.optimum[-1])
            yield _PAUSE_MS
        axes = _empty(figure, f"{frame(at)}: {'planned anew' if at else 'planned'}")
        draw_view(axes, view)
        drawn = draw_path(axes, way, _DRIVEN, 2.0)
        robot = draw_mark(axes, view.optimum[0], "o", "white", 7)
        yield _PAUSE_MS
        last = at + 1 == len(views)
        part = view.optimum if last else view.optimum[: stride + 1]
        for end in [*range(cells_a_frame, len(part), cells_a_frame), len(part)]:
            so_far = np.concatenate([way, part[:end]])
            drawn.set_data(so_far[:, 1], so_far[:, 0])
            robot.set_data([so_far[-1, 1]], [so_far[-1, 0]])
            yield _STEP_MS
        way = np.concatenate([way, part])
    yield _PAUSE_MS


def _palette() -> "Image":
    """What the pictures are drawn in: ground, ground inside a region, and what lies upon it, down to black."""
    from matplotlib.colors import to_rgb
    from PIL import Image

    ramp = np.linspace(0.0, 1.0, _SHADES, dtype=np.float32)[None]
    inside = tinted(np.minimum(ramp, 0.999), np.ones(ramp.shape, bool))[0]
    marks = [to_rgb(colour) for colour in (OPTIMUM, PATH, _CHANGED, _DRIVEN, "gold", "red")]
    impassable = tinted(np.ones((1, 1), np.float32))[0]
    colours = [np.repeat(ramp.T, 3, axis=1), inside, *(f * np.array([*marks, *impassable]) for f in (1.0, 0.8, 0.6))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.rint(255.0 * np.concatenate(colours)).astype(np.uint8).tobytes())
    return palette


def _empty(figure: "Figure", title: str) -> "Axes":
    figure.clear()
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.92))
    bare(axes, title)
    return axes


def _outline(axes: "Axes", patches: Sequence[Patch]) -> None:
    """Rectangles around what has changed."""
    from matplotlib.patches import Rectangle

    for row, col, patch in patches:
        rows, cols = patch.shape
        axes.add_patch(
            Rectangle((col - 0.5, row - 0.5), cols, rows, fill=False, edgecolor=_CHANGED, linewidth=1.3, zorder=4)
        )
