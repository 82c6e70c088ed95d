"""The loop on one map. Whoever begins and ends it is the node."""

import logging
import threading
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from nnpp_edge.robot.ros2 import in_a_line
from nnpp_edge.robot.ros2.answers import poses_of
from nnpp_edge.robot.ros2.frames import PoseInFrame
from nnpp_edge.robot.transports.mcap_log import is_rest
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.arrays import Cells
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import (
    Goal,
    Input,
    MapPatch,
    Output,
    PathMessage,
    Pose,
    StatusMessage,
)
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.node import PlannerNode

_LOG = logging.getLogger(__name__)
_IDLE = (Status.OK, Status.NO_GOAL)
_ODD = ("overruns", "degraded", "errors")
"""Counters that are told as a warning where they have grown."""
_PATIENCE_S = 5.0
"""For the loop's last tick."""


class Session:
    """A loop on one map, its source and its sink: poses and goals are put in the map's cells, and a
    path goes out when it is another one and once a second, the rest once a second.

    What can fail fails while it is made: the session before goes on then.
    """

    name = "ros"

    def __init__(self, node: "PlannerNode", navigator: Navigator, frame: MapFrame) -> None:
        self.navigator = navigator
        self.frame = frame
        self.failure = ""
        """Why the loop has ended by itself; empty while it has not."""
        self._listener = node.listener
        self._outlet = node.outlet
        self._patches = Mailbox()
        self._robot: PoseInFrame | None = None
        self._goal: PoseInFrame | None = None
        """That the loop has."""
        self._newest: tuple[PoseInFrame | None, PathMessage | None] = (None, None)
        """The goal of the newest answer, and that."""
        self._trouble = ""
        """Which input is too old to go by."""
        self._walked: Cells | None = None
        """As published; None where the next path is to be published, whatever it is."""
        self._shown_version = -1
        self._odd: list[object] = [0, {}, {}]
        self._publishing = threading.Lock()
        self._ended = False
        self._questions = node.questions
        settings = node.settings
        self._loop = Loop(
            navigator,
            self,
            [self],
            rate_hz=settings.rate_hz,
            cores=settings.cores,
            priority=settings.priority,
            after_tick=self._note,
        )
        self._thread = threading.Thread(target=self._run, name="nnpp-edge loop", daemon=True)
        self.begin = self._thread.start

    @property
    def runs(self) -> bool:
        """Whether its answers go out."""
        return self._thread.is_alive() and not self._ended

    def covers(self, grid: OccupancyGrid) -> bool:
        """Whether a grid has the cells of the map."""
        return grid.frame == self.frame and grid.data.shape == self.navigator.map.shape

    def put(self, patch: MapPatch) -> None:
        """Change the map; where too many patches wait the oldest is dropped, and counted."""
        for _ in range(self._patches.put(patch, when_full="drop oldest")):
            self.navigator.count_error("input dropped")

    def answer_to(self, goal: PoseInFrame) -> PathMessage | None:
        """The newest answer, if it is one to this goal."""
        asked, answer = self._newest
        return answer if asked is goal else None

    def hush(self) -> None:
        """Publish nothing more, once this returns."""
        with self._publishing:
            self._ended = True

    def end(self) -> bool:
        """Publish nothing more, and end the loop; whether its last tick ended in time."""
        self.hush()
        self._loop.stop()
        if self._thread.is_alive():
            self._thread.join(_PATIENCE_S)
        return not self._thread.is_alive()

    # --- in the loop's thread, and its sink's

    def poll(self) -> Iterator[Input]:
        """The newest pose and goal, looked for again after each patch. Without a pose or a map that
        is new enough, the loop's pose is forgotten.
        """
        yield from self._moved()
        for patch in self._patches.read():
            yield patch
            yield from self._moved()

    def _moved(self) -> Iterator[Input]:
        robot = self._listener.robot
        goal = self._listener.goal
        frame = self.frame
        self._trouble = self._listener.overdue()
        if self._trouble:
            self.navigator.forget(goal=False)
            self._robot = None
        elif robot is not None and robot is not self._robot:
            self._robot = robot
            row, col = frame.places((robot.x, robot.y))[0].tolist()
            yield Pose(row, col, heading_deg=frame.heading_deg(robot.yaw_rad))
        if goal is not None and goal is not self._goal:
            self._goal = goal
            yield Goal(*frame.cell(goal.x, goal.y), heading_deg=frame.heading_deg(goal.yaw_rad))

    def _note(self, message: PathMessage) -> None:
        """After each tick: whose answer it was."""
        self._newest = (self._goal, message)
        self._questions.after_tick(self)

    def publish(self, message: Output) -> None:
        """Publish an answer."""
        with self._publishing:
            if self._ended:
                return
            if isinstance(message, StatusMessage):
                self._walked = None
                self._publish_state(message)
                return
            if not is_rest(message.walked, self._walked):
                self._outlet.path(poses_of(message, self.frame, self._listener.goal))
            self._walked = message.walked

    def _publish_state(self, message: StatusMessage) -> None:
        """How it is: an error without a path, a warning where ticks were late, answers degraded or
        errors caught since the last one; then the map.
        """
        counts = asdict(message.counters)
        odd = [counts[name] for name in _ODD]
        level = "OK" if odd == self._odd else "WARN"
        if message.outcome not in _IDLE:
            level = "ERROR"
        self._odd = odd
        text = f"{message.outcome}: {self._trouble}" if self._trouble else message.text
        values = {"outcome": message.outcome, "refused": self._listener.refused, **counts}
        self._outlet.diagnose(level, text, values)
        state = self.navigator.map
        if state.log.version != self._shown_version and self._outlet.costs(state, self.frame):
            self._shown_version = state.log.version

    def _run(self) -> None:
        try:
            self._loop.run()
        except Exception as error:
            _LOG.exception("the loop has ended")
            self.failure = f"the loop has ended: {in_a_line(error)}"
            self.hush()
            self._outlet.stop(self.failure)
