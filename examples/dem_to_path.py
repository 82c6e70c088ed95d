"""From an elevation map to a path, on the Moon, on Mars and on Earth.

A planner is made of elevations and asked for a path that keeps off slopes steeper than 20 degrees. That is all
there is to it; what a step costs, and where not to go, follows from the elevations (NNPP, Eq. 1).

Run time: 5 s.
Data: three samples that travel with the package. Moon: LROC WAC GLD100, public domain. Mars: HiRISE terrain model
of Victoria crater, NASA/JPL/University of Arizona, public. Earth: airborne lidar, MIT licence. Details:
nnpp_edge/terrain/samples/README.md.
"""

from drawing import ends, line, panels, relief, save

from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.workloads import workload

QUERIES = {  # name of the map: start and goal, (row, col)
    "moon_highlands": ((90, 60), (450, 470)),
    "mars_victoria": ((240, 20), (128, 170)),
    "earth_hummocks": ((20, 20), (240, 150)),
}

figure, axes = panels(len(QUERIES))
for panel, (name, (start, goal)) in zip(axes, QUERIES.items(), strict=True):
    dem = sample_dem(name)
    if name.startswith("moon"):
        dem = dem.rescaled(20.0)  # cells of 118 m hide what a rover meets: as if they were 20 m, slopes kept

    planner = Planner.of_elevation(dem.elevation, dem.cell_size_m, workload("limit20"), warn=False)
    plan = planner.plan(start, goal)

    print(f"{name}: {plan.status}, {plan.ground_length_m:.0f} m, climbs {plan.climb_m:.0f} m, by {plan.planner}")
    relief(panel, dem, f"{name.replace('_', ' ')}\n{plan.ground_length_m:,.0f} m, {plan.climb_m:.0f} m up")
    line(panel, plan.path)
    ends(panel, start, goal)
save(figure)
