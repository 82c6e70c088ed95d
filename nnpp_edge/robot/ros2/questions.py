"""Plans that others ask for: the service get_plan, and Nav2's actions where they are installed."""

import math
import pickle
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.answers import poses_of
from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.robot.ros2.inputs import message_type
from nnpp_edge.ros.maps import MapFrame
from nnpp_edge.ros.messages import path_message
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import nearest
from nnpp_edge.runtime.errors import NnppEdgeError, Status, one_line
from nnpp_edge.runtime.loop.messages import InvalidMessageError
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.node import PlannerNode
    from nnpp_edge.robot.ros2.session import Session

_Copy = tuple[bytes, list[bytearray], MapFrame]
"""A pickled planner, its arrays, which pickling them along would take several times as long, and
where its map lies.
"""
_PLANNERS = ("", "nnpp_edge", "GridBased")
"""Names that requests may have for the planner; the last is that of Nav2's trees."""
_ERRORS = {
    Status.START_BLOCKED: "START_OCCUPIED",
    Status.GOAL_BLOCKED: "GOAL_OCCUPIED",
    Status.NO_PATH: "NO_VALID_PATH",
    Status.NO_POSE: "TF_ERROR",
}
"""Nav2's names of what its results call otherwise than a `Status`."""
_PATIENCE_S = 5.0
"""Longest work on a plan that is asked for."""
_LOOK_EVERY_S = 0.01


class _Given(NamedTuple):
    """The answer to a question."""

    poses: Floats = np.empty((0, 4))
    """(N, 4), as of `arc_poses`."""
    error: str = "NONE"
    """Nav2's name for it."""
    reason: str = ""


class Questions:
    """Answers a service and two actions while the loop runs.

    A plan from the robot's own pose is the loop's: its goal becomes the loop's goal. Plans from
    elsewhere, or by way of several poses, are made on a copy of the loop's planner.
    """

    def __init__(self, node: "PlannerNode") -> None:
        from nav_msgs.srv import GetPlan

        self._node = node
        self._copies: deque[Future[_Copy]] = deque()
        """That are wanted of the loop's planner."""
        self._worker = ThreadPoolExecutor(1, "nnpp-edge questions")
        self._service = node.create_service(GetPlan, "get_plan", self._get_plan)
        self._actions = [
            self._server(name, kind, answer)
            for name, kind, answer in (
                ("compute_path_to_pose", "ComputePathToPose", self._to_pose),
                ("compute_path_through_poses", "ComputePathThroughPoses", self._through_poses),
            )
        ]

    def after_tick(self, session: "Session") -> None:
        """Copy the planner for who waits for it. For the loop's thread, which only copies the map's
        layers: a planner is made of them where it is wanted.
        """
        while self._copies:
            arrays: list[pickle.PickleBuffer] = []
            rest = pickle.dumps(session.navigator.planner, 5, buffer_callback=arrays.append)
            made = (rest, list(map(bytearray, arrays)), session.frame)
            self._copies.popleft().set_result(made)

    def close(self) -> None:
        """Answer nothing more."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._node.destroy_service(self._service)
        for server in filter(None, self._actions):
            server.destroy()

    # --- ROS' side

    def _server(self, name: str, kind: str, answer: Callable[[Ros], _Given]) -> Ros:
        """An action's server; None where its package is not installed."""
        found = message_type(self._node, name, f"nav2_msgs.action:{kind}")
        if found is None:
            return None
        from rclpy.action import ActionServer
        from rclpy.duration import Duration

        async def execute(handle: Ros) -> Ros:
            began = time.monotonic()
            result = found.Result()
            asked = handle.request
            given = await self._work(lambda: answer(asked), name, asked.planner_id)
            result.path = self._path(given)
            seconds = time.monotonic() - began
            result.planning_time = Duration(seconds=seconds).to_msg()
            result.error_code = getattr(found.Result, given.error, 0)
            if hasattr(result, "error_msg"):  # older ones of Nav2 lack it
                result.error_msg = given.reason
            (handle.succeed if given.error == "NONE" else handle.abort)()
            return result

        return ActionServer(self._node, found, name, execute)

    async def _get_plan(self, request: Ros, response: Ros) -> Ros:
        ends = (request.start, request.goal)
        tolerance_m = request.tolerance
        given = await self._work(lambda: self._between(*ends, tolerance_m=tolerance_m), "get_plan")
        response.plan = self._path(given)
        return response

    async def _work(self, work: Callable[[], _Given], name: str, planner: str = "") -> _Given:
        """Do it in the thread for that, one question after another."""
        from rclpy.task import Future as RosFuture

        future: Ros = RosFuture(executor=self._node.executor)

        def do() -> None:
            wanted = f"wanted the planner nnpp_edge or GridBased, got {planner!r}"
            given = _Given(error="INVALID_PLANNER", reason=wanted)
            try:
                if planner in _PLANNERS:
                    given = work()
            except Exception as error:  # one of ours is of a pose
                kind = "TF_ERROR" if isinstance(error, NnppEdgeError) else "UNKNOWN"
                given = _Given(error=kind, reason=one_line(error))
            if given.error != "NONE":
                self._node.get_logger().warning(f"{name}: {given.error}: {given.reason}")
            future.set_result(given)

        self._worker.submit(do)
        found: _Given = await future
        return found

    def _path(self, given: _Given) -> Ros:
        from nav_msgs.msg import Path
        from rclpy.serialization import deserialize_message

        frame_id = self._node.own.global_frame
        content = path_message(given.poses, self._node.outlet.now_ns, frame_id)
        return deserialize_message(content, Path)

    # --- the loop's side, in the thread of the questions

    def _to_pose(self, request: Ros) -> _Given:
        if request.use_start:
            return self._between(request.start, request.goal)
        goal = self._node.listener.goal = self._place(request.goal, "a goal")
        until = time.monotonic() + _PATIENCE_S
        while time.monotonic() < until:
            session = self._node.session
            answer = session and session.answer_to(goal)
            if session and answer and answer.outcome is not Status.TIMEOUT:
                if answer.ok:
                    return _Given(poses_of(answer, session.frame, goal))
                return _failed(answer.outcome, answer.reason)
            time.sleep(_LOOK_EVERY_S)
        return _failed(Status.TIMEOUT, "the loop has not answered in time")

    def _through_poses(self, request: Ros) -> _Given:
        goals = getattr(request.goals, "goals", request.goals)  # a list before ROS 2 Kilted
        if not goals:
            return _Given(error="NO_VIAPOINTS_GIVEN", reason="wanted goals, got none")
        return self._between(request.start if request.use_start else None, *goals)

    def _between(self, start: Ros, *goals: Ros, tolerance_m: float = 0.0) -> _Given:
        """A plan from a stamped pose; from the robot's own where it has no frame, or is None."""
        begin = self._node.listener.robot
        if start is not None and start.header.frame_id:
            begin = self._place(start, "a start")
        if begin is None:
            raise InvalidMessageError("wanted the robot's pose, got none yet")
        stops = [begin, *(self._place(goal, "a goal") for goal in goals)]
        return self._planned(stops, tolerance_m)

    def _place(self, stamped: Ros, what: str) -> PoseInFrame:
        return self._node.frames.place(stamped.pose, stamped.header.frame_id, what)

    def _planned(self, stops: Sequence[PoseInFrame], tolerance_m: float) -> _Given:
        """Legs from place to place, on a copy of the loop's planner; with a tolerance each leads to
        the nearest cell that can be reached, if that is so near.
        """
        until = time.monotonic() + _PATIENCE_S
        wanted: Future[_Copy] = Future()
        self._copies.append(wanted)
        try:
            rest, arrays, frame = wanted.result(_PATIENCE_S)
        except TimeoutError:
            return _failed(Status.TIMEOUT, "the loop does not run, or is busy")
        planner: DynamicPlanner = pickle.loads(rest, buffers=arrays)
        legs: list[Floats] = []
        for start, goal in zip(stops[:-1], stops[1:], strict=True):
            cell = frame.cell(goal.x, goal.y)
            if not planner.state.grid.holds(cell):
                return _failed(Status.GOAL_OUTSIDE_MAP, f"the map has {planner.shape} cells")
            begin = frame.cell(start.x, start.y)
            planner.move(begin, frame.heading_deg(start.yaw_rad))
            if tolerance_m > 0.0:
                reached = nearest(np.isfinite(planner.reach(begin)), cell)
                if math.dist(reached, cell) * frame.resolution <= tolerance_m:
                    cell = reached
            planner.set_goal(cell, frame.heading_deg(goal.yaw_rad))
            plan = planner.replan(time_limit_s=max(until - time.monotonic(), _LOOK_EVERY_S))
            if not plan.ok:
                return _failed(plan.status, plan.reason)
            # a leg begins where the one before ends
            legs.append(poses_of(plan, frame, goal)[bool(legs) :])
        return _Given(np.concatenate(legs))


def _failed(status: Status, reason: str) -> _Given:
    return _Given(error=_ERRORS.get(status, str(status)), reason=reason)
