"""A rover with a body among rocks, searched everywhere and coarse to fine.

Every pose on the path is checked: pitch, roll, the step under each wheel, the clearance below the
belly. Before its poses have been checked the cost of a block of cells for such a body is unknown,
so the corridor starts from the paper's cost. Both paths pass the same checks.

Run time: 5 s.
Data: moon_rocks, a crop of LROC WAC GLD100 (public domain) with rocks made by
nnpp_edge/terrain/rocks.py on a tenth of it.
"""

from dataclasses import replace

from drawing import ends, line, panels, relief, save

from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.vehicle_files import load_vehicle
from nnpp_edge.viz.picture import body_outlines

START = (60, 9)
GOAL = (60, 113)

dem = sample_dem("moon_rocks")
rover = replace(load_vehicle("large-rover"), clearance_m=0.4, max_step_m=0.3)
point = Planner.of_elevation(dem.elevation, dem.cell_size_m, warn=False).plan(
    START, GOAL, method="astar"
)
figure, (panel,) = panels(1, 1, width=8.8, height=5.6)
plans = {  # each by a planner that has checked no pose yet
    method: Planner.of_elevation(dem.elevation, dem.cell_size_m, vehicle=rover).plan(
        START, GOAL, method=method
    )
    for method in ("corridor", "astar")
}
words = "\n".join(
    f"{name}: {plan.checks:,} poses checked, cost {plan.cost:.1f}" for name, plan in plans.items()
)
print(words)
relief(panel, dem, words, 10)
line(panel, point.path, "path of a point", "white")
line(panel, plans["astar"].path, "path of the rover")
for outline in body_outlines(plans["astar"].path, rover, (dem.cell_size_m, dem.cell_width_m)):
    panel.plot(outline[:, 1], outline[:, 0], color="black", linewidth=1.6)
ends(panel, START, GOAL)
panel.set_ylim(84, 36)
save(figure)
