"""The node and its life cycle: configured, active, and back."""

import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from nnpp_edge.robot.ros2 import Ros, in_a_line
from nnpp_edge.robot.ros2.answers import Outlet
from nnpp_edge.robot.ros2.frames import Frames
from nnpp_edge.robot.ros2.grounds import first_ground, ground_of
from nnpp_edge.robot.ros2.inputs import Listener
from nnpp_edge.robot.ros2.parameters import Own, checked, declare, values_of
from nnpp_edge.robot.ros2.questions import Questions
from nnpp_edge.robot.ros2.session import Session
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.errors import InvalidQueryError, one_line
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.settings import OnboardLoop

_DONE = TransitionCallbackReturn.SUCCESS
_TELL_EVERY_S = 1.0
"""That no loop runs."""
_PAUSE_S = 0.002
"""Between two callbacks of an executor that looks at all topics before each: of a topic that floods
us the newest message is taken, some hundred a second, and the loop's thread is not held up.
"""


class PlannerNode(LifecycleNode):
    """The loop as a lifecycle node.

    Configuring reads the parameters, the vehicle, the map and the kernels; while it is active the
    loop runs on the topics; deactivating ends the loop after its tick, publishes an empty path, and
    forgets the goal, but not the map.
    """

    outlet: Outlet
    """While it is configured."""
    listener: Listener
    questions: Questions
    """While it is active, as `_timer`."""

    def __init__(self) -> None:
        super().__init__("nnpp_edge")
        declare(self)
        self.own = Own()
        self.settings = OnboardLoop()
        """What it was configured with."""
        self.frames = Frames(self)
        self._kept: tuple[Navigator, MapFrame] | None = None
        """For the loop that begins next; None while it runs, and where the topic of maps is to say.
        """
        self._session: Session | None = None
        self._timer: Ros = None

    @property
    def session(self) -> Session | None:
        """The loop that runs; None while there is none."""
        return self._session if self._session and self._session.runs else None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read what parameters say, load kernels and map, and declare the topics that go out."""
        try:
            self.own, self.settings = checked(values_of(self))
            exercise()
            self._kept = self._first()
        except Exception as error:
            self.get_logger().error(f"cannot be configured: {in_a_line(error)}")
            return TransitionCallbackReturn.FAILURE
        self.outlet = Outlet(self)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and begin the loop once there is a map."""
        done = super().on_activate(state)
        self.listener = Listener(self)
        self.questions = Questions(self)
        self._timer = self.create_timer(_TELL_EVERY_S, self.tell_idle)
        if kept := self._kept or self._first():
            self._begin(*kept)
        self._kept = None
        self.tell_idle()
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop, stop who follows its path, and listen no more."""
        if self._timer is not None:
            session = self._session
            if session is not None:
                session.hush()
            self.outlet.path(np.empty((0, 4)))
            self.destroy_timer(self._timer)
            self.listener.close()
            self.questions.close()
            self._timer = self._session = None
            if session is not None and session.end():
                session.navigator.forget()
                self._kept = (session.navigator, session.frame)
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop, and give all back that was configured."""
        self.on_deactivate(state)
        if hasattr(self, "outlet"):
            self.outlet.close()
        self._kept = None
        return _DONE

    on_cleanup = on_error = on_shutdown

    def begin_on(self, grid: OccupancyGrid) -> None:
        """Run the loop on this map of costs from now on."""
        self._begin(self.settings.navigator(ground_of(self.own, grid)), grid.frame)

    def tell_idle(self) -> None:
        """Where no loop runs, publish an empty path, and why."""
        if self.session is None:
            ended = self._session.failure if self._session else ""
            why = (ended or "waiting for a map", self.listener.refused)
            self.outlet.stop("; ".join(filter(None, why)))

    def _first(self) -> tuple[Navigator, MapFrame] | None:
        """As the parameters say, which are checked by it."""
        located = first_ground(self.own)
        return located and (self.settings.navigator(located[0]), located[1])

    def _begin(self, navigator: Navigator, frame: MapFrame) -> None:
        """The loop before ends once all is made for this one."""
        made = Session(self, navigator, frame)
        if self._session is not None:
            self._session.end()
        made.begin()
        self._session = made
        shape = navigator.map.shape
        self.get_logger().info(f"ready: {self.settings.rate_hz:g} Hz, a map of {shape} cells")


def _executor() -> tuple[Ros, float]:
    """The best that the distribution has, and the seconds to sleep between two callbacks."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before ROS 2 Kilted
        return SingleThreadedExecutor(), _PAUSE_S
    return EventsExecutor(), 0.0


def run(arguments: Sequence[str]) -> int:
    """Run the node until it is told to end, by a signal or a shutdown of ROS; the exit code.

    `arguments` are ROS' own, as ``--ros-args -p rate_hz:=10``; InvalidQueryError for others.
    """
    try:
        rclpy.init(args=["nnpp-edge", *arguments], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InvalidQueryError(f"ROS takes no such arguments: {one_line(error)}") from None
    node = PlannerNode()
    stopping = threading.Event()
    for each in (signal.SIGTERM, signal.SIGINT):
        signal.signal(each, lambda number, frame: stopping.set())
    executor, pause_s = _executor()
    executor.add_node(node)
    changes = [node.trigger_configure, node.trigger_activate]
    if not node.get_parameter("autostart_node").value:
        changes = []
    failed = any(change() != _DONE for change in changes)
    try:
        with suppress(ExternalShutdownException):
            while not (failed or stopping.is_set()):
                executor.spin_once(timeout_sec=0.1)
                time.sleep(pause_s)
    finally:
        with suppress(Exception):  # another has shut it down
            node.trigger_shutdown()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return 2 if failed else 0
