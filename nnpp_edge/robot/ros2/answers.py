"""The loop's answers as topics. Long ones are written as bytes by NumPy, which holds nobody up."""

import threading
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.robot.ros2.inputs import RosSource
from nnpp_edge.ros.maps import MapFrame, arc_poses, placed
from nnpp_edge.ros.messages import grid_message, path_message, whole_numbers_message
from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Counters, Output, PathMessage, StatusMessage
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.viz.picture import body_outlines

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNode

_IDLE = (Status.OK, Status.NO_GOAL)
_LINE_M = 0.05
"""Width of a footprint's outline."""


class Outlets:
    """The node's publishers; of topics whose messages are not installed there are none."""

    def __init__(self, node: "LifecycleNode") -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node = node
        self._publishers: dict[str, Any] = {}
        for topic, kind, qos in (
            ("plan", "nav_msgs.msg:Path", latched),
            ("plan_gears", "std_msgs.msg:Int8MultiArray", latched),
            ("traversability", "nav_msgs.msg:OccupancyGrid", latched),
            ("footprints", "visualization_msgs.msg:MarkerArray", latched),
            ("/diagnostics", "diagnostic_msgs.msg:DiagnosticArray", QoSProfile(depth=10)),
        ):
            module, _, name = kind.partition(":")
            try:
                message_type = getattr(import_module(module), name)
            except ImportError:
                node.get_logger().info(f"{topic}: not published, as {module} is missing")
                continue
            self._publishers[topic] = node.create_lifecycle_publisher(message_type, topic, qos)

    @property
    def now_ns(self) -> int:
        """The node's clock."""
        return int(self._node.get_clock().now().nanoseconds)

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message, or its bytes, where there is such a topic."""
        if topic in self._publishers:
            self._publishers[topic].publish(message)

    def publish_path(self, poses: Floats, frame_id: str) -> None:
        """Publish poses (N, 4), see `arc_poses`; none stop who follows them."""
        self.publish("plan_gears", whole_numbers_message(poses[:, 3]))
        self.publish("plan", path_message(poses[:, :3], self.now_ns, frame_id))

    def is_heard(self, topic: str) -> bool:
        """Whether anybody listens."""
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def close(self) -> None:
        """Publish nothing more."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)


def poses_of(answer: PathMessage | Plan, frame: MapFrame, goal: Place | None) -> Floats:
    """(N, 4) poses of an answer as `arc_poses` has them; of one that ends at the goal, but of a
    body that drives arcs, the last has the goal's yaw.
    """
    poses = arc_poses(answer, frame)
    moved = isinstance(answer, PathMessage) and answer.goal_moved
    if len(poses) and not answer.arcs and goal is not None and not moved:
        poses[-1, 2] = goal.yaw_rad
    return poses


class RosSink:
    """Publishes what a loop on one map answers: a path when it is another one and once a second,
    the rest once a second, maps and footprints only where somebody listens.
    """

    name = "ros"

    def __init__(self, outlets: Outlets, source: RosSource, state: MapState) -> None:
        assert source.frame is not None
        self._outlets = outlets
        self._source = source
        self._state = state
        self._frame = source.frame
        self._walked: Cells | None = None
        self._due = False
        self._outlined: PathMessage | None = None
        self._map_version = -1
        self._counted = Counters()
        self._changed = threading.Condition()
        self.newest: PathMessage | None = None
        """The newest answer."""

    def publish(self, message: Output) -> None:
        """Publish an answer."""
        if isinstance(message, StatusMessage):
            self._due = True
            self._publish_state(message)
            return
        if message.outcome is Status.NO_POSE and self._source.trouble:
            message = replace(message, reason=self._source.trouble)
        if self._due or not _is_rest(message.walked, self._walked):
            goal = self._source.goal
            poses = poses_of(message, self._frame, goal)
            self._outlets.publish_path(poses, self._frame.frame_id)
            self._due = False
        self._walked = message.walked
        with self._changed:
            self.newest = message
            self._changed.notify_all()

    def wait_after(self, tick: int, patience_s: float) -> PathMessage | None:
        """The first answer of a tick after that one, that says more than that time was up; None
        where patience ends before.
        """

        def is_there() -> bool:
            newest = self.newest
            late = newest is None or newest.outcome is Status.TIMEOUT
            return newest is not None and newest.tick > tick and not late

        with self._changed:
            return self.newest if self._changed.wait_for(is_there, patience_s) else None

    def _publish_state(self, message: StatusMessage) -> None:
        self._outlets.publish("/diagnostics", self._diagnostics(message))
        self._counted = message.counters
        version = self._state.log.version
        if version != self._map_version and self._outlets.is_heard("traversability"):
            self._map_version = version
            frame = self._frame
            cost = self._state.cost()
            side = frame.resolution
            if frame.rows_along_x:
                rows, cols = cost.shape
                corner = (frame.x - rows * side, frame.y - cols * side)
                target = MapFrame(side, *corner, frame_id=frame.frame_id)
                cost, _, _ = placed(cost, frame, target)
                frame = target
            self._outlets.publish("traversability", grid_message(cost, frame, self._outlets.now_ns))
        if self._outlets.is_heard("footprints") and self.newest is not self._outlined:
            self._outlined = self.newest
            self._outlets.publish("footprints", self._footprints())

    def _footprints(self) -> Any:
        """The vehicle's outlines along the newest path, as one marker."""
        from geometry_msgs.msg import Point
        from visualization_msgs.msg import Marker, MarkerArray

        marker = Marker(ns="footprints", type=Marker.LINE_LIST, action=Marker.ADD)
        marker.header = self._header()
        marker.scale.x = _LINE_M
        marker.pose.orientation.w = 1.0
        marker.color.g = 0.6
        marker.color.a = 1.0
        answer = self.newest
        if answer is not None and self._state.vehicle is not None:
            sides = self._state.sides_m or (1.0, 1.0)
            outlines = body_outlines(answer.path, self._state.vehicle, sides, answer.headings_deg)
            for outline in outlines:
                points = self._frame.metres(outline + 0.5)
                ends = np.repeat(points, 2, axis=0)[1:-1]  # each of its lines by both ends
                marker.points += [Point(x=x, y=y) for x, y in ends.tolist()]
        return MarkerArray(markers=[marker])

    def _diagnostics(self, message: StatusMessage) -> Any:
        """The loop's counters, and how it is: ERROR without a path, WARN where ticks were late,
        answers degraded or inputs refused since the last one.
        """
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        counters = message.counters
        before = self._counted
        worse = [
            name
            for name in ("overruns", "skipped", "degraded", "errors", "drops", "lost")
            if getattr(counters, name) != getattr(before, name) and _total(getattr(counters, name))
        ]
        level = DiagnosticStatus.WARN if worse else DiagnosticStatus.OK
        text = message.text
        newest = self.newest
        if message.outcome not in _IDLE:
            level = DiagnosticStatus.ERROR
            if newest is not None and newest.reason:
                text = f"{message.outcome}: {newest.reason}"
        elif worse:
            text = f"{text}; new: {', '.join(worse)}"
        values = {"outcome": str(message.outcome)}
        values |= {f"refused {topic}": why for topic, why in list(self._source.refused.items())}
        for name, value in vars(counters).items():
            for kind, number in value.items() if isinstance(value, dict) else [("", value)]:
                key = f"{name} {kind}".rstrip()
                values[key] = f"{number:g}" if isinstance(number, float) else str(number)
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        status = DiagnosticStatus(
            level=level, name="nnpp_edge: planning", message=text, values=pairs
        )
        return DiagnosticArray(header=self._header(), status=[status])

    def _header(self) -> Any:
        from builtin_interfaces.msg import Time
        from std_msgs.msg import Header

        seconds, rest = divmod(self._outlets.now_ns, 1_000_000_000)
        return Header(stamp=Time(sec=seconds, nanosec=rest), frame_id=self._frame.frame_id)


def _total(count: int | dict[str, int]) -> int:
    return sum(count.values()) if isinstance(count, dict) else count


def _is_rest(path: Cells, before: Cells | None) -> bool:
    """Whether a path is the end of the one that was published before."""
    if before is None or path.shape[1:] != before.shape[1:] or bool(len(path)) != bool(len(before)):
        return False
    return np.array_equal(path, before[len(before) - len(path) :])
