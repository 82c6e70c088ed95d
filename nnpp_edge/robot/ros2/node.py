"""The node and its life cycle: configured, active, and back."""

import logging
import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from nnpp_edge.robot.ros2.answers import Outlets, RosSink
from nnpp_edge.robot.ros2.grounds import Located, first_ground, ground_of_grid, vehicle_by
from nnpp_edge.robot.ros2.inputs import RosSource
from nnpp_edge.robot.ros2.parameters import Parameters, declare, followed, values_of
from nnpp_edge.robot.ros2.questions import Copies, Questions
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.messages import Counters, PathMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop

_DONE = TransitionCallbackReturn.SUCCESS
_FAILED = TransitionCallbackReturn.FAILURE
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

    def __init__(self, name: str = "nnpp_edge", **options: Any) -> None:
        super().__init__(name, **options)
        declare(self)
        self._own = Parameters()
        self.add_post_set_parameters_callback(self._follow)
        self._outlets: Outlets | None = None
        self._source: RosSource | None = None
        self._questions: Questions | None = None
        self._navigator: Navigator | None = None
        self._frame: MapFrame | None = None
        self._by_topic = False
        self._running: tuple[Loop, threading.Thread] | None = None
        self._uncounted = 0
        """Errors of inputs that came before there was a loop to count them."""

    # --- transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read what parameters say, load kernels and map, and declare the topics that go out."""
        try:
            self._own = Parameters.of(values_of(self))
            exercise()
            _ = vehicle_by(self._own)
            located = first_ground(self._own)
            self._by_topic = located is None
            if located is not None:
                self._take(located)
        except NnppEdgeError as error:
            self.get_logger().error(f"cannot be configured: {error}")
            return _FAILED
        self._outlets = Outlets(self)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and begin the loop once there is a map."""
        done = super().on_activate(state)
        self._source = RosSource(self, lambda: self._own, self._on_grid, self._count_error)
        self._questions = Questions(self, lambda: self._own, self._source)
        self._begin()
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

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As a shutdown; the node may be configured again."""
        self._end()
        self._give_back()
        return _DONE

    # --- the loop

    @property
    def counters(self) -> Counters:
        """Of the loop that runs; those of a new one where none does."""
        return self._running[0].counters() if self._running else Counters()

    def _take(self, located: Located) -> None:
        """Plan on this map from now on."""
        ground, frame = located
        self._navigator = Navigator(ground, **self._own.loop.planning())
        self._frame = frame

    def _begin(self) -> None:
        """Run the loop in a thread of its own, where there is a map."""
        navigator = self._navigator
        if navigator is None or self._frame is None:
            self.get_logger().info("waiting for a map on the topic map")
            return
        source = self._source
        questions = self._questions
        outlets = self._outlets
        assert source is not None and questions is not None and outlets is not None
        source.begin(navigator, self._frame, by_topic=self._by_topic)
        sink = RosSink(outlets, source, navigator.map)
        copies = Copies(navigator)
        questions.begin(sink, copies)

        def after_tick(message: PathMessage) -> None:
            copies.after_tick()

        pace = self._own.loop.pace()
        loop = Loop(navigator, source, [sink], **pace, after_tick=after_tick)
        thread = threading.Thread(target=loop.run, name="nnpp-edge loop", daemon=True)
        self._running = (loop, thread)
        thread.start()
        rows, cols = navigator.map.shape
        self.get_logger().info(
            f"ready: {self._own.method} at {self._own.rate_hz:g} Hz, {rows} × {cols} cells of "
            f"{self._frame.resolution:g} m in {self._frame.frame_id}"
        )

    def _end_loop(self) -> None:
        if self._running is None:
            return
        loop, thread = self._running
        loop.stop()
        thread.join(_PATIENCE_S)
        self._running = None
        if self._navigator is not None:
            self._navigator.forget()

    def _end(self) -> None:
        """End the loop and all that comes in."""
        self._end_loop()
        for each in (self._questions, self._source):
            if each is not None:
                each.close()
        self._questions = None
        self._source = None
        if self._outlets is not None:
            self._outlets.publish_path(np.empty((0, 4)), self._own.global_frame)

    def _give_back(self) -> None:
        if self._outlets is not None:
            self._outlets.close()
        self._outlets = None
        self._navigator = None
        self._frame = None

    def _on_grid(self, grid: OccupancyGrid) -> None:
        """A map of other cells has come: the loop begins anew on it."""
        located = ground_of_grid(grid, self._own)
        self._end_loop()
        self._take(located)
        self._begin()

    def _follow(self, changes: list[Any]) -> None:
        """Go by what may be changed while the loop runs."""
        self._own = followed(self._own, self)

    def _count_error(self, place: str) -> None:
        if self._navigator is None:
            self._uncounted += 1
        else:
            self._navigator.count_error(place)


class _ToRos(logging.Handler):
    """Hands on what the package logs to the node's log."""

    def __init__(self, node: PlannerNode) -> None:
        super().__init__()
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        line = self.format(record)
        (self._logger.error if record.levelno >= logging.ERROR else self._logger.warning)(line)


def run(arguments: Sequence[str]) -> int:
    """Run the node until it is told to end, by a signal or a shutdown of ROS; the exit code.

    `arguments` are ROS' own, as ``--ros-args -p rate_hz:=10``.
    """
    rclpy.init(args=["nnpp-edge", *arguments], signal_handler_options=SignalHandlerOptions.NO)
    node = PlannerNode()
    handler = _ToRos(node)
    log = logging.getLogger("nnpp_edge")
    log.addHandler(handler)
    stopping = threading.Event()
    for each in (signal.SIGTERM, signal.SIGINT):
        signal.signal(each, lambda number, frame: stopping.set())
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    failed = False
    try:
        if node.get_parameter("autostart_node").value:
            failed = any(
                change() != _DONE for change in (node.trigger_configure, node.trigger_activate)
            )
        while not (failed or stopping.is_set()):
            executor.spin_once(timeout_sec=0.1)
            time.sleep(_PAUSE_S)
    except ExternalShutdownException:
        pass
    finally:
        with suppress(Exception):  # it has been shut down by another node
            node.trigger_shutdown()
        executor.shutdown()
        node.destroy_node()
        log.removeHandler(handler)
        rclpy.try_shutdown()
    return 2 if failed else 0
