"""From a grid_map_msgs/GridMap to a path in metres, without ROS.

A GridMap holds its layers column by column, in a ring, with rows that run against x. `GridMap` takes the message's
fields as they are; `frame` turns metres into cells and back. In a node, the fields come from a subscriber, and the
poses go into a nav_msgs/Path.

Run time: 5 s.
Data: earth_hummocks, airborne lidar with cells of 1 m, MIT licence (nnpp_edge/terrain/samples/README.md).
"""

from pathlib import Path

import numpy as np
from drawing import panels, run, save

from nnpp_edge.ros.maps import GridMap, MapFrame, path_poses
from nnpp_edge.runtime import Planner
from nnpp_edge.terrain.shipped import sample_dem
from nnpp_edge.terrain.workloads import workload
from nnpp_edge.viz.picture import hillshade


def message() -> GridMap:
    """What a robot's mapping would publish: its start in the ring is somewhere in the middle."""
    dem = sample_dem("earth_hummocks")
    frame = MapFrame(dem.cell_size_m, x=128.0, y=128.0, rows_along_x=True)
    return GridMap.of_layers({"elevation": dem.elevation}, frame, start=(100, 31))


def main(folder: Path, small: bool = False) -> Path:
    """Plan from the robot's place to a goal, both in metres."""
    grid = message()
    elevation, frame = grid.layer("elevation"), grid.frame
    planner = Planner.of_elevation(elevation, grid.resolution, workload("limit20"), warn=False)
    start, goal = frame.cell(108.0, 108.0), frame.cell(-112.0, -22.0)

    plan = planner.plan(start, goal, refine="any-angle")
    poses = path_poses(plan.path, frame)  # x, y, heading: of every cell, as nav_msgs/Path wants them
    way_points = frame.metres(plan.waypoints + 0.5)  # places, of the path freed from the grid

    print(
        f"{plan.status}: {len(poses)} poses, {len(way_points)} way points; the second pose is {np.round(poses[1], 2)}"
    )
    figure, (axes,) = panels(1, width=5.6, height=5.2)
    extent = (frame.y, frame.y - grid.length_y, frame.x - grid.length_x, frame.x)
    axes.imshow(hillshade(elevation, grid.resolution), cmap="gray", extent=extent)
    axes.plot(poses[:, 1], poses[:, 0], color="black", linewidth=1, label="poses of the cells")
    axes.plot(way_points[:, 1], way_points[:, 0], "o-", color="tab:orange", markersize=3, label="way points")
    axes.set(xlabel="y, m", ylabel="x, m", title="A GridMap, x up and y to the left")
    axes.legend()
    return save(figure, folder, "grid_map_to_path")


if __name__ == "__main__":
    run(main)
