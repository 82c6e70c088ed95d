"""Two ends under four ideas of what a step costs, and how far a walker and a robot get.

Shortest: length alone. Tobler: a hiker's seconds, by the slope up or down. Energy: a rover's joules. 20 degrees: the
paper's traversability cost, with a hard limit on the slope. `reach` gives the cost of the cheapest path to every
cell in the same unit; uphill and downhill differ, so the way out and the way back do, too.

Run time: 5 s.
Data: earth_hummocks, airborne lidar with cells of 1 m, MIT licence (nnpp_edge/terrain/samples/README.md).
"""

from pathlib import Path

import numpy as np
from drawing import ends, line, panels, relief, run, save

from nnpp_edge.runtime import EnergyCost, Mobility, Planner
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.workloads import workload

START, GOAL = (200, 15), (30, 240)
ROVER = Mobility(energy=EnergyCost(mass_kg=40.0, rolling_resistance=0.1, efficiency=0.6))


def main(folder: Path, small: bool = False) -> Path:
    """Plan by each cost and draw the paths on one map; then lines of equal time and of equal energy."""
    dem = sample_dem("earth_hummocks")
    ground = {"dem": dem.elevation, "cell_size_m": dem.cell_size_m, "warn": False, "mobility": ROVER}
    planners = {
        "shortest": Planner.of_elevation(**ground, omega=0.0),
        "Tobler": Planner.of_elevation(**ground, step_cost="tobler"),
        "energy": Planner.of_elevation(**ground, step_cost="energy"),
        "20 degrees": Planner.of_elevation(**ground, traversability=workload("limit20")),
    }
    figure, (paths, *fields) = panels(3, width=4.6, height=5.2)
    relief(paths, dem, "Four costs, one start, one goal")
    for at, (name, planner) in enumerate(planners.items()):
        plan = planner.plan(START, GOAL, method="astar")
        facts = f"{plan.ground_length_m:.0f} m, {plan.climb_m:.0f} m up, {plan.energy_j / 1000:.1f} kJ"
        print(f"{name:<12}{plan.status}: {facts}")
        line(paths, plan.path, f"C{at}", f"{name}: {facts}")
    ends(paths, START, GOAL)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    reached = {"minutes on foot (Tobler)": planners["Tobler"].reach(START) / 60}
    reached["kJ of a 40 kg robot, up to 12"] = planners["energy"].reach(START, within=12_000.0) / 1000
    for panel, (title, cost) in zip(fields, reached.items(), strict=True):
        relief(panel, dem, title)
        shown = np.where(np.isfinite(cost), cost, np.nan)
        panel.imshow(shown, cmap="viridis_r", alpha=0.45)
        panel.clabel(panel.contour(shown, levels=6, colors="black", linewidths=0.8), fontsize=8)
    return save(figure, folder, "step_costs")


if __name__ == "__main__":
    run(main)
