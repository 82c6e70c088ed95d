"""The onboard loop as a ROS 2 node: its parameters, topics, services and life cycle."""

import typing

Ros = typing.Any
"""A message, or an object of rclpy: types are checked where ROS is not installed."""
