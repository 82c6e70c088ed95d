"""The loop's answers as topics. Long ones are written as bytes by NumPy, which holds nobody up."""

import threading
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.robot.ros2.inputs import message_type
from nnpp_edge.robot.transports.mcap_log import is_rest
from nnpp_edge.ros.maps import MapFrame, arc_poses
from nnpp_edge.ros.messages import grid_message, path_message, whole_numbers_message
from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Output, PathMessage, StatusMessage
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.viz.picture import body_outlines

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.node import PlannerNode
    from nnpp_edge.robot.ros2.session import Session

TOPICS = {
    "plan": "nav_msgs.msg:Path",
    "plan_gears": "std_msgs.msg:Int8MultiArray",
    "traversability": "nav_msgs.msg:OccupancyGrid",
    "footprints": "visualization_msgs.msg:MarkerArray",
    "/diagnostics": "diagnostic_msgs.msg:DiagnosticArray",
}
_IDLE = (Status.OK, Status.NO_GOAL)
_ODD = ("overruns", "degraded", "errors")
"""Counters that are told as a warning where they have grown."""
_LINE_M = 0.05
"""Width of a footprint's outline."""


def poses_of(answer: PathMessage | Plan, frame: MapFrame, goal: Place | None) -> Floats:
    """(N, 4) poses of an answer as `arc_poses` has them; of one that ends at the goal, but of a
    body that drives arcs, the last has the goal's yaw.
    """
    poses = arc_poses(answer, frame)
    if len(poses) and not (answer.arcs or goal is None or getattr(answer, "goal_moved", False)):
        poses[-1, 2] = goal.yaw_rad
    return poses


class Outlet:
    """The topics that go out; maps and the like only where somebody listens."""

    def __init__(self, node: "PlannerNode") -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node = node
        self._publishers = {
            topic: node.create_lifecycle_publisher(found, topic, latched)
            for topic, kind in TOPICS.items()
            if (found := message_type(node, topic, kind))
        }

    def path(self, poses: Floats) -> None:
        """Publish poses (N, 4), see `arc_poses`; none stop who follows them."""
        frame_id = self._node.own.global_frame
        self.publish("plan_gears", whole_numbers_message(poses[:, 3]))
        self.publish("plan", path_message(poses[:, :3], self.now_ns, frame_id))

    def stop(self, reason: str) -> None:
        """Publish an empty path, and why."""
        self.path(np.empty((0, 4)))
        self.diagnose("ERROR", reason, {})

    def diagnose(self, level: str, text: str, values: Mapping[str, object]) -> None:
        """Publish how the planner is; `level` is a name of DiagnosticStatus."""
        if not self.is_heard("/diagnostics"):
            return
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        status = DiagnosticStatus(name="nnpp_edge: planning", message=text)
        status.level = getattr(DiagnosticStatus, level)
        status.values = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
        self.publish("/diagnostics", DiagnosticArray(header=self.header(), status=[status]))

    def publish(self, topic: str, message: Ros) -> None:
        """Publish a message, or its bytes."""
        self._publishers[topic].publish(message)

    def is_heard(self, topic: str) -> bool:
        """Whether somebody listens."""
        found = self._publishers.get(topic)
        return found is not None and found.get_subscription_count() > 0

    def close(self) -> None:
        """Publish nothing more."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    @property
    def now_ns(self) -> int:
        """By the node's clock."""
        return self._node.get_clock().now().nanoseconds  # type: ignore[no-any-return]

    def header(self) -> Ros:
        """A header of now, in the global frame."""
        from std_msgs.msg import Header

        stamp = self._node.get_clock().now().to_msg()
        return Header(stamp=stamp, frame_id=self._node.own.global_frame)


class RosSink:
    """Publishes what a session's loop answers, until `end`: a path when it is another one and once
    a second, the rest once a second.
    """

    name = "ros"

    def __init__(self, outlet: Outlet, session: "Session") -> None:
        self._outlet = outlet
        self._session = session
        self._state = session.navigator.map
        self._walked: Cells | None = None
        self._due = False
        self._shown_version = -1
        self._odd: list[object] = [0, {}, {}]
        self._publishing = threading.Lock()
        self.ended = False
        self.newest: PathMessage | None = None
        """The newest answer."""

    def publish(self, message: Output) -> None:
        """Publish an answer."""
        with self._publishing:
            if self.ended:
                return
            if isinstance(message, StatusMessage):
                self._due = True
                self._publish_state(message)
                return
            self.newest = message
            if self._due or not is_rest(message.walked, self._walked):
                self._due = False
                session = self._session
                self._outlet.path(poses_of(message, session.frame, session.listener.goal))
            self._walked = message.walked

    def end(self) -> None:
        """Publish nothing more from now on."""
        with self._publishing:
            self.ended = True

    def _publish_state(self, message: StatusMessage) -> None:
        self._diagnose(message)
        version = self._state.log.version
        if version != self._shown_version and self._outlet.is_heard("traversability"):
            self._shown_version = version
            content = grid_message(self._state.cost(), self._session.frame, self._outlet.now_ns)
            self._outlet.publish("traversability", content)
        if self._outlet.is_heard("footprints"):
            self._outlet.publish("footprints", self._footprints())

    def _footprints(self) -> Ros:
        """The vehicle's outlines along the newest path, as one marker."""
        from geometry_msgs.msg import Point
        from visualization_msgs.msg import Marker, MarkerArray

        marker = Marker(ns="footprints", type=Marker.LINE_LIST, header=self._outlet.header())
        marker.scale.x = _LINE_M
        marker.color.g = marker.color.a = 1.0
        answer = self.newest
        vehicle = self._state.vehicle
        if answer is not None and vehicle is not None:
            frame = self._session.frame
            sides = (frame.resolution, frame.resolution)
            for outline in body_outlines(answer.path, vehicle, sides, answer.headings_deg):
                points = frame.metres(outline + 0.5)
                ends = np.repeat(points, 2, axis=0)[1:-1]  # each of its lines by both ends
                marker.points += [Point(x=x, y=y) for x, y in ends.tolist()]
        return MarkerArray(markers=[marker])

    def _diagnose(self, message: StatusMessage) -> None:
        """The loop's counters, and how it is: an error without a path, a warning where ticks were
        late, answers degraded or errors caught since the last one.
        """
        counts = asdict(message.counters)
        odd = [counts[name] for name in _ODD]
        level = "OK" if odd == self._odd else "WARN"
        self._odd = odd
        text = message.text
        if message.outcome not in _IDLE and self.newest is not None:
            level = "ERROR"
            text = f"{message.outcome}: {self._session.trouble or self.newest.reason}"
        values = {"outcome": message.outcome, "refused": self._session.listener.refused, **counts}
        self._outlet.diagnose(level, text, values)
