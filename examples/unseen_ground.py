"""A robot that knows the ground coarsely: three drives by three expectations of what it has not
seen.

The map has means of 8 × 8 cells. The robot sees 16 cells around itself, and plans anew after every
eighth: over cells where it has seen them, over blocks beyond. What it expects of a block decides
where it goes.

Run time: 8 s.
Data: moon_highlands, LROC WAC GLD100 (public domain).
"""

from dataclasses import replace

import numpy as np
from drawing import ends, line, panels, relief, save

from nnpp_edge.runtime import DynamicPlanner, Planner, Traversability
from nnpp_edge.terrain.dem import sample_dem

FACTOR = 8
SIGHT = 16
STRIDE = 8
NAMES = {"eq1": "cost of the means", "slope": "by the slope", "network": "by the network"}
START = (20, 30)
GOAL = (236, 214)
LIMITS = Traversability(slope_limit_deg=20.0, hard_slope_deg=20.0)
WHOLE = sample_dem("moon_highlands").rescaled(20.0)
TRUTH = replace(WHOLE, elevation=WHOLE.elevation[:256, :256])


def drive(prior: str) -> np.ndarray:
    """The cells that the robot walks over."""
    heights = TRUTH.elevation
    side = TRUTH.cell_size_m
    means = heights.reshape(32, FACTOR, 32, FACTOR).mean((1, 3))
    planner = DynamicPlanner.of_coarse(means, FACTOR * side, FACTOR, GOAL, LIMITS, prior=prior)
    driven = [START]
    while driven[-1] != GOAL:
        row, col = (max(cell - SIGHT, 0) for cell in driven[-1])
        seen = heights[row : driven[-1][0] + SIGHT + 1, col : driven[-1][1] + SIGHT + 1]
        planner.update_elevation(row, col, seen)
        planner.move(driven[-1])
        plan = planner.replan()
        driven += [
            (int(row), int(col)) for row, col in plan.path[1 : 1 + min(STRIDE, plan.known - 1)]
        ]
    return np.array(driven, np.int32)


figure, axes = panels(3)
whole = Planner.of_elevation(TRUTH.elevation, TRUTH.cell_size_m, LIMITS)
best = whole.plan(START, GOAL, method="astar")
for prior, panel in zip(NAMES, axes, strict=True):
    driven = drive(prior)
    excess = whole.state.grid.costs_of(driven)[0] / best.cost - 1.0
    relief(panel, TRUTH, f"{NAMES[prior]}: +{100.0 * excess:.1f} %", 1000, LIMITS)
    line(panel, best.path, "optimum, all known", "white")
    line(panel, driven, "driven")
    ends(panel, START, GOAL)
    print(f"{prior}: {100.0 * excess:.1f} % above the optimum with all known")
save(figure)
