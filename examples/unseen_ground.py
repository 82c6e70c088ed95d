"""A robot that knows the ground coarsely: a drive by two expectations of what it has not seen.

The map has means of 8 × 8 cells. The robot sees 16 cells around itself, and plans anew after every
eighth. Of 24 random drives the picture shows the one whose costs above the optimum lie nearest to
the medians of all.

Run time: 10 s.
Data: moon_highlands, LROC WAC GLD100 (public domain).
"""

from dataclasses import replace

import numpy as np
from drawing import ends, line, panels, relief, save

from nnpp_edge.runtime import DynamicPlanner, Planner, Traversability, traversability_cost
from nnpp_edge.runtime.arrays import in_blocks
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.labels import random_query

FACTOR = 8
SIGHT = 16
NAMES = {"slope": "by the slope", "network": "by the network"}
LIMITS = Traversability(slope_limit_deg=20.0, hard_slope_deg=20.0)
TRUTH = sample_dem("moon_highlands").rescaled(20.0)
SIDE = TRUTH.cell_size_m
MEANS = in_blocks(TRUTH.elevation, FACTOR).mean((1, 3))


def drive(prior: str, start: tuple[int, int], goal: tuple[int, int]) -> np.ndarray:
    """The cells that the robot walks over."""
    planner = DynamicPlanner.of_coarse(MEANS, FACTOR * SIDE, FACTOR, goal, LIMITS, prior=prior)
    driven = [start]
    while driven[-1] != goal:
        row, col = (max(cell - SIGHT, 0) for cell in driven[-1])
        seen = TRUTH.elevation[row : driven[-1][0] + SIGHT + 1, col : driven[-1][1] + SIGHT + 1]
        planner.update_elevation(row, col, seen)
        planner.move(driven[-1])
        plan = planner.replan()
        driven += map(tuple, plan.path[1 : min(9, plan.known)].tolist())
    return np.array(driven, np.int32)


whole = Planner.of_elevation(TRUTH.elevation, SIDE, LIMITS)
rng = np.random.default_rng(1)
cost = traversability_cost(TRUTH.elevation, SIDE, LIMITS)
queries = [random_query(rng, cost, 0.6 * len(cost)) for _ in range(24)]
best = [whole.plan(*query, method="astar") for query in queries]
ways = [[drive(prior, *query) for prior in NAMES] for query in queries]
driven = [[whole.state.grid.costs_of(way)[0] for way in each] for each in ways]
excess = 100.0 * (driven / np.array([[plan.cost] for plan in best]) - 1.0)
median = np.median(excess, 0)
shown = int(np.abs(excess - median).sum(1).argmin())

figure, (first, *axes) = panels(1, 3, height=4.2)
coarse = replace(TRUTH, elevation=MEANS, cell_size_m=FACTOR * SIDE, cell_width_m=FACTOR * SIDE)
relief(first, coarse, "known: means of 8 × 8 cells", 2000)
ends(first, *np.array(queries[shown]) / FACTOR)
rows = np.concatenate(ways[shown])[:, 0]
first.set_ylim(min(rows.max() + 60, len(cost)) / FACTOR, max(rows.min() - 30, 0) / FACTOR)
for k, (panel, name) in enumerate(zip(axes, NAMES.values(), strict=True)):
    words = f"{name}: +{excess[shown, k]:.1f} % (median {median[k]:.1f})"
    print(words)
    relief(panel, TRUTH, words, 2000, LIMITS)
    line(panel, best[shown].path, "optimum, all known", "white")
    line(panel, ways[shown][k], "driven")
    ends(panel, *queries[shown])
    panel.set_ylim(np.multiply(first.get_ylim(), FACTOR))
save(figure)
