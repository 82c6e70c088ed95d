"""The node and its life cycle: configured, active, and back."""

import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import rclpy
from msgspec.structs import replace
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.robot.ros2.answers import RosSink
from nnpp_edge.robot.ros2.frames import Frames
from nnpp_edge.robot.ros2.grounds import Located, first_ground, ground_of
from nnpp_edge.robot.ros2.inputs import RosSource
from nnpp_edge.robot.ros2.parameters import LIVE, Own, checked, declare, values_of
from nnpp_edge.robot.ros2.questions import Questions
from nnpp_edge.ros.maps import OccupancyGrid
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.ladder import one_line
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop

_DONE = TransitionCallbackReturn.SUCCESS
_PATIENCE_S = 5.0
"""For the loop's last tick."""
_PAUSE_S = 0.002
"""Between two callbacks: of a topic that floods us the newest message is taken, some hundred a
second, and the loop's thread is not held up.
"""


class PlannerNode(LifecycleNode):
    """The loop as a lifecycle node.

    Configuring reads the parameters, the vehicle, the map and the kernels; while it is active the
    loop runs on the topics; deactivating ends the loop after its tick, publishes an empty path, and
    forgets the goal, but not the map.
    """

    def __init__(self) -> None:
        super().__init__("nnpp_edge")
        declare(self)
        self.own = Own()
        """What it was configured with."""
        self._pace = OnboardLoop()
        self.frames = Frames(self)
        self.add_post_set_parameters_callback(self._follow)
        self._by_topic = False
        self._located: Located | None = None
        self._navigator: Navigator | None = None
        self._sink: RosSink | None = None
        self._inputs: tuple[RosSource, Questions] | None = None
        """While it is active."""
        self._running: tuple[Loop, threading.Thread] | None = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read what parameters say, load kernels and map, and declare the topics that go out."""
        try:
            self.own, self._pace = checked(values_of(self))
            located = first_ground(self.own)
            exercise()
            self._by_topic = located is None
            if located is not None:
                self._take(located)
        except NnppEdgeError as error:
            self.get_logger().error(f"cannot be configured: {error}")
            return TransitionCallbackReturn.FAILURE
        self._sink = RosSink(self)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and begin the loop once there is a map."""
        assert self._sink is not None
        done = super().on_activate(state)
        source = RosSource(self, self._on_grid)
        self._inputs = (source, Questions(self, source, self._sink))
        if self._navigator is None:
            self.get_logger().info("waiting for a map on the topic map")
        else:
            self._begin(self._navigator)
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop, stop who follows its path, and listen no more."""
        self._end()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give all back that was configured."""
        self._give_back()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop, and give all back."""
        self._end()
        self._give_back()
        return super().on_shutdown(state)

    # --- the loop

    def _take(self, located: Located) -> Navigator:
        """Plan on this map from now on."""
        self._located = located
        self._navigator = Navigator(located[0], **self._pace.planning())
        return self._navigator

    def _begin(self, navigator: Navigator) -> None:
        """Run the loop in a thread of its own."""
        assert self._inputs is not None and self._sink is not None and self._located is not None
        source, questions = self._inputs
        frame = self._located[1]
        source.begin(navigator, frame, by_topic=self._by_topic)
        self._sink.begin(source, navigator.map)
        questions.begin(navigator)
        loop = Loop(
            navigator,
            source,
            [self._sink],
            **self._pace.pace(),
            after_tick=lambda message: questions.after_tick(),
        )
        thread = threading.Thread(target=loop.run, name="nnpp-edge loop", daemon=True)
        self._running = (loop, thread)
        thread.start()
        shape = navigator.map.shape
        self.get_logger().info(f"ready: {self._pace.rate_hz:g} Hz, a map of {shape} cells")

    def _end_loop(self) -> None:
        if self._running is not None and self._navigator is not None:
            loop, thread = self._running
            loop.stop()
            thread.join(_PATIENCE_S)
            self._navigator.forget()
        self._running = None

    def _end(self) -> None:
        """End the loop and all that comes in."""
        ran = self._running is not None
        self._end_loop()
        for each in self._inputs or ():
            each.close()
        if ran and self._sink is not None:
            self._sink.publish_path(np.empty((0, 4)))
        self._inputs = None

    def _give_back(self) -> None:
        if self._sink is not None:
            self._sink.close()
        self._sink = self._navigator = self._located = None

    def _on_grid(self, grid: OccupancyGrid) -> None:
        """A map of other cells has come: the loop begins anew on it."""
        located = ground_of(self.own, grid.cost(), grid.frame)
        self._end_loop()
        self._begin(self._take(located))

    def _follow(self, changes: list[Ros]) -> None:
        """Go by what may be changed while the loop runs."""
        live = {each.name: float(each.value) for each in changes if each.name in LIVE}
        self.own = replace(self.own, **live)


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
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    changes = [node.trigger_configure, node.trigger_activate]
    if not node.get_parameter("autostart_node").value:
        changes = []
    failed = any(change() != _DONE for change in changes)
    with suppress(ExternalShutdownException):
        while not (failed or stopping.is_set()):
            executor.spin_once(timeout_sec=0.1)
            time.sleep(_PAUSE_S)
    with suppress(Exception):  # another has shut it down
        node.trigger_shutdown()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return 2 if failed else 0
