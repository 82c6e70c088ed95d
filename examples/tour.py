"""A tour of five places in the cheapest order, freed from the grid, with the heights along it.

`plan_via` leads by way of other cells: in the order given, or in the one that costs least. Each leg is a plan of
its own. Freed from the grid, the path runs straight where the ground allows it instead of in steps of 45 degrees.

Run time: 5 s.
Data: moon_highlands, LROC WAC GLD100, public domain (nnpp_edge/terrain/samples/README.md), with cells as if they
were 20 m.
"""

from pathlib import Path

from drawing import ends, line, panels, relief, run, save

from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.shipped import sample_dem
from nnpp_edge.terrain.workloads import workload

START, GOAL = (90, 60), (450, 470)
PLACES = [(330, 250), (60, 300), (420, 120), (250, 330), (180, 470)]


def main(folder: Path, small: bool = False) -> Path:
    """Plan the tour and draw it above its profile."""
    dem = sample_dem("moon_highlands").rescaled(20.0)
    planner = Planner.of_elevation(dem.elevation, dem.cell_size_m, workload("limit20"), warn=False)
    tour = planner.plan_via(START, GOAL, PLACES, best_order=True, method="astar", refine="any-angle")
    plan = tour.plan

    print(f"{plan.status}: visits {', '.join(str(stop) for stop in tour.stops)}")
    print(f"costs {plan.cost:.0f}, and in the order given {tour.given_cost:.0f}")
    figure, (left, right) = panels(2, width=4.6)
    relief(left, dem, "five places, in the cheapest order")
    line(left, plan.line)
    for number, (row, col) in enumerate(tour.stops[1:-1], 1):
        left.text(col, row, str(number), ha="center", va="center", bbox={"boxstyle": "circle", "fc": "white"}, size=8)
    ends(left, START, GOAL)
    along = plan.along
    right.fill_between(along.distance_m / 1000, along.heights_m, along.heights_m.min() - 20, color="lightgrey")
    right.plot(along.distance_m / 1000, along.heights_m, color="tab:orange")
    right.set(xlabel="km", ylabel="m", title=f"{plan.ground_length_m / 1000:.1f} km, {plan.climb_m:.0f} m up")
    return save(figure, folder, "tour")


if __name__ == "__main__":
    run(main)
