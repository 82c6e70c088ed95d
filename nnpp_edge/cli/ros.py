"""`nnpp-edge ros`: the onboard loop as a ROS 2 node."""

import sys
from typing import Annotated

import click

from nnpp_edge.cli import options

_ARGUMENTS = {"nargs": -1, "type": click.UNPROCESSED}


@options.command("ros", context_settings={"ignore_unknown_options": True})
def command(
    arguments: Annotated[tuple[str, ...], _ARGUMENTS] = (),
    /,
    *,
    ros_args: Annotated[
        bool,
        (
            "What follows are ROS' arguments: -p NAME:=VALUE, --params-file FILE, -r FROM:=TO; "
            "docs/ros2.md has topics and parameters."
        ),
    ] = False,
) -> None:
    """Plan at a fixed rate as a ROS 2 node: maps, odometry and goals in, paths out.

    SIGTERM ends it after a tick with exit code 0.

    \b
    nnpp-edge ros
    nnpp-edge ros --ros-args -p vehicle:=rover.toml -p map_size_m:=60.0 -p global_frame:=odom
    """
    from nnpp_edge.robot.ros2.node import run

    sys.exit(run(["--ros-args", *arguments]))
