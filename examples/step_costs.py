"""The same two ends under four ideas of what a step costs.

Shortest: length alone. Tobler: a hiker's seconds, by the slope up or down. Energy: a rover's joules. 20 degrees:
the paper's traversability cost, with a hard limit on the slope. The legend says what each path comes to by the
other measures.

Run time: 5 s.
Data: earth_hummocks, airborne lidar with cells of 1 m, MIT licence (nnpp_edge/terrain/samples/README.md).
"""

from pathlib import Path

from drawing import ends, line, panels, relief, run, save

from nnpp_edge.runtime import EnergyCost, Mobility, Planner
from nnpp_edge.terrain.shipped import sample_dem
from nnpp_edge.terrain.workloads import workload

START, GOAL = (200, 15), (30, 240)
ROVER = Mobility(energy=EnergyCost(mass_kg=40.0, rolling_resistance=0.1, efficiency=0.6))


def main(folder: Path, small: bool = False) -> Path:
    """Plan by each cost and draw the paths on one map."""
    dem = sample_dem("earth_hummocks")
    ground = {"dem": dem.elevation, "cell_size_m": dem.cell_size_m, "warn": False, "mobility": ROVER}
    planners = {
        "shortest": Planner.of_elevation(**ground, omega=0.0),
        "Tobler": Planner.of_elevation(**ground, step_cost="tobler"),
        "energy": Planner.of_elevation(**ground, step_cost="energy"),
        "20 degrees": Planner.of_elevation(**ground, traversability=workload("limit20")),
    }
    figure, (axes,) = panels(1, width=8.0, height=5.4)
    relief(axes, dem, "Four costs, one start, one goal")
    for at, (name, planner) in enumerate(planners.items()):
        plan = planner.plan(START, GOAL, method="astar")
        facts = f"{plan.ground_length_m:.0f} m, {plan.climb_m:.0f} m up, {plan.energy_j / 1000:.1f} kJ"
        print(f"{name:<12}{plan.status}: {facts}")
        line(axes, plan.path, f"C{at}", f"{name}\n{facts}")
    ends(axes, START, GOAL)
    figure.legend(loc="outside right center", fontsize=9, frameon=False)
    return save(figure, folder, "step_costs")


if __name__ == "__main__":
    run(main)
