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
        self._listener: Any = None
        try:
            import tf2_ros
        except ImportError:
            return
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def close(self) -> None:
        """Listen to transforms no more."""
        if self._listener is not None:
            self._listener.unregister()

    def place(self, pose: Any, frame_id: str, what: str) -> Place:
        """Of a geometry_msgs/Pose, called `what` in errors: InvalidMessageError for numbers that
        are not finite, no rotation, or a frame of which nothing is known.
        """
        place = place_of(pose, what)
        if frame_id == self.global_frame:
            return place
        wanted = f"wanted {what} in the frame {self.global_frame!r}, got one in {frame_id!r}"
        if self._buffer is None:
            raise InvalidMessageError(f"{wanted}, and tf2_ros is not installed")
        from rclpy.time import Time

        try:
            found = self._buffer.lookup_transform(self.global_frame, frame_id, Time())
        except Exception as error:  # tf2 has several, of a C++ library
            raise InvalidMessageError(f"{wanted} ({' '.join(str(error).split())})") from None
        turn = found.transform.rotation
        shift = found.transform.translation
        yaw = yaw_of(turn, f"the transform of {frame_id!r}")
        cos = math.cos(yaw)
        sin = math.sin(yaw)
        x = shift.x + cos * place.x - sin * place.y
        y = shift.y + sin * place.x + cos * place.y
        return Place(x, y, shift.z + place.z, yaw + place.yaw_rad)


def place_of(pose: Any, what: str) -> Place:
    """As `Frames.place`, in the frame that the pose is in."""
    at = pose.position
    if not all(math.isfinite(each) for each in (at.x, at.y, at.z)):
        raise InvalidMessageError(f"wanted {what} at finite metres, got {(at.x, at.y, at.z)}")
    return Place(at.x, at.y, at.z, yaw_of(pose.orientation, what))


def yaw_of(turn: Any, what: str) -> float:
    """The yaw of a quaternion, radians from x towards y."""
    parts = (turn.x, turn.y, turn.z, turn.w)
    length = math.hypot(*parts)
    if not abs(length - 1.0) <= _UNIT:
        raise InvalidMessageError(f"wanted {what} with a quaternion of length 1, got {parts}")
    x, y, z, w = parts
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
