"""Patches of the map under a robot that moves, answered by D* Lite and by A* afresh.

Every few steps an obstacle appears on the path just ahead. D* Lite mends what it knows instead of searching anew.
Both are exact, so their paths cost the same; what differs is how many cells they touch. That is not always to D*
Lite's favour: a change near the goal touches everything that was found from there.

Run time: 5 s.
Data: moon_highlands, LROC WAC GLD100, public domain (nnpp_edge/terrain/samples/README.md), with cells as if they
were 20 m.
"""

from pathlib import Path

import numpy as np
from drawing import ends, line, panels, relief, run, save

from nnpp_edge.runtime import DynamicPlanner, traversability_cost
from nnpp_edge.terrain.shipped import sample_dem
from nnpp_edge.terrain.workloads import workload

START, GOAL, PATCH = (90, 60), (450, 470), np.ones((9, 9), np.float32)  # a cost of 1 is impassable


def main(folder: Path, small: bool = False) -> Path:
    """Drive, put obstacles in the way, and count what each method expands."""
    dem = sample_dem("moon_highlands").rescaled(20.0)
    cost = traversability_cost(dem.elevation, dem.cell_size_m, workload("limit20"), warn=False)
    planner = DynamicPlanner(cost, GOAL, method="dstar", also=["astar"])
    robot, driven, expansions = START, [START], {"dstar": [], "astar": []}
    figure, (left, right) = panels(2, width=4.8)
    relief(left, dem, "driven, and the obstacles that appeared")
    for _ in range(4 if small else 40):
        planner.move(robot)
        plans = {method: planner.replan(method=method) for method in expansions}
        assert np.isclose(plans["dstar"].cost, plans["astar"].cost)
        for method, plan in plans.items():
            expansions[method].append(plan.expansions)
        path = plans["dstar"].path
        driven += [(int(row), int(col)) for row, col in path[1:13]]
        robot = driven[-1]
        if len(path) > 60:
            row, col = path[40] - 4
            planner.update(row, col, PATCH)
            left.fill([col, col + 9, col + 9, col], [row, row, row + 9, row + 9], color="firebrick")
    line(left, np.array(driven))
    ends(left, START, GOAL)
    for method, counts in expansions.items():
        right.semilogy(np.maximum(counts, 1), "o-", markersize=3, label=method)
    right.set(xlabel="answer", title="cells expanded for each answer")
    right.legend()
    print({method: f"{sum(counts)} cells expanded" for method, counts in expansions.items()})
    return save(figure, folder, "patches_and_dstar")


if __name__ == "__main__":
    run(main)
