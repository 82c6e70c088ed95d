"""Draw the pictures of docs/concepts.md anew: `python docs/_site/concepts.py [FOLDER]`, by default
into docs/concepts; a quarter of a minute.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent / "examples"))
from drawing import TEXT, ends, line, panels, relief  # noqa: E402

from nnpp_edge.runtime import Planner, Traversability, traversability_cost  # noqa: E402
from nnpp_edge.runtime.arrays import in_blocks  # noqa: E402
from nnpp_edge.terrain.dem import Dem, sample_dem  # noqa: E402
from nnpp_edge.terrain.workloads import workload  # noqa: E402
from nnpp_edge.viz.palette import INK, PATH, REGION  # noqa: E402

START = (90, 60)
GOAL = (450, 470)
BAR_M = 2000.0
DEM = sample_dem("moon_highlands").rescaled(20.0)
LIMIT20 = workload("limit20")
FRAMES = 24
FOLDER = Path(sys.argv[1]) if sys.argv[1:] else DOCS / "concepts"


def save(figure: Figure, name: str) -> None:
    figure.savefig(FOLDER / f"{name}.webp", dpi=80, bbox_inches="tight", pad_inches=0.1)


def of_blocks(factor: int) -> Dem:
    """The ground of which each cell is the mean of so many."""
    side = DEM.cell_size_m * factor
    heights = in_blocks(DEM.elevation, factor).mean((1, 3))
    return replace(DEM, elevation=heights, cell_size_m=side, cell_width_m=side)


def cost() -> None:
    figure, axes = panels(1, 3, height=5.0)
    level = Traversability(slope_limit_deg=89.0, roughness_limit_m=1e6, step_limit_m=1e6)
    limits = {"heights": level, "cost, soft": Traversability(), "cost, limit20": LIMIT20}
    for panel, (name, each) in zip(axes, limits.items(), strict=True):
        relief(panel, DEM, name, BAR_M, each)
    save(figure, "cost")


def corridor() -> None:
    figure, axes = panels(1, 3, height=5.0)
    costs = traversability_cost(DEM.elevation, DEM.cell_size_m, warn=False)
    for panel, factor in zip(axes, (16, 4, 1), strict=True):
        first, last = (tuple(cell // factor for cell in end) for end in (START, GOAL))
        planner = Planner(in_blocks(costs, factor).mean((1, 3)))
        plan = planner.plan(first, last, method="astar")
        name = f"blocks of {factor} × {factor} cells" if factor > 1 else "cells"
        relief(panel, of_blocks(factor), name, BAR_M, Traversability().scaled(factor))
        line(panel, plan.path, "path")
        ends(panel, first, last)
    save(figure, "corridor")


def regions() -> None:
    figure, axes = panels(1, 2, width=5.2, height=6.0)
    planner = Planner.of_elevation(DEM.elevation, DEM.cell_size_m, LIMIT20, warn=False)
    for panel, method in zip(axes, ("corridor", "nnpp"), strict=True):
        plan = planner.plan(START, GOAL, method=method, keep_regions=True)
        inside = plan.region.mask()
        name = "corridor" if method == "corridor" else "learned region"
        relief(panel, DEM, f"{name}: {100.0 * inside.mean():.1f} % of the map", BAR_M, LIMIT20)
        shown = np.zeros((*inside.shape, 4))
        shown[inside] = [*(each / 255.0 for each in REGION[::-1]), 0.6]
        panel.imshow(shown)
        panel.fill([], [], color=REGION, alpha=0.6, label="region")
        panel.plot(*plan.path.T[::-1], color=PATH, linewidth=1.6, label="path")
        ends(panel, START, GOAL)
    words = {"fontsize": TEXT, "frameon": False, "ncols": 4}
    words["loc"] = "outside lower center"
    figure.legend(*axes[0].get_legend_handles_labels(), **words)
    save(figure, "regions")


def least_to_go(least: float) -> np.ndarray:
    """Least cost from each cell to the goal: octile distance over the cheapest ground."""
    down, across = np.abs(np.indices(DEM.shape) - np.reshape(GOAL, (2, 1, 1)))
    octile = np.maximum(down, across) + (2**0.5 - 1.0) * np.minimum(down, across)
    return octile * (1.0 + 2.0 * 2.805 * least)


def search() -> None:
    """Cells in the order of f = g + h, in which A* takes them."""
    costs = traversability_cost(DEM.elevation, DEM.cell_size_m, LIMIT20, warn=False)
    planner = Planner(costs)
    to_go = least_to_go(float(costs.min()))
    best = planner.plan(START, GOAL, method="astar").cost
    figure, axes = panels(1, 3, width=3.4, height=4.2)
    shown = []
    for panel, method in zip(axes, ("astar", "corridor", "nnpp"), strict=True):
        plan = planner.plan(START, GOAL, method=method, keep_regions=True)
        inside = np.ones(costs.shape, bool) if plan.region is None else plan.region.mask()
        f = Planner(np.where(inside, costs, np.float32(np.inf))).reach(START) + to_go
        f[f > plan.cost] = np.nan  # A* ends when it takes the goal
        share = 100.0 * np.isfinite(f).mean()
        gap = 100.0 * (plan.cost / best - 1.0)
        words = f"{method}: {share:.1f} % of the cells,\n{gap:.2f} % above the optimum"
        relief(panel, DEM, words, BAR_M, LIMIT20)
        panel.title.set_size(TEXT - 4)
        image = panel.imshow(np.full(costs.shape, np.nan), cmap="viridis", alpha=0.75)
        shown.append((image, panel, f, plan))
        ends(panel, START, GOAL)

    def draw(frame: int) -> None:
        for image, panel, f, plan in shown:
            until = np.nanquantile(f, (frame + 1) / FRAMES)
            data = np.where(f <= until, f, np.nan)
            image.set(data=data, clim=(np.nanmin(f), np.nanmax(f)))
            if frame == FRAMES - 1:
                line(panel, plan.path, "path")

    animation = FuncAnimation(figure, draw, FRAMES, init_func=lambda: None)
    writer = PillowWriter(fps=10)
    animation.save(FOLDER / "search.webp", writer, dpi=66)


def bounds() -> None:
    planner = Planner.of_elevation(DEM.elevation, DEM.cell_size_m, LIMIT20, warn=False)
    asked = {name: {"method": name} for name in ("astar", "corridor", "nnpp")}
    asked["corridor,\nepsilon 0.05"] = {"method": "corridor", "epsilon": 0.05}
    figure = Figure(figsize=(8.8, 4.2), layout="constrained")
    axes = figure.subplots()
    for row, words in enumerate(asked.values()):
        plan = planner.plan(START, GOAL, **words)
        axes.plot([plan.lower_bound, plan.cost], [row, row], color="0.6", linewidth=5.0)
        axes.plot(plan.lower_bound, row, "|", color=INK, markersize=22, markeredgewidth=4)
        axes.plot(plan.cost, row, "o", color=PATH, markersize=11)
        said = plan.optimality.replace(", ", ",\n").replace("to be at most", "≤")
        axes.annotate(said, (plan.cost, row), (12, 0), textcoords="offset points", va="center")
    for text in axes.texts:
        text.set_size(TEXT - 3)
    axes.set_yticks(range(len(asked)), list(asked))
    axes.invert_yaxis()
    axes.set_xlim(right=2300.0)
    axes.set_xlabel("cost of the path (dot), and what no path costs less than (bar)", size=TEXT - 3)
    axes.tick_params(labelsize=TEXT - 3)
    axes.spines[["top", "right"]].set_visible(False)
    save(figure, "bounds")


if __name__ == "__main__":
    for draw in (cost, corridor, regions, search, bounds):
        draw()
