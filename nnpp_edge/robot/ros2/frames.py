"""Poses of messages in the frame that the loop plans in."""

import math
from typing import TYPE_CHECKING, NamedTuple

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.runtime.errors import one_line
from nnpp_edge.runtime.loop.messages import InvalidMessageError

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.node import PlannerNode

_UNIT = 0.1
"""By how much a quaternion's length may differ from 1."""


class PoseInFrame(NamedTuple):
    """A pose on the ground, in the frame that the loop plans in."""

    x: float
    y: float
    yaw_rad: float


class Frames:
    """Takes poses to the global frame: by tf2 where it is installed, else only those in it."""

    def __init__(self, node: "PlannerNode") -> None:
        self._node = node
        self._buffer: Ros = None
        try:
            import tf2_geometry_msgs
            import tf2_ros
        except ImportError:
            return
        self._transformed = tf2_geometry_msgs.do_transform_pose
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def place(self, pose: Ros, frame_id: str, what: str) -> PoseInFrame:
        """Of a geometry_msgs/Pose, called `what` in errors: InvalidMessageError for numbers that
        are not finite, no rotation, or a frame of which nothing is known.
        """
        own = self._node.own.global_frame
        if frame_id == own:
            return _place(pose, what)
        wanted = f"wanted {what} in the frame {own!r}, got one in {frame_id!r}"
        if self._buffer is None:
            raise InvalidMessageError(f"{wanted}, and tf2_ros is not installed")
        from rclpy.time import Time

        try:
            transform = self._buffer.lookup_transform(own, frame_id, Time())
        except Exception as error:  # tf2 has several, of a C++ library
            raise InvalidMessageError(f"{wanted} ({one_line(error)})") from None
        return _place(self._transformed(pose, transform), what)


def _place(pose: Ros, what: str) -> PoseInFrame:
    at = pose.position
    turn = pose.orientation
    if not math.isfinite(at.x + at.y):
        raise InvalidMessageError(f"wanted {what} at finite metres, got {(at.x, at.y)}")
    x, y, z, w = (turn.x, turn.y, turn.z, turn.w)
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _UNIT:
        raise InvalidMessageError(f"wanted {what} with a unit quaternion, got {(x, y, z, w)}")
    sin = 2.0 * (w * z + x * y)
    cos = 1.0 - 2.0 * (y * y + z * z)
    return PoseInFrame(at.x, at.y, math.atan2(sin, cos))
