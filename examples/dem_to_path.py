"""From an elevation map to a path, on the Moon, on Mars and on Earth.

A planner is made of elevations, and its paths avoid slopes steeper than 20 degrees. The cost of a
step, and where the ground is impassable, follow from the elevations (NNPP, Eq. 1).

Run time: 5 s.
Data: the four samples that travel with the package. Moon: LROC WAC GLD100, public domain, once with
rocks made by nnpp_edge/terrain/rocks.py. Mars: HiRISE terrain model of Victoria crater,
NASA/JPL/University of Arizona, public. Earth: airborne lidar, MIT licence. Details:
nnpp_edge/terrain/samples/README.md.
"""

from drawing import ends, line, panels, relief, save

from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.facts import metres
from nnpp_edge.terrain.workloads import workload

QUERIES = {  # name of the map: start and goal, (row, col), and metres of the scale bar
    "moon_highlands": ((90, 60), (450, 470), 10_000),
    "mars_victoria": ((240, 20), (128, 170), 50),
    "earth_hummocks": ((20, 20), (240, 150), 50),
    "moon_rocks": ((60, 6), (60, 113), 20),
}

figure, axes = panels(2, 2)
for panel, (name, (start, goal, bar_m)) in zip(axes, QUERIES.items(), strict=True):
    dem = sample_dem(name)
    planner = Planner.of_elevation(dem.elevation, dem.cell_size_m, workload("limit20"), warn=False)
    plan = planner.plan(start, goal)

    print(
        f"{name}: {plan.status}, {plan.ground_length_m:.0f} m, climbs {plan.climb_m:.0f} m, by "
        f"{plan.planner}"
    )
    relief(
        panel,
        dem,
        f"{name.replace('_', ' ')}\n{metres(plan.ground_length_m)}, {plan.climb_m:.0f} m up",
        bar_m,
        workload("limit20"),
    )
    line(panel, plan.path, "path")
    ends(panel, start, goal)
save(figure)
