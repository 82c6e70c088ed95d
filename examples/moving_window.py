"""grid_map messages without ROS: a rover's window of the map moves along with it, its goal lies
beyond it.

Until known ground leads to the goal, the path leads to where the rest of the way may be shortest.

Run time: 5 s.
Data: moon_rocks, LROC WAC GLD100 (public domain) with rocks made by nnpp_edge/terrain/rocks.py.
"""

from dataclasses import replace

import numpy as np
from drawing import ends, line, panels, relief, save

from nnpp_edge.ros.maps import GridMap, MapFrame, grid_map_patch, path_poses
from nnpp_edge.runtime import Goal, Ground, Loop, Navigator, Pose
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.vehicle_files import load_vehicle

START = (60, 12)
GOAL = (60, 107)
SIGHT = 18
DRAWN = (1, 10, 19, 28)
TRUTH = sample_dem("moon_rocks")
FRAME = MapFrame(TRUTH.cell_size_m, x=90.0, y=90.0, rows_along_x=True, frame_id="odom")


class Rover:
    """The loop's source, of what it sees; and the answers' reader, who goes where they lead."""

    def __init__(self, navigator, axes):
        self.navigator = navigator
        self.axes = dict(zip(DRAWN, axes, strict=True))
        self.driven = [START]

    def poll(self):
        (row, col), (top, left) = self.driven[-1], np.maximum(self.driven[-1], SIGHT) - SIGHT
        x, y = FRAME.metres(np.array([top, left], float))[0]
        window = {"elevation": TRUTH.elevation[top : row + SIGHT, left : col + SIGHT]}
        seen = GridMap(window, replace(FRAME, x=x, y=y))  # of a message: GridMap.of_message
        return [grid_map_patch(seen, FRAME), Pose(row + 0.5, col + 0.5), Goal(*GOAL)]

    def follow(self, answer):
        if (axes := self.axes.get(answer.tick)) is not None:
            relief(
                axes,
                replace(TRUTH, elevation=self.navigator.map.elevation()),
                f"tick {answer.tick}",
                20,
            )
            line(axes, np.array(self.driven), "driven", "white")
            line(axes, answer.path, "path")
            ends(axes, self.driven[-1], GOAL, "robot")
            axes.set_ylim(100, 20)
        self.driven += [(int(row), int(col)) for row, col in answer.path[1:4]]


figure, axes = panels(2, 2, height=3.5)
body = load_vehicle("large-rover")
ground = Ground.of_elevation(np.full(TRUTH.shape, np.nan), TRUTH.cell_size_m, vehicle=body)
rover = Rover(Navigator(ground, approach=True), axes)
counters = Loop(rover.navigator, rover, paced=False, after_tick=rover.follow).run(DRAWN[-1])
pose = path_poses(np.array(rover.driven), FRAME)[-1]  # x, y, heading, as nav_msgs/Path wants them
print(
    f"driven to {np.round(pose, 2)}; a tick took {counters.tick_ms['p50']:.2f} ms, half of them "
    "less"
)
save(figure)
