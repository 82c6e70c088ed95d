"""A rover's elevation map moves along with it, and its goal lies beyond what it sees, behind rocks.

The loop's world is larger than the window and stays; it takes in what each grid_map message has seen. As long as no
known ground leads to the goal, the path leads to where the way over unknown ground promises to be shortest.

Run time: 5 s.
Data: moon_rocks, a crop of LROC WAC GLD100 (public domain), with rocks made by nnpp_edge/terrain/rocks.py.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from drawing import ends, line, panels, relief, run, save

from nnpp_edge.ros.maps import GridMap, MapFrame, grid_map_patch
from nnpp_edge.runtime import Goal, Ground, Loop, Navigator, NavigatorSettings, Pose
from nnpp_edge.terrain.shipped import sample_dem
from nnpp_edge.terrain.vehicle_files import load_vehicle

START, GOAL, SIGHT, CELLS_A_TICK, DRAWN = (60, 12), (60, 107), 18, 3, (1, 46, 72)
TRUTH, BODY = sample_dem("moon_rocks"), load_vehicle("large-rover")
FRAME = MapFrame(TRUTH.cell_size_m, x=90.0, y=90.0, rows_along_x=True, frame_id="odom")


class Rover:
    """The loop's source, of what it sees; and the answers' reader, who goes where they lead."""

    def __init__(self, navigator, axes):
        self.navigator, self.axes, self.driven = navigator, dict(zip(DRAWN, axes, strict=True)), [START]

    def poll(self):
        (row, col), corner = self.driven[-1], np.maximum(self.driven[-1], SIGHT) - SIGHT
        (top, left), (x, y) = corner, FRAME.metres(corner.astype(float))[0]
        window = {"elevation": TRUTH.elevation[top : row + SIGHT, left : col + SIGHT]}
        message = GridMap.of_layers(window, replace(FRAME, x=x, y=y), start=(3, 5))  # a ring begins anywhere
        return [grid_map_patch(message, FRAME), Pose(row + 0.5, col + 0.5), Goal(*GOAL)]

    def follow(self, answer):
        if (axes := self.axes.get(answer.tick)) is not None:
            relief(axes, replace(TRUTH, elevation=self.navigator.map.elevation()), f"tick {answer.tick}")
            line(axes, np.array(self.driven), color="white")
            line(axes, answer.path)
            ends(axes, self.driven[-1], GOAL)
        self.driven += [(int(row), int(col)) for row, col in answer.path[1 : 1 + CELLS_A_TICK]]


def main(folder: Path, small: bool = False) -> Path:
    """Drive, and draw what was known after some ticks."""
    figure, axes = panels(len(DRAWN))
    ground = Ground.of_elevation(np.full(TRUTH.shape, np.nan), TRUTH.cell_size_m, vehicle=BODY)
    rover = Rover(Navigator(ground, NavigatorSettings(approach=True)), axes)
    counters = Loop(rover.navigator, rover, paced=False, after_tick=rover.follow).run(DRAWN[-1])
    print(f"{len(rover.driven)} cells driven; a tick took {counters.tick_ms['p50']:.2f} ms, half of them less")
    return save(figure, folder, "moving_window")


if __name__ == "__main__":
    run(main)
