"""The loop on one map. Whoever ends it or begins another is the node."""

import logging
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.robot.ros2 import in_a_line
from nnpp_edge.robot.ros2.answers import Outlet, RosSink
from nnpp_edge.robot.ros2.frames import Place
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop

if TYPE_CHECKING:
    from nnpp_edge.robot.ros2.inputs import Listener

_LOG = logging.getLogger(__name__)
_PATIENCE_S = 5.0
"""For the loop's last tick."""


class Session:
    """A loop on a map, in whose cells poses and goals are put.

    What can fail fails while it is made, so that the session before goes on where it does. Once
    `end` is called, nothing of it goes out. `after_tick` is called in the loop's thread.
    """

    def __init__(
        self,
        navigator: Navigator,
        frame: MapFrame,
        listener: "Listener",
        outlet: Outlet,
        pace: OnboardLoop,
        after_tick: Callable[["Session"], None],
    ) -> None:
        self.navigator = navigator
        self.frame = frame
        self.listener = listener
        self.trouble = ""
        """Which input is too old to go by, as `poll` last saw it; empty while none is."""
        self.failure = ""
        """Why the loop has ended by itself; empty while it has not."""
        self._outlet = outlet
        self._robot: Place | None = None
        self._goal: Place | None = None
        """That the loop has."""
        self._patches = Mailbox()
        self.sink = RosSink(outlet, self)
        self._loop = Loop(
            navigator,
            self,
            [self.sink],
            **pace.pace(),
            after_tick=lambda message: after_tick(self),
        )
        self._thread = threading.Thread(target=self._run, name="nnpp-edge loop", daemon=True)
        self.begin = self._thread.start

    @property
    def runs(self) -> bool:
        """Whether its answers go out."""
        return self._thread.is_alive() and not self.sink.ended

    def covers(self, grid: OccupancyGrid) -> bool:
        """Whether a grid has the cells of the map."""
        return grid.frame == self.frame and grid.data.shape == self.navigator.map.shape

    def put(self, patch: MapPatch) -> None:
        """Change the map; where too many patches wait, the oldest is dropped, and counted."""
        for _ in range(self._patches.put(patch, when_full="drop oldest")):
            self.navigator.count_error("input dropped")

    def poll(self) -> Iterator[Input]:
        """As of an `InputSource`: the newest pose and goal, also between patches. Without a pose or
        a map that is new enough, the loop's pose is forgotten.
        """
        yield from self._newest()
        for patch in self._patches.read():
            yield patch
            yield from self._newest()

    def end(self) -> bool:
        """Publish nothing more, and end the loop; whether its last tick ended in time."""
        self.sink.end()
        self._loop.stop()
        if self._thread.is_alive():
            self._thread.join(_PATIENCE_S)
        return not self._thread.is_alive()

    def _newest(self) -> Iterator[Input]:
        robot = self.listener.robot
        goal = self.listener.goal
        self.trouble = self.listener.overdue()
        if self.trouble:
            self.navigator.forget(goal=False)
            self._robot = None
        elif robot is not None and robot is not self._robot:
            self._robot = robot
            row, col = self.frame.places((robot.x, robot.y))[0].tolist()
            yield Pose(row, col, heading_deg=self.frame.heading_deg(robot.yaw_rad))
        if goal is not None and goal is not self._goal:
            self._goal = goal
            heading = self.frame.heading_deg(goal.yaw_rad)
            yield Goal(*self.frame.cell(goal.x, goal.y), heading_deg=heading)

    def _run(self) -> None:
        try:
            self._loop.run()
        except Exception as error:
            _LOG.exception("the loop has ended")
            self.failure = f"the loop has ended: {in_a_line(error)}"
            self.sink.end()
            self._outlet.stop(self.failure)
