"""Poses of messages in the frame that the loop plans in."""

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from nnpp_edge.runtime.loop.messages import InvalidMessageError

if TYPE_CHECKING:
    from rclpy.node import Node

_UNIT = 0.1
"""By how much a quaternion's length may differ from 1."""


class Place(NamedTuple):
    """A pose on the ground, in the frame that the loop plans in."""

    x: float
    y: float
    z: float
    yaw_rad: float


class Frames:
    """Takes poses to the global frame: by tf2 where `tf2_ros` is installed, else those alone that
    are in it.
    """

    def __init__(self, node: "Node", global_frame: str) -> None:
        self.global_frame = global_frame
        self._buffer: Any = None
        try:
            import tf2_ros
        except ImportError:
            return
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def close(self) -> None:
        """Listen to transforms no more."""
        if self._buffer is not None:
            self._listener.unregister()

    def place(self, pose: Any, frame_id: str, what: str) -> Place:
        """Of a geometry_msgs/Pose, called `what` in errors: InvalidMessageError for numbers that
        are not finite, no rotation, or a frame of which nothing is known.
        """
        place = _place(pose.position, pose.orientation, what)
        if frame_id == self.global_frame:
            return place
        wanted = f"wanted {what} in the frame {self.global_frame!r}, got one in {frame_id!r}"
        if self._buffer is None:
            raise InvalidMessageError(f"{wanted}, and tf2_ros is not installed")
        from rclpy.time import Time

        try:
            found = self._buffer.lookup_transform(self.global_frame, frame_id, Time()).transform
        except Exception as error:  # tf2 has several, of a C++ library
            raise InvalidMessageError(f"{wanted} ({' '.join(str(error).split())})") from None
        moved = _place(found.translation, found.rotation, "a transform")
        cos = math.cos(moved.yaw_rad)
        sin = math.sin(moved.yaw_rad)
        x = moved.x + cos * place.x - sin * place.y
        y = moved.y + sin * place.x + cos * place.y
        return Place(x, y, moved.z + place.z, moved.yaw_rad + place.yaw_rad)


def _place(at: Any, turn: Any, what: str) -> Place:
    """Of a point and a quaternion."""
    metres = (at.x, at.y, at.z)
    if not all(map(math.isfinite, metres)):
        raise InvalidMessageError(f"wanted {what} at finite metres, got {metres}")
    x, y, z, w = (turn.x, turn.y, turn.z, turn.w)
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _UNIT:
        raise InvalidMessageError(f"wanted {what} with a unit quaternion, got {(x, y, z, w)}")
    sin = 2.0 * (w * z + x * y)
    cos = 1.0 - 2.0 * (y * y + z * z)
    return Place(*metres, math.atan2(sin, cos))
