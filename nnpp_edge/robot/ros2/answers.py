"""The loop's answers as topics. Long ones are written as bytes by NumPy, which holds nobody up."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.robot.ros2.inputs import message_type
from nnpp_edge.ros.maps import MapFrame, arc_poses
from nnpp_edge.ros.messages import grid_message, path_message, whole_numbers_message
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.loop.messages import PathMessage
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.node import PlannerNode

TOPICS = {
    "plan": "nav_msgs.msg:Path",
    "plan_gears": "std_msgs.msg:Int8MultiArray",
    "traversability": "nav_msgs.msg:OccupancyGrid",
    "/diagnostics": "diagnostic_msgs.msg:DiagnosticArray",
}


def poses_of(answer: PathMessage | Plan, frame: MapFrame, goal: PoseInFrame | None) -> Floats:
    """(N, 4) poses of an answer as `arc_poses` has them; of one that ends at the goal, but of a
    body that drives arcs, the last has the goal's yaw.
    """
    poses = arc_poses(answer, frame)
    if len(poses) and not (answer.arcs or goal is None or getattr(answer, "goal_moved", False)):
        poses[-1, 2] = goal.yaw_rad
    return poses


class Outlet:
    """The topics that go out; what is long only where somebody listens."""

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
        content = path_message(poses, self.now_ns, self._node.own.global_frame)
        self._publishers["plan_gears"].publish(whole_numbers_message(poses[:, 3]))
        self._publishers["plan"].publish(content)

    def stop(self, reason: str) -> None:
        """Publish an empty path, and why."""
        self.path(np.empty((0, 4)))
        self.diagnose("ERROR", reason, {})

    def diagnose(self, level: str, text: str, values: Mapping[str, object]) -> None:
        """Publish how the planner is; `level` is a name of DiagnosticStatus."""

        def made() -> Ros:
            from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
            from std_msgs.msg import Header

            stamp = self._node.get_clock().now().to_msg()
            header = Header(stamp=stamp, frame_id=self._node.own.global_frame)
            status = DiagnosticStatus(name="nnpp_edge: planning", message=text)
            status.level = getattr(DiagnosticStatus, level)
            status.values = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
            return DiagnosticArray(header=header, status=[status])

        self.show("/diagnostics", made)

    def costs(self, state: MapState, frame: MapFrame) -> bool:
        """Publish what the map costs, if somebody listens; whether somebody does."""
        return self.show("traversability", lambda: grid_message(state.cost(), frame, self.now_ns))

    def show(self, topic: str, make: Callable[[], Ros]) -> bool:
        """Publish what `make` makes, if somebody listens; whether somebody does."""
        found = self._publishers.get(topic)
        if found is None or not found.get_subscription_count():
            return False
        found.publish(make())
        return True

    def close(self) -> None:
        """Publish nothing more."""
        while self._publishers:
            self._node.destroy_lifecycle_publisher(self._publishers.popitem()[1])

    @property
    def now_ns(self) -> int:
        """By the node's clock."""
        return self._node.get_clock().now().nanoseconds  # type: ignore[no-any-return]
