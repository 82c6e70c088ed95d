"""The loop's answers as topics. Long ones are written as bytes by NumPy, which holds nobody up."""

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.robot.ros2.inputs import RosSource, message_type
from nnpp_edge.robot.transports.mcap_log import is_rest
from nnpp_edge.ros.maps import MapFrame, arc_poses
from nnpp_edge.ros.messages import grid_message, path_message, whole_numbers_message
from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Output, PathMessage, StatusMessage
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.viz.picture import body_outlines

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNode

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


class RosSink:
    """Publishes what loops answer: a path when it is another one and once a second, the rest once a
    second, maps and footprints only where somebody listens. `begin` says on which map a loop runs.
    """

    name = "ros"

    def __init__(self, node: "LifecycleNode") -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node = node
        self.newest: PathMessage | None = None
        """The newest answer."""
        self._publishers = {
            topic: node.create_lifecycle_publisher(found, topic, latched)
            for topic, kind in TOPICS.items()
            if (found := message_type(node, topic, kind))
        }

    def begin(self, source: RosSource, state: MapState) -> None:
        """Answers come from a loop with this source, on this map."""
        assert source.frame is not None
        self._source = source
        self._state = state
        self._frame = source.frame
        self._walked: Cells | None = None
        self._due = False
        self._shown_version = -1
        self._odd: list[Ros] = [0, {}, {}]
        self.newest = None

    def publish(self, message: Output) -> None:
        """Publish an answer."""
        if isinstance(message, StatusMessage):
            self._due = True
            self._publish_state(message)
            return
        self.newest = message
        if self._due or not is_rest(message.walked, self._walked):
            self._due = False
            self.publish_path(poses_of(message, self._frame, self._source.goal))
        self._walked = message.walked

    def publish_path(self, poses: Floats) -> None:
        """Publish poses (N, 4), see `arc_poses`; none stop who follows them."""
        content = path_message(poses[:, :3], self.now_ns, self._frame.frame_id)
        self._publishers["plan_gears"].publish(whole_numbers_message(poses[:, 3]))
        self._publishers["plan"].publish(content)

    def close(self) -> None:
        """Publish nothing more."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    @property
    def now_ns(self) -> int:
        """By the node's clock."""
        return self._node.get_clock().now().nanoseconds  # type: ignore[no-any-return]

    def _is_heard(self, topic: str) -> bool:
        found = self._publishers.get(topic)
        return found is not None and found.get_subscription_count() > 0

    def _publish_state(self, message: StatusMessage) -> None:
        if self._is_heard("/diagnostics"):
            self._publishers["/diagnostics"].publish(self._diagnostics(message))
        version = self._state.log.version
        if version != self._shown_version and self._is_heard("traversability"):
            self._shown_version = version
            content = grid_message(self._state.cost(), self._frame, self.now_ns)
            self._publishers["traversability"].publish(content)
        if self._is_heard("footprints"):
            self._publishers["footprints"].publish(self._footprints())

    def _footprints(self) -> Ros:
        """The vehicle's outlines along the newest path, as one marker."""
        from geometry_msgs.msg import Point
        from visualization_msgs.msg import Marker, MarkerArray

        marker = Marker(ns="footprints", type=Marker.LINE_LIST, header=self._header())
        marker.scale.x = _LINE_M
        marker.color.g = marker.color.a = 1.0
        answer = self.newest
        vehicle = self._state.vehicle
        if answer is not None and vehicle is not None:
            sides = (self._frame.resolution, self._frame.resolution)
            for outline in body_outlines(answer.path, vehicle, sides, answer.headings_deg):
                points = self._frame.metres(outline + 0.5)
                ends = np.repeat(points, 2, axis=0)[1:-1]  # each of its lines by both ends
                marker.points += [Point(x=x, y=y) for x, y in ends.tolist()]
        return MarkerArray(markers=[marker])

    def _diagnostics(self, message: StatusMessage) -> Ros:
        """The loop's counters, and how it is: an error without a path, a warning where ticks were
        late, answers degraded or errors caught since the last one.
        """
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        counts = asdict(message.counters)
        odd = [counts[name] for name in _ODD]
        level = DiagnosticStatus.OK if odd == self._odd else DiagnosticStatus.WARN
        self._odd = odd
        text = message.text
        if message.outcome not in _IDLE and self.newest is not None:
            level = DiagnosticStatus.ERROR
            text = f"{message.outcome}: {self._source.trouble or self.newest.reason}"
        refused = "; ".join(map(": ".join, list(self._source.refused.items())))
        values = {"outcome": message.outcome, "refused": refused, **counts}
        pairs = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
        status = DiagnosticStatus(level=level, name="nnpp_edge: planning", message=text)
        status.values = pairs
        return DiagnosticArray(header=self._header(), status=[status])

    def _header(self) -> Ros:
        from std_msgs.msg import Header

        stamp = self._node.get_clock().now().to_msg()
        return Header(stamp=stamp, frame_id=self._frame.frame_id)
