"""A rover with a body among rocks, searched everywhere and coarse to fine.

Every pose on the path is checked: pitch, roll, the step under each wheel, the clearance below the belly. What a
block of cells costs such a body is not known before its poses have been checked, so the corridor goes by the paper's
cost first, and corrects where no pose passes. Both paths pass the same checks.

Run time: 5 s.
Data: moon_rocks, a crop of LROC WAC GLD100 (public domain) with rocks made by nnpp_edge/terrain/rocks.py on a tenth
of it.
"""

from drawing import ends, panels, relief, save

from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.vehicle_files import load_vehicle
from nnpp_edge.viz.picture import body_outlines

START, GOAL = (60, 6), (60, 113)

dem, rover = sample_dem("moon_rocks"), load_vehicle("large-rover")
point = Planner.of_elevation(dem.elevation, dem.cell_size_m, warn=False).plan(START, GOAL, method="astar")
exact = Planner.of_elevation(dem.elevation, dem.cell_size_m, vehicle=rover).plan(START, GOAL, method="astar")
ways = {"every pose that A* meets": "astar", "corridor": "corridor"}
figure, axes = panels(len(ways), width=5.0, height=2.9)
for panel, (name, method) in zip(axes, ways.items(), strict=True):
    planner = Planner.of_elevation(dem.elevation, dem.cell_size_m, vehicle=rover)  # has checked no pose yet
    plan = planner.plan(START, GOAL, method=method)
    gap = 100 * (plan.cost / exact.cost - 1)
    print(f"{name:<28}{plan.status}: {plan.checks} poses checked, {gap:.2f} % above the optimum")
    relief(panel, dem, f"{name}\n{plan.checks:,} poses checked, +{gap:.2f} %")
    panel.plot(*point.path.T[::-1], "--", color="white", linewidth=1.2)  # nothing that it can follow
    panel.plot(*plan.path.T[::-1], color="tab:orange", linewidth=1.2)
    for outline in body_outlines(plan.path, rover, (dem.cell_size_m, dem.cell_width_m)):
        panel.plot(outline[:, 1], outline[:, 0], color="lime", linewidth=1.0)
    ends(panel, START, GOAL)
    panel.set_ylim(84, 28)
save(figure)
