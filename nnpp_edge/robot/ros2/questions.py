"""Plans that others ask for: the service get_plan, and Nav2's actions where they are installed."""

import copy
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Condition
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from nnpp_edge.robot.ros2.answers import RosSink, poses_of
from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.robot.ros2.inputs import RosSource
from nnpp_edge.robot.ros2.parameters import Parameters
from nnpp_edge.ros.messages import path_message
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import NnppEdgeError, Status
from nnpp_edge.runtime.loop.messages import InvalidMessageError
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner

if TYPE_CHECKING:
    from rclpy.node import Node

T = TypeVar("T")
_PLANNERS = ("", "nnpp_edge", "GridBased")
"""Names that requests may have for the planner; the last is that of Nav2's trees."""
_ERRORS = {
    Status.START_OUTSIDE_MAP: "START_OUTSIDE_MAP",
    Status.GOAL_OUTSIDE_MAP: "GOAL_OUTSIDE_MAP",
    Status.START_BLOCKED: "START_OCCUPIED",
    Status.GOAL_BLOCKED: "GOAL_OCCUPIED",
    Status.TIMEOUT: "TIMEOUT",
    Status.NO_PATH: "NO_VALID_PATH",
    Status.NO_POSE: "TF_ERROR",
}
"""Nav2's names, of what its result calls so; UNKNOWN for all others."""
_NOTHING = np.empty((0, 4))


class _Given(NamedTuple):
    """The answer to a question."""

    poses: Floats
    """(N, 4), as of `arc_poses`."""
    error: str = "NONE"
    """Nav2's name for it."""
    reason: str = ""


class Copies:
    """Copies of the loop's planner, made between two ticks: other threads plan on them."""

    def __init__(self, navigator: Navigator) -> None:
        self._navigator = navigator
        self._asked = Condition()
        self._wanted = False
        self._planner: DynamicPlanner | None = None
        self._version = -1

    def after_tick(self) -> None:
        """Make a copy if one is wanted. For the loop's thread."""
        if not self._wanted:
            return
        with self._asked:
            version = self._navigator.map.log.version
            if self._planner is None or version != self._version:
                self._planner = copy.deepcopy(self._navigator.planner)
                self._version = version
            self._wanted = False
            self._asked.notify_all()

    def newest(self, patience_s: float) -> DynamicPlanner | None:
        """A planner on the map as it is now; None if the loop does not tick."""
        with self._asked:
            self._wanted = True
            self._asked.wait_for(lambda: not self._wanted, patience_s)
            return None if self._wanted else self._planner


class Questions:
    """Answers a service and two actions while the loop runs.

    A plan from the robot's own pose is the loop's: its goal becomes the loop's goal. Plans from
    elsewhere, or by way of several poses, are made on a copy of the loop's planner.
    """

    def __init__(
        self,
        node: "Node",
        parameters: Callable[[], Parameters],
        source: RosSource,
    ) -> None:
        from nav_msgs.srv import GetPlan

        self._node = node
        self._parameters = parameters
        self._source = source
        self._sink: RosSink | None = None
        self._copies: Copies | None = None
        self._worker = ThreadPoolExecutor(1, "nnpp-edge questions")
        self._service = node.create_service(GetPlan, "get_plan", self._get_plan)
        self._actions = self._action_servers()

    def begin(self, sink: RosSink, copies: Copies) -> None:
        """The loop answers by this sink from now on."""
        self._sink = sink
        self._copies = copies

    def close(self) -> None:
        """Answer nothing more."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._node.destroy_service(self._service)
        for server in self._actions:
            server.destroy()

    def _action_servers(self) -> list[Any]:
        try:
            from nav2_msgs.action import ComputePathThroughPoses, ComputePathToPose
        except ImportError:
            self._node.get_logger().info("no actions, as nav2_msgs is missing")
            return []
        from rclpy.action import ActionServer

        servers = []
        for kind, name, answer in (
            (ComputePathToPose, "compute_path_to_pose", self._to_pose),
            (ComputePathThroughPoses, "compute_path_through_poses", self._through_poses),
        ):

            async def execute(handle: Any, kind: Any = kind, answer: Any = answer) -> Any:
                return await self._execute(handle, kind, answer)

            servers.append(ActionServer(self._node, kind, name, execute))
        return servers

    # --- ROS' side

    async def _get_plan(self, request: Any, response: Any) -> Any:
        ends = (request.start, request.goal)
        given = await self._work(lambda: self._between(*ends, request.tolerance))
        if given.error != "NONE":
            self._node.get_logger().warning(f"get_plan: {given.error}: {given.reason}")
        response.plan = self._path(given.poses)
        return response

    async def _execute(self, handle: Any, kind: Any, answer: Callable[[Any], _Given]) -> Any:
        began = time.monotonic()
        given = await self._work(lambda: answer(handle.request))
        result = kind.Result()
        result.path = self._path(given.poses)
        seconds = time.monotonic() - began
        result.planning_time.sec = int(seconds)
        result.planning_time.nanosec = int(1e9 * (seconds % 1.0))
        if hasattr(result, "error_code"):
            result.error_code = getattr(kind.Result, given.error, kind.Result.UNKNOWN)
        if hasattr(result, "error_msg"):
            result.error_msg = given.reason
        if given.error == "NONE":
            handle.succeed()
        else:
            self._node.get_logger().warning(f"{kind.__name__}: {given.error}: {given.reason}")
            handle.abort()
        return result

    async def _work(self, work: Callable[[], _Given]) -> _Given:
        """Do it in the thread for that, one question after another."""
        from rclpy.task import Future

        future: Future[_Given] = Future(executor=self._node.executor)

        def do() -> None:
            try:
                given = work()
            except NnppEdgeError as error:
                given = _Given(_NOTHING, "TF_ERROR", str(error))
            except Exception as error:
                self._node.get_logger().error(f"a plan that was asked for failed: {error!r}")
                given = _Given(_NOTHING, "UNKNOWN", repr(error))
            future.set_result(given)

        self._worker.submit(do)
        found: _Given = await future
        return found

    def _path(self, poses: Floats) -> Any:
        from nav_msgs.msg import Path
        from rclpy.serialization import deserialize_message

        frame_id = self._source.frames.global_frame
        stamp = int(self._node.get_clock().now().nanoseconds)
        return deserialize_message(path_message(poses[:, :3], stamp, frame_id), Path)

    # --- the loop's side, in the thread of the questions

    def _to_pose(self, request: Any) -> _Given:
        if request.planner_id not in _PLANNERS:
            return _no_such_planner(request.planner_id)
        if request.use_start:
            return self._between(request.start, request.goal)
        sink = self._sink
        if sink is None:
            return _Given(_NOTHING, "UNKNOWN", "there is no map yet")
        goal = self._place(request.goal, "a goal")
        before = sink.newest
        self._source.set_goal(goal)
        # the tick that runs now has perhaps read its inputs: the one after it has this goal
        tick = 1 + (before.tick if before else 0)
        answer = sink.wait_after(tick, self._parameters().planner_patience_s)
        if answer is None:
            return _Given(_NOTHING, "TIMEOUT", "the loop has not answered in time")
        if not answer.ok:
            return _failed(answer.outcome, answer.reason)
        assert self._source.frame is not None
        return _Given(poses_of(answer, self._source.frame, goal))

    def _through_poses(self, request: Any) -> _Given:
        if request.planner_id not in _PLANNERS:
            return _no_such_planner(request.planner_id)
        goals = getattr(request.goals, "goals", request.goals)
        if not goals:
            return _Given(_NOTHING, "NO_VIAPOINTS_GIVEN", "wanted goals, got none")
        start = self._place(request.start, "a start") if request.use_start else self._robot()
        stops = [self._place(goal, "a goal") for goal in goals]
        return self._planned([start, *stops])

    def _between(self, start: Any, goal: Any, tolerance_m: float = 0.0) -> _Given:
        begin = self._place(start, "a start") if start.header.frame_id else self._robot()
        return self._planned([begin, self._place(goal, "a goal")], tolerance_m)

    def _place(self, stamped: Any, what: str) -> Place:
        return self._source.frames.place(stamped.pose, stamped.header.frame_id, what)

    def _robot(self) -> Place:
        if self._source.robot is None:
            raise InvalidMessageError("wanted the robot's pose, got none yet")
        return self._source.robot

    def _planned(self, stops: Sequence[Place], tolerance_m: float = 0.0) -> _Given:
        """Legs from place to place, on a copy of the loop's planner."""
        own = self._parameters()
        until = time.monotonic() + own.planner_patience_s
        frame = self._source.frame
        planner = self._copies.newest(own.planner_patience_s) if self._copies else None
        if planner is None or frame is None:
            return _Given(_NOTHING, "UNKNOWN", "there is no map yet, or the loop is busy")
        vehicle = planner.state.vehicle
        arcs = vehicle is not None and vehicle.turning_radius_m
        legs: list[Floats] = []
        for start, goal in zip(stops[:-1], stops[1:], strict=True):
            cells = [frame.cell(place.x, place.y) for place in (start, goal)]
            headings = [frame.heading_deg(place.yaw_rad) for place in (start, goal)]
            if not planner.state.grid.holds(cells[1]):
                return _failed(Status.GOAL_OUTSIDE_MAP, f"the map has {planner.shape} cells")
            target = _passable_near(planner, cells[1], tolerance_m / frame.resolution)
            planner.set_goal(target, headings[1] if arcs else None)
            planner.move(cells[0], headings[0] if arcs else None)
            plan = planner.replan(time_limit_s=max(until - time.monotonic(), 0.01))
            if not plan.ok:
                return _failed(plan.status, plan.reason)
            # a leg begins where the one before ends
            legs.append(poses_of(plan, frame, goal)[bool(legs) :])
        return _Given(np.concatenate(legs))


def _passable_near(planner: DynamicPlanner, goal: Cell, reach: float) -> Cell:
    """The goal, or the passable cell nearest to it within so many cells."""
    side = math.floor(reach)
    offsets = [(row, col) for row in range(-side, side + 1) for col in range(-side, side + 1)]
    for row, col in sorted(offsets, key=lambda offset: math.hypot(*offset)):
        cell = (goal[0] + row, goal[1] + col)
        near = math.hypot(row, col) <= reach
        if near and planner.state.grid.holds(cell) and planner.is_passable(cell):
            return cell
    return goal


def _failed(status: Status, reason: str) -> _Given:
    return _Given(_NOTHING, _ERRORS.get(status, "UNKNOWN"), f"{status}: {reason}")


def _no_such_planner(name: str) -> _Given:
    wanted = ", ".join(each for each in _PLANNERS if each)
    return _Given(_NOTHING, "INVALID_PLANNER", f"wanted the planner {wanted}, got {name!r}")
