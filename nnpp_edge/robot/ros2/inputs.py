"""Topics that the node listens to, as inputs of the loop. The executor's thread converts them."""

import time
from collections.abc import Callable
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2 import Ros, in_a_line
from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.ros.maps import (
    GridMap,
    MapFrame,
    OccupancyGrid,
    cloud_patch,
    grid_map_patch,
    occupancy_patch,
)
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import InvalidMessageError, MapPatch

if TYPE_CHECKING:
    from rclpy.node import Node

    from nnpp_edge.robot.ros2.node import PlannerNode
    from nnpp_edge.robot.ros2.session import Session

_LOG_EVERY_S = 5.0
"""A line of each topic that is refused; all are counted."""
TOPICS = {
    "odom": "nav_msgs.msg:Odometry",
    "pose": "geometry_msgs.msg:PoseStamped",
    "goal_pose": "geometry_msgs.msg:PoseStamped",
    "map": "nav_msgs.msg:OccupancyGrid",
    "map_updates": "map_msgs.msg:OccupancyGridUpdate",
    "elevation_map": "grid_map_msgs.msg:GridMap",
    "elevation_points": "sensor_msgs.msg:PointCloud2",
}
_INSTEAD = {"map_updates": ", or send whole maps", "elevation_map": ", or send elevation_points"}


def message_type(node: "Node", topic: str, kind: str) -> Ros:
    """A message's class; None, and a warning, where its package is not installed."""
    try:
        return resolve_name(kind)
    except ImportError:
        package = kind.partition(".")[0]
        wanted = f"install ros-DISTRO-{package.replace('_', '-')}{_INSTEAD.get(topic, '')}"
        node.get_logger().warning(f"there is no {topic}, as {package} is missing: {wanted}")
        return None


class Listener:
    """Subscriptions of a node. Patches are handed to its session; pose and goal are kept for the
    session to take.
    """

    def __init__(self, node: "PlannerNode") -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self._node = node
        self._refused: dict[str, str] = {}
        """Why the newest message was refused, by topic; of those whose newest one was."""
        self._grid: OccupancyGrid | None = None
        """The newest whole one, which updates are parts of."""
        self.robot: PoseInFrame | None = None
        self.goal: PoseInFrame | None = None
        """The newest."""
        self._came = dict.fromkeys(("pose", "map"), time.monotonic())
        """When the newest one came."""
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        special = {"odom": newest, "pose": newest, "map": latched}
        self._subscriptions = []
        for topic, kind in TOPICS.items():
            if found := message_type(node, topic, kind):
                hear = partial(self._hear, topic)
                qos = special.get(topic, 10)
                self._subscriptions.append(node.create_subscription(found, topic, hear, qos))

    @property
    def refused(self) -> str:
        """Why the newest message of each topic was refused, where it was."""
        return "; ".join(map(": ".join, list(self._refused.items())))

    def overdue(self) -> str:
        """Which input is too old to go by; empty while none is."""
        for what, name in (("pose", "odom_timeout_s"), ("map", "map_timeout_s")):
            limit_s = self._node.get_parameter(name).value
            old_s = time.monotonic() - self._came[what]
            if limit_s and old_s > limit_s:
                return f"the newest {what} is {old_s:.1f} s old, allowed are {limit_s:g}"
        return ""

    def close(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _hear(self, topic: str, message: Ros) -> None:
        """Convert a message, or refuse it: whatever it holds, the session goes on."""
        try:
            getattr(self, f"_on_{topic}")(message)
        except Exception as error:
            self._refused[topic] = in_a_line(error)
            line = f"{topic} was refused: {self._refused[topic]}"
            self._node.get_logger().warning(line, throttle_duration_sec=_LOG_EVERY_S)
            if session := self._node.session:
                session.navigator.count_error("input")
            else:
                self._node.tell_idle()
        else:
            self._refused.pop(topic, None)

    def _on_odom(self, message: Ros) -> None:
        base = self._node.own.robot_base_frame
        child = message.child_frame_id
        if base and child not in ("", base):
            raise InvalidMessageError(f"wanted the robot's frame {base!r}, got {child!r}")
        self._on_place(message.pose.pose, message.header.frame_id)

    def _on_pose(self, message: Ros) -> None:
        self._on_place(message.pose, message.header.frame_id)

    def _on_place(self, pose: Ros, frame_id: str) -> None:
        self.robot = self._node.frames.place(pose, frame_id, "a pose")
        self._came["pose"] = time.monotonic()

    def _on_goal_pose(self, message: Ros) -> None:
        self.goal = self._node.frames.place(message.pose, message.header.frame_id, "a goal")

    def _on_map(self, message: Ros) -> None:
        grid = OccupancyGrid.of_message(message)
        wanted = self._node.own.global_frame
        if grid.frame.frame_id != wanted:
            got = grid.frame.frame_id
            raise InvalidMapError(f"wanted a map in the frame {wanted!r}, got one in {got!r}")
        session = self._node.session
        if self._node.own.by_topic and not (session and session.covers(grid)):
            came = time.monotonic()
            self._node.begin_on(grid)
            self._came["map"] = came
        else:
            self._put_grid(grid)
        self._grid = grid

    def _on_map_updates(self, message: Ros) -> None:
        if self._grid is None:
            raise InvalidMapError("wanted a whole map before a part of it, got none yet")
        whole = self._grid.frame
        side = whole.resolution
        corner = (whole.x + message.x * side, whole.y + message.y * side)
        part = MapFrame(side, *corner, frame_id=message.header.frame_id)
        shape = (message.height, message.width)
        values = np.asarray(message.data)
        if values.size != shape[0] * shape[1]:
            raise InvalidMapError(f"wanted {shape[0]} × {shape[1]} cells, got {values.size}")
        self._put_grid(OccupancyGrid(values.reshape(shape), part))

    def _put_grid(self, grid: OccupancyGrid) -> None:
        """Of a map that is all costs, what is unknown now is unknown; else it tells nothing."""
        keep_known = not self._node.own.by_topic
        self._put(lambda session: occupancy_patch(grid, session.frame, keep_known=keep_known))

    def _on_elevation_map(self, message: Ros) -> None:
        layer = self._node.own.layer
        grid = GridMap.of_message(message)
        self._put_heights(lambda session: grid_map_patch(grid, session.frame, layer))

    def _on_elevation_points(self, message: Ros) -> None:
        self._put_heights(
            lambda session: cloud_patch(message, session.frame, session.navigator.map.shape)
        )

    def _put_heights(self, patch_of: "Callable[[Session], MapPatch]") -> None:
        if self._node.own.by_topic:
            raise InvalidMapError("wanted map_size_m or map_file for elevations, got neither")
        self._put(patch_of)

    def _put(self, patch_of: "Callable[[Session], MapPatch]") -> None:
        session = self._node.session
        if session is None:
            raise InvalidMapError("there is no loop that could take a part of a map")
        session.put(patch_of(session))
        self._came["map"] = time.monotonic()
