"""The site's pictures: `make pictures` runs the examples, draws the concepts, and keeps small WebP files in docs/."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

DOCS = Path(__file__).parent.parent
EXAMPLES = DOCS.parent / "examples"
sys.path.insert(0, str(EXAMPLES))

from drawing import OUT, ends, line, panels, relief, save  # noqa: E402

from nnpp_edge.runtime import Planner, traversability_cost  # noqa: E402
from nnpp_edge.terrain.shipped import sample_dem  # noqa: E402
from nnpp_edge.terrain.workloads import workload  # noqa: E402

MOON = sample_dem("moon_highlands").rescaled(20.0)
SOFT, LIMIT20 = (
    traversability_cost(MOON.elevation, MOON.cell_size_m, workload(name), warn=False) for name in ("soft", "limit20")
)
START, GOAL = (90, 60), (450, 470)


def shrunk(picture: Path, target: Path, most_pixels: int = 1000) -> None:
    """Keep a picture, or each frame of a film, as WebP of at most so many pixels a side."""
    with Image.open(picture) as image:
        factor = min(1.0, most_pixels / max(image.size))
        size = (round(image.width * factor), round(image.height * factor))
        durations = [frame.info.get("duration", 0) for frame in ImageSequence.Iterator(image)]
        frames = [frame.convert("RGB").resize(size) for frame in ImageSequence.Iterator(image)]
    more = {"save_all": True, "append_images": frames[1:], "duration": durations, "loop": 0} if frames[1:] else {}
    frames[0].save(target, quality=55 if more else 78, method=6, **more)


def _cost() -> None:
    figure, axes = panels(3, width=3.6, height=3.9)
    relief(axes[0], MOON, "elevations")
    for panel, (name, cost) in zip(axes[1:], {"soft": SOFT, "limit20": LIMIT20}.items(), strict=True):
        panel.imshow(np.where(np.isfinite(cost), cost, np.nan), cmap="gray", vmin=0, vmax=1)
        panel.set(title=f"cost T, {name}", xticks=[], yticks=[], facecolor="#602c22")
    save(figure, OUT, "cost")


def _regions() -> None:
    """Where each method may search."""
    planner = Planner(LIMIT20)
    figure, axes = panels(2)
    for panel, (method, title) in zip(axes, {"corridor": "corridor", "nnpp": "learned region"}.items(), strict=True):
        plan = planner.plan(START, GOAL, method=method, keep_regions=True)
        assert plan.region is not None
        relief(panel, MOON, f"{title}: {plan.region.area() / LIMIT20.size:.1%} of the map")
        panel.imshow(np.where(plan.region.mask(), 1.0, np.nan), cmap="cool", vmin=1, vmax=3, alpha=0.9)
        panel.plot(plan.path[:, 1], plan.path[:, 0], color="tab:red", linewidth=1.0)
        ends(panel, START, GOAL)
    save(figure, OUT, "regions")


def _corridor() -> None:
    figure, axes = panels(3, width=3.6, height=3.9)
    for panel, factor in zip(axes, (16, 4, 1), strict=True):
        side = 512 // factor
        coarse = SOFT.reshape(side, factor, side, factor).mean((1, 3))
        ends_on_it = ((row // factor, col // factor) for row, col in (START, GOAL))
        plan = Planner(coarse).plan(*ends_on_it, method="astar")
        panel.imshow(coarse, cmap="gray", vmin=0, vmax=1)
        panel.set(title=f"blocks of {factor} x {factor} cells" if factor > 1 else "cells", xticks=[], yticks=[])
        line(panel, plan.path)
    save(figure, OUT, "corridor")


def _bounds() -> None:
    """Cost of each method's path, and below what no path can."""
    planner = Planner(LIMIT20)
    figure, (panel,) = panels(1, width=7.0, height=2.6)
    asked = {"astar": {}, "corridor": {}, "nnpp": {}, "corridor, epsilon 0.05": {"epsilon": 0.05}}
    for name, more in asked.items():
        plan = planner.plan(START, GOAL, method=name.split(",")[0], **more)
        panel.plot([plan.lower_bound, plan.cost], [name, name], "-", color="grey", linewidth=3)
        panel.plot(plan.lower_bound, name, "|", color="tab:blue", markersize=14, markeredgewidth=3)
        panel.plot(plan.cost, name, "o", color="tab:orange")
        panel.annotate(f"at most {plan.bound:.2f} times", (plan.cost, name), (8, -3), textcoords="offset points")
    panel.set(xlabel="cost: lower bound (bar) and path (dot)", xlim=(None, panel.get_xlim()[1] * 1.25))
    panel.margins(y=0.2)
    panel.invert_yaxis()
    save(figure, OUT, "bounds")


def main() -> None:
    """Draw all, or what is named."""
    names = sys.argv[1:]
    OUT.mkdir(exist_ok=True)
    for path in sorted(EXAMPLES.glob("*.py")):
        if path.stem != "drawing" and (not names or path.stem in names):
            shrunk(import_module(path.stem).main(OUT), DOCS / "gallery" / f"{path.stem}.webp")
    for draw in (_cost, _regions, _corridor, _bounds):
        name = draw.__name__.removeprefix("_")
        if not names or name in names:
            draw()
            shrunk(OUT / f"{name}.png", DOCS / "concepts" / f"{name}.webp")


if __name__ == "__main__":
    main()
