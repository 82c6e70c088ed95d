"""Topics that the node listens to, as inputs of the loop. The executor's thread converts them."""

import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from nnpp_edge.robot.ros2.frames import Frames, Place
from nnpp_edge.robot.ros2.parameters import Parameters
from nnpp_edge.robot.transports.incoming import Refusals
from nnpp_edge.ros.maps import GridMap, MapFrame, OccupancyGrid, grid_map_patch, occupancy_patch
from nnpp_edge.runtime.cells import common, slices
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Goal, Input, InvalidMessageError, MapPatch, Pose
from nnpp_edge.runtime.loop.workers import CountError

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.subscription import Subscription

    from nnpp_edge.runtime.loop.navigator import Navigator


class RosSource:
    """Subscriptions of a node, and the inputs of the loop that came by them.

    `on_grid` is called with an occupancy grid that is a new map rather than a part of the loop's.
    Until `begin` says on which map the loop runs, the newest pose and goal wait. Messages that are
    refused are added to `refusals`.
    """

    def __init__(
        self,
        node: "Node",
        parameters: Callable[[], Parameters],
        on_grid: Callable[[OccupancyGrid], None],
        count_error: CountError,
    ) -> None:
        self._node = node
        self._parameters = parameters
        self._on_grid = on_grid
        self._count_error = count_error
        self.refusals = Refusals(count_error)
        self.refused: dict[str, str] = {}
        """Why the newest message was refused, by topic; of those whose newest one was."""
        self.frames = Frames(node, parameters().global_frame)
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
        self._pose_at = self._map_at = time.monotonic()
        self._levelled = False
        self._newest: dict[str, Any] = {}
        """Messages by topic that are to be converted again for another map."""
        self.trouble = ""
        """Which input is too old to go by, as `poll` last saw it; empty while none is."""
        self._subscriptions = list(self._subscribe())

    def begin(self, navigator: "Navigator", frame: MapFrame, *, by_topic: bool) -> None:
        """The loop runs on this map from now on; `by_topic` where an occupancy grid is all of it.

        Pose and goal are put into its cells.
        """
        self._navigator = navigator
        self.frame = frame
        self._by_topic = by_topic
        for _ in self._mailbox.read():
            """What waits is in the cells of the map before."""
        for topic, message in list(self._newest.items()):
            self._hear(topic, message)

    def poll(self) -> Iterator[Input]:
        """Inputs since the last call. Without a pose or a map that is new enough, the loop's pose
        is forgotten.
        """
        self.trouble = self._too_old()
        if self.trouble and self._navigator is not None:
            self._navigator.forget(goal=False)
        return self._mailbox.read()

    def set_goal(self, place: Place) -> None:
        """Send the loop to a place of the global frame; InvalidMessageError without a map."""
        if self.frame is None:
            raise InvalidMessageError("wanted a map before a goal, got none yet")
        self.goal = place
        row, col = self.frame.cell(place.x, place.y)
        heading = self.frame.heading_deg(place.yaw_rad)
        vehicle = None if self._navigator is None else self._navigator.map.vehicle
        arcs = vehicle is not None and vehicle.turning_radius_m
        goal = Goal(row, col, heading_deg=heading if arcs else None)
        self._mailbox.put(goal, when_full="drop oldest")

    def close(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self.frames.close()

    def _subscribe(self) -> "Iterator[Subscription[Any]]":
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        every = QoSProfile(depth=10)
        topics: list[tuple[str, str, QoSProfile]] = [
            ("odom", "nav_msgs.msg:Odometry", newest),
            ("pose", "geometry_msgs.msg:PoseStamped", newest),
            ("goal_pose", "geometry_msgs.msg:PoseStamped", QoSProfile(depth=1)),
            ("map", "nav_msgs.msg:OccupancyGrid", latched),
            ("map_updates", "map_msgs.msg:OccupancyGridUpdate", every),
            ("elevation_map", "grid_map_msgs.msg:GridMap", every),
        ]
        for topic, kind, qos in topics:
            module, _, name = kind.partition(":")
            try:
                message_type = getattr(import_module(module), name)
            except ImportError:
                self._node.get_logger().info(f"{topic}: not listened to, as {module} is missing")
                continue

            def hear(message: Any, topic: str = topic) -> None:
                self._hear(topic, message)

            yield self._node.create_subscription(message_type, topic, hear, qos)

    def _hear(self, topic: str, message: Any) -> None:
        """Convert a message, or refuse it."""
        if topic in ("odom", "pose", "goal_pose"):
            self._newest[topic] = message
        try:
            getattr(self, f"_on_{topic}")(message)
        except NnppEdgeError as error:
            self._newest.pop(topic, None)
            self.refused[topic] = str(error)
            self.refusals.add(InvalidMessageError(f"{topic}: {error}"))
        else:
            self.refused.pop(topic, None)

    def _on_odom(self, message: Any) -> None:
        base = self._parameters().robot_base_frame
        if base and message.child_frame_id not in ("", base):
            raise InvalidMessageError(
                f"wanted the robot's frame {base!r}, got {message.child_frame_id!r}"
            )
        self._on_place(message.pose.pose, message.header.frame_id)

    def _on_pose(self, message: Any) -> None:
        self._on_place(message.pose, message.header.frame_id)

    def _on_place(self, pose: Any, frame_id: str) -> None:
        place = self.frames.place(pose, frame_id, "a pose")
        self.robot = place
        self._pose_at = time.monotonic()
        if self.frame is None:
            return
        self._level_start(place)
        row, col = self.frame.places((place.x, place.y))[0].tolist()
        heading = self.frame.heading_deg(place.yaw_rad)
        self._mailbox.put(Pose(row, col, heading_deg=heading), when_full="drop oldest")

    def _on_goal_pose(self, message: Any) -> None:
        place = self.frames.place(message.pose, message.header.frame_id, "a goal")
        if self.frame is not None:
            self.set_goal(place)

    def _on_map(self, message: Any) -> None:
        grid = OccupancyGrid.of_message(message)
        self._check_frame(grid.frame)
        self._grid = grid
        self._map_at = time.monotonic()
        frame = self.frame
        if frame is None or (self._by_topic and not self._same(grid)):
            self._on_grid(grid)
            return
        # of a map that is all costs, what is unknown now is unknown
        self._put(occupancy_patch(grid, frame, keep_known=not self._by_topic))

    def _on_map_updates(self, message: Any) -> None:
        grid = self._grid
        if grid is None or self.frame is None:
            raise InvalidMapError("wanted a whole map before a part of it, got none yet")
        side = grid.frame.resolution
        corner = (grid.frame.x + message.x * side, grid.frame.y + message.y * side)
        part = MapFrame(side, *corner, frame_id=message.header.frame_id)
        self._check_frame(part)
        shape = (message.height, message.width)
        values = np.asarray(message.data)
        if not values.size or values.size != shape[0] * shape[1]:
            raise InvalidMapError(f"wanted {shape[0]} × {shape[1]} cells, got {values.size}")
        self._map_at = time.monotonic()
        update = OccupancyGrid(values.reshape(shape), part)
        self._put(occupancy_patch(update, self.frame, keep_known=not self._by_topic))

    def _on_elevation_map(self, message: Any) -> None:
        frame = self.frame
        if frame is None or self._by_topic:
            raise InvalidMapError("wanted map_size_m or map_file for elevations, got neither")
        grid = GridMap.of_message(message)
        self._check_frame(grid.frame)
        self._put(grid_map_patch(grid, frame, self._parameters().layer))
        self._map_at = time.monotonic()

    def _check_frame(self, frame: MapFrame) -> None:
        wanted = self.frames.global_frame
        if frame.frame_id != wanted:
            raise InvalidMapError(
                f"wanted a map in the frame {wanted!r}, got one in {frame.frame_id!r}"
            )

    def _same(self, grid: OccupancyGrid) -> bool:
        """Whether a whole grid has the cells of the loop's map."""
        assert self._navigator is not None
        return grid.frame == self.frame and grid.data.shape == self._navigator.map.shape

    def _put(self, patch: MapPatch) -> None:
        for _ in range(self._mailbox.put(patch, when_full="drop oldest")):
            self._count_error("input dropped")

    def _level_start(self, place: Place) -> None:
        """Once, tell what is unknown around the robot as level at its height."""
        reach_m = self._parameters().start_level_m
        frame = self.frame
        if self._levelled or not reach_m or self._navigator is None or frame is None:
            return
        self._levelled = True
        state = self._navigator.map
        reach = round(reach_m / frame.resolution)
        row, col = frame.cell(place.x, place.y)
        square = (row - reach, col - reach, 2 * reach + 1, 2 * reach + 1)
        part = common(square, (0, 0, *state.shape))
        if part is None or not state.has_heights:
            return
        unknown = state.unknown(*slices(part))
        heights = np.where(unknown, np.float32(place.z), np.float32(np.nan))
        self._put(MapPatch(part[0], part[1], elevation=heights, keep_known=True))

    def _too_old(self) -> str:
        """In words, which input is older than its parameter allows."""
        now = time.monotonic()
        own = self._parameters()
        for what, at, limit_s in (
            ("pose", self._pose_at, own.odom_timeout_s),
            ("map", self._map_at, own.map_timeout_s),
        ):
            if limit_s and now - at > limit_s:
                return f"the newest {what} is {now - at:.1f} s old, allowed are {limit_s:g}"
        return ""
