"""An episode on a map that changes, as pictures and as an animated one (Fig. 16)."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.benchmarks.dynamic_episode import Episode, Patch
from nnpp_edge.reproduction.pictures import OPTIMUM, PATH, REGION, new_figure, tinted
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner

_CHANGED, _DRIVEN, _OLD = "#ff3b1f", "#ff9e3d", "#b8b8b8"
_ENDS: dict[str, Any] = {"markeredgecolor": "black", "linestyle": "none", "clip_on": False, "zorder": 5}
_PAUSE_MS, _STEP_MS = 1100, 90
_SHADES = 40


@dataclass(frozen=True)
class View:
    """One plan of an episode."""

    cost: NDArray[np.float32]
    region: NDArray[np.bool_]
    """The network's, at the adaptive threshold td."""
    path: NDArray[np.int32]
    """In the network's region."""
    optimum: NDArray[np.int32]
    """The optimal path, which the robot follows."""
    patches: tuple[Patch, ...]
    """What has changed since the plan before."""


def frame(at: int) -> str:
    """A plan's name in the paper."""
    return ("T", "T + Δt")[at] if at < 2 else f"T + {at}Δt"


def view_episode(episode: Episode, model: NetworkModel) -> list[View]:
    """What is to be seen of each plan."""
    views = []
    for at, step in enumerate(episode.steps):
        cost = episode.map_at(at)
        planner = Planner(cost, model=model, ask_from=0)
        plan = planner.plan(step.start, episode.goal, method="nnpp")
        assert plan.network_region is not None
        region = plan.network_region.mask()
        optimum = planner.plan(step.start, episode.goal, method="astar").path
        views.append(View(cost, region, plan.path, optimum, step.patches))
    return views


def driven(views: Sequence[View], stride: int) -> NDArray[np.int32]:
    """The robot's way: so many cells of each path, and the last one to its end."""
    return np.concatenate([*(view.optimum[:stride] for view in views[:-1]), views[-1].optimum])


def draw_view(axes: Any, view: View, *, before: View | None = None) -> None:
    """A plan: map, region, optimal path, path in the region; and the path before, where that is another."""
    axes.imshow(tinted(view.cost, view.region), interpolation="nearest")
    if before is not None:
        _line(axes, before.optimum, _OLD, 1.2, "path before", linestyle=":")
        _outline(axes, view.patches)
    _line(axes, view.optimum, OPTIMUM, 3.0, "optimal path")
    _line(axes, view.path, PATH, 1.2, "path in the region")
    _ends(axes, view.optimum[0], view.optimum[-1])


def draw_driven(axes: Any, views: Sequence[View], stride: int) -> None:
    """The way that the robot went, on the last map."""
    way = driven(views, stride)
    axes.imshow(tinted(views[-1].cost), interpolation="nearest")
    _line(axes, way, _DRIVEN, 2.2, "driven")
    _ends(axes, way[0], way[-1])


def legend(figure: Any, axes: Any, *, changes: bool = True) -> None:
    """Below the figure, of what was drawn on `axes`, and of regions and, if wanted, changes."""
    from matplotlib.patches import Patch as Swatch

    handles, labels = axes.get_legend_handles_labels()
    handles.append(Swatch(facecolor=REGION))
    labels.append("network's region at td")
    if changes:
        handles.append(Swatch(facecolor="none", edgecolor=_CHANGED))
        labels.append("changed")
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="small", frameon=False)


def animate(views: Sequence[View], stride: int, cells_a_frame: int) -> bytes:
    """The episode as a GIF: the map changes, the path is replanned, the robot drives on.

    Parameters
    ----------
    views : sequence of View
        Of all plans.
    stride : int
        Cells that the robot drives between two plans.
    cells_a_frame : int
        Cells that it drives from one picture to the next.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure = new_figure(4.6, 4.8)
    figure.set_layout_engine("none")  # nothing shifts from frame to frame
    canvas = FigureCanvasAgg(figure)
    shots, durations_ms = [], []
    for duration_ms in _scenes(figure, views, stride, cells_a_frame):
        canvas.draw()
        shots.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
        durations_ms.append(duration_ms)
    # one palette for all: only what moves differs from frame to frame, and only that is stored
    palette = _palette()
    frames = [shot.quantize(palette=palette, dither=Image.Dither.NONE) for shot in shots]
    content = io.BytesIO()
    frames[0].save(
        content, format="GIF", save_all=True, append_images=frames[1:], duration=durations_ms, loop=0, optimize=False
    )
    return content.getvalue()


def _scenes(figure: Any, views: Sequence[View], stride: int, cells_a_frame: int) -> Iterator[int]:
    """Draw picture after picture; for how many milliseconds each is to be seen."""
    way = np.empty((0, 2), np.int32)
    for at, view in enumerate(views):
        if at:
            axes = _empty(figure, f"{frame(at)}: the map has changed")
            axes.imshow(tinted(view.cost, views[at - 1].region), interpolation="nearest")
            _line(axes, views[at - 1].optimum[stride:], OPTIMUM, 2.4)
            _outline(axes, view.patches)
            _line(axes, way, _DRIVEN, 2.0)
            _ends(axes, view.optimum[0], view.optimum[-1])
            yield _PAUSE_MS
        axes = _empty(figure, f"{frame(at)}: {'planned anew' if at else 'planned'}")
        draw_view(axes, view)
        drawn = _line(axes, way, _DRIVEN, 2.0)
        robot = axes.plot(*view.optimum[0][::-1], "o", color="white", markersize=7, **{**_ENDS, "zorder": 6})[0]
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


def _palette() -> Any:
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


def _empty(figure: Any, title: str) -> Any:
    figure.clear()
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.92))
    bare(axes, title)
    return axes


def bare(axes: Any, title: str) -> None:
    """A title, and no ticks."""
    axes.set_title(title, fontsize="small")
    axes.set_xticks([])
    axes.set_yticks([])


def _line(axes: Any, path: NDArray[np.int32], colour: str, width: float, label: str = "", **style: Any) -> Any:
    (drawn,) = axes.plot(path[:, 1], path[:, 0], color=colour, linewidth=width, label=label, **style)
    return drawn


def _ends(axes: Any, start: NDArray[np.int32], goal: NDArray[np.int32]) -> None:
    axes.plot(start[1], start[0], "s", color="gold", markersize=6, label="start", **_ENDS)
    axes.plot(goal[1], goal[0], "*", color="red", markersize=11, label="goal", **_ENDS)


def _outline(axes: Any, patches: Sequence[Patch]) -> None:
    """Rectangles around what has changed."""
    from matplotlib.patches import Rectangle

    for row, col, patch in patches:
        rows, cols = patch.shape
        axes.add_patch(
            Rectangle((col - 0.5, row - 0.5), cols, rows, fill=False, edgecolor=_CHANGED, linewidth=1.3, zorder=4)
        )
