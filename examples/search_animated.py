"""A search at work: exact A*, the corridor, and the learned region, each cell shown when its turn comes.

A* takes cells in the order of f = g + h, what it took to get there and what it must take at least from there to the
goal. The two others do the same inside a region: around a coarse path, or where a network says that the path runs.
What they leave out is the time that they save.

Run time: 20 s.
Data: moon_highlands, LROC WAC GLD100, public domain; details: nnpp_edge/terrain/samples/README.md.
"""

from pathlib import Path

import numpy as np
from drawing import ends, line, panels, relief, run
from matplotlib.animation import FuncAnimation, PillowWriter

from nnpp_edge.runtime import Planner, traversability_cost
from nnpp_edge.terrain.shipped import sample_dem

START, GOAL = (90, 60), (450, 470)


def at_least(shape: tuple[int, int], least: float) -> np.ndarray:
    """Least cost of a path from each cell to the goal: octile distance over the cheapest ground."""
    rows, cols = np.abs(np.indices(shape) - np.reshape(GOAL, (2, 1, 1)))
    return (np.maximum(rows, cols) + (2**0.5 - 1) * np.minimum(rows, cols)) * (1 + 2 * 255 * 0.011 * least)


def main(folder: Path, small: bool = False) -> Path:
    """Animate the three searches side by side."""
    dem, frames = sample_dem("moon_highlands").rescaled(20.0), 4 if small else 30
    cost = traversability_cost(dem.elevation, dem.cell_size_m, warn=False)
    planner, h = Planner(cost), at_least(cost.shape, float(cost.min()))
    optimum = planner.plan(START, GOAL, method="astar").cost
    shown, (figure, axes) = [], panels(3, width=3.2, height=3.7)
    for panel, method in zip(axes, ("astar", "corridor", "nnpp"), strict=True):
        plan = planner.plan(START, GOAL, method=method, keep_regions=True)
        inside = np.ones(cost.shape, bool) if plan.region is None else plan.region.mask()
        f = Planner(np.where(inside, cost, np.inf)).reach(START) + h
        share, gap = plan.expansions / cost.size, plan.cost / optimum - 1
        relief(panel, dem, f"{method}: {share:.1%} of the cells expanded,\n{gap:.2%} above the optimum")
        f[f > plan.cost] = np.nan  # A* ends when it takes the goal
        shown.append((panel.imshow(np.full(cost.shape, np.nan), cmap="viridis", alpha=0.6), panel, f, plan))
        ends(panel, START, GOAL)

    def draw(frame: int) -> None:
        for image, panel, f, plan in shown:
            until = np.nanquantile(f, (frame + 1) / frames)
            image.set(data=np.where(f <= until, f, np.nan), clim=(np.nanmin(f), np.nanmax(f)))
            if frame == frames - 1:
                line(panel, plan.path)

    picture = folder / "search_animated.gif"
    FuncAnimation(figure, draw, frames).save(picture, PillowWriter(fps=10), dpi=70)
    return picture


if __name__ == "__main__":
    run(main)
