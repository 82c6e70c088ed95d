"""The onboard loop as a ROS 2 node: its parameters, topics, services and life cycle."""

import typing

from nnpp_edge.runtime.errors import NnppEdgeError, one_line

Ros = typing.Any
"""A message, or an object of rclpy: types are checked where ROS is not installed."""


def in_a_line(error: Exception) -> str:
    """An error for people; of one that is not ours its type, too."""
    return str(error) if isinstance(error, NnppEdgeError) else one_line(error)
