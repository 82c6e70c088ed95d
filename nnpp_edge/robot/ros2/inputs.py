"""Topics that the node listens to, as inputs of the loop. The executor's thread converts them."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.ros.maps import GridMap, MapFrame, OccupancyGrid, grid_map_patch, occupancy_patch
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Goal, Input, InvalidMessageError, MapPatch, Pose
from nnpp_edge.runtime.loop.navigator import Navigator

if TYPE_CHECKING:
    from rclpy.node import Node

    from nnpp_edge.robot.ros2.node import PlannerNode

_LOG_EVERY_S = 5.0
"""A line of each topic that is refused; all are counted."""
TOPICS = {
    "odom": "nav_msgs.msg:Odometry",
    "pose": "geometry_msgs.msg:PoseStamped",
    "goal_pose": "geometry_msgs.msg:PoseStamped",
    "map": "nav_msgs.msg:OccupancyGrid",
    "map_updates": "map_msgs.msg:OccupancyGridUpdate",
    "elevation_map": "grid_map_msgs.msg:GridMap",
}


def message_type(node: "Node", topic: str, kind: str) -> Ros:
    """A message's class; None, and a line in the log, where its package is not installed."""
    try:
        return resolve_name(kind)
    except ImportError:
        node.get_logger().info(f"no {topic}, as {kind.partition('.')[0]} is not installed")
        return None


class RosSource:
    """Subscriptions of a node, and the inputs of the loop that came by them.

    `on_grid` is called with an occupancy grid that is a new map rather than a part of the loop's.
    Until `begin` says on which map the loop runs, the newest pose and goal wait.
    """

    def __init__(self, node: "PlannerNode", on_grid: Callable[[OccupancyGrid], None]) -> None:
        self._node = node
        self._on_grid = on_grid
        self.refused: dict[str, str] = {}
        """Why the newest message was refused, by topic; of those whose newest one was."""
        self._mailbox = Mailbox()
        self._navigator: Navigator | None = None
        self.frame: MapFrame | None = None
        """Where the cells of the loop's map lie; None until there is one."""
        self._by_topic = False
        self._grid: OccupancyGrid | None = None
        """The newest whole one, which updates are parts of."""
        self.robot: Place | None = None
        self.goal: Place | None = None
        """The newest."""
        self._came = dict.fromkeys(("pose", "map"), time.monotonic())
        """When the newest one came."""
        self.trouble = ""
        """Which input is too old to go by, as `poll` last saw it; empty while none is."""
        self._subscriptions = self._subscribe()

    def begin(self, navigator: Navigator, frame: MapFrame, *, by_topic: bool) -> None:
        """The loop runs on this map from now on, in whose cells pose and goal are put; `by_topic`
        where an occupancy grid is all of it.
        """
        self._navigator = navigator
        self.frame = frame
        self._by_topic = by_topic
        self._mailbox = Mailbox()  # what waits is in the cells of the map before
        if self.goal is not None:
            self.set_goal(self.goal)
        self._put_pose()

    def poll(self) -> Iterator[Input]:
        """Inputs since the last call. Without a pose or a map that is new enough, the loop's pose
        is forgotten.
        """
        now = time.monotonic()
        own = self._node.own
        self.trouble = ""
        for what, limit_s in (("pose", own.odom_timeout_s), ("map", own.map_timeout_s)):
            old_s = now - self._came[what]
            if limit_s and old_s > limit_s:
                self.trouble = f"the newest {what} is {old_s:.1f} s old, allowed are {limit_s:g}"
        if self.trouble and self._navigator is not None:
            self._navigator.forget(goal=False)
        return self._mailbox.read()

    def set_goal(self, place: Place) -> None:
        """Send the loop to a place of the global frame, if there is a map."""
        self.goal = place
        if self.frame is None:
            return
        heading = self.frame.heading_deg(place.yaw_rad)
        row, col = self.frame.cell(place.x, place.y)
        self._mailbox.put(Goal(row, col, heading_deg=heading), when_full="drop oldest")

    def close(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _subscribe(self) -> list[Ros]:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        special = {"odom": newest, "pose": newest, "map": latched}
        made = []
        for topic, kind in TOPICS.items():
            if found := message_type(self._node, topic, kind):
                hear = partial(self._hear, topic)
                qos = special.get(topic, QoSProfile(depth=10))
                made.append(self._node.create_subscription(found, topic, hear, qos))
        return made

    def _hear(self, topic: str, message: Ros) -> None:
        """Convert a message, or refuse it."""
        try:
            getattr(self, f"_on_{topic}")(message)
        except Exception as error:  # whatever comes from outside, the node goes on
            self.refused[topic] = str(error)
            self._count("input")
            line = f"{topic} was refused: {error}"
            self._node.get_logger().warning(line, throttle_duration_sec=_LOG_EVERY_S)
        else:
            self.refused.pop(topic, None)

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
        self._put_pose()

    def _put_pose(self) -> None:
        if self.robot is None or self.frame is None:
            return
        row, col = self.frame.places((self.robot.x, self.robot.y))[0].tolist()
        heading = self.frame.heading_deg(self.robot.yaw_rad)
        self._mailbox.put(Pose(row, col, heading_deg=heading), when_full="drop oldest")

    def _on_goal_pose(self, message: Ros) -> None:
        self.set_goal(self._node.frames.place(message.pose, message.header.frame_id, "a goal"))

    def _on_map(self, message: Ros) -> None:
        grid = OccupancyGrid.of_message(message)
        wanted = self._node.own.global_frame
        if grid.frame.frame_id != wanted:
            got = grid.frame.frame_id
            raise InvalidMapError(f"wanted a map in the frame {wanted!r}, got one in {got!r}")
        self._grid = grid
        shape = None if self._navigator is None else self._navigator.map.shape
        same = grid.frame == self.frame and grid.data.shape == shape
        if same or (self._navigator is not None and not self._by_topic):
            self._put_grid(grid)
        else:
            self._came["map"] = time.monotonic()
            self._on_grid(grid)

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
        assert self.frame is not None
        self._put(occupancy_patch(grid, self.frame, keep_known=not self._by_topic))

    def _on_elevation_map(self, message: Ros) -> None:
        if self.frame is None or self._by_topic:
            raise InvalidMapError("wanted map_size_m or map_file for elevations, got neither")
        self._put(grid_map_patch(GridMap.of_message(message), self.frame, self._node.own.layer))

    def _put(self, patch: MapPatch) -> None:
        self._came["map"] = time.monotonic()
        for _ in range(self._mailbox.put(patch, when_full="drop oldest")):
            self._count("input dropped")

    def _count(self, error: str) -> None:
        if self._navigator is not None:
            self._navigator.count_error(error)
