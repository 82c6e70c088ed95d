"""A path across a tiled GeoTIFF of 20,000 x 20,000 cells, in less than 2 GB.

The heights would take 1.6 GB, and a search of the whole map 16 GB more. Here they are read by windows: once to make
coarse levels, and once more under the corridor that these lead to. `nnpp-edge plan` does the same for a file that
is too large for memory.

Run time: 3 min, most of it to make the file (1.5 GB, left in the folder for another run); 4 s with --small (1,024 x
1,024).
Data: fractal ground, made here: one square of it, mirrored at its rims again and again, over long hills.
"""

import resource
import time
from pathlib import Path

from drawing import ends, large_ground, line, panels, run, save

from nnpp_edge.runtime.planners.windowed import WindowedPlanner
from nnpp_edge.terrain.dem import open_dem
from nnpp_edge.terrain.workloads import workload


def main(folder: Path, small: bool = False) -> Path:
    """Make the file unless it is there, plan from corner to corner, and draw the path on the coarse costs."""
    side = 1024 if small else 20_000
    cog = folder / f"ground-{side}.tif"
    if not cog.exists():
        large_ground(cog, side)
    start, goal = (side // 50, side // 50), (side - side // 50, side - side // 50)

    began = time.perf_counter()
    with open_dem(cog) as dem:
        planner = WindowedPlanner(dem, workload("limit20"))
        plan = planner.plan(start, goal)
        again = planner.read_again
    seconds, gigabytes = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-9

    size = f"{side:,} x {side:,} cells: {seconds:.1f} s, {gigabytes:.2f} GB"
    facts = f"{size}, {100 * again:.0f} % of the file read twice"
    print(f"{plan.status}: {len(plan.path)} cells, at most {100 * (plan.bound - 1):.0f} % above the optimum\n{facts}")
    factor, costs = planner.coarse_costs(600)
    figure, (axes,) = panels(1, width=6.0, height=6.0)
    axes.imshow(costs, cmap="gray", vmin=0, vmax=1)
    axes.set_title(facts, fontsize=9)
    axes.set_axis_off()
    line(axes, plan.path / factor)
    ends(axes, (start[0] // factor, start[1] // factor), (goal[0] // factor, goal[1] // factor))
    return save(figure, folder, "large_cog")


if __name__ == "__main__":
    run(main)
