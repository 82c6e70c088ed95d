"""``ros2 run nnpp_edge_ros nnpp_edge``: what `nnpp-edge ros` runs."""

import sys

from nnpp_edge.robot.ros2.node import run


def main():
    sys.exit(run(sys.argv[1:]))
