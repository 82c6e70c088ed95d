"""Watching beside the clock while planners run: what others take, what the sensors say, and the trace."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from nnpp_edge.profiling.machine import CoreTimes
from nnpp_edge.profiling.sensors import SensorLog
from nnpp_edge.profiling.trace import Trace


class Disturbance:
    """Time of others while the planners were measured, in one half of the run."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = CoreTimes(cores)
        self._wall_s = self._worked_s = 0.0

    def start(self) -> None:
        """Start or resume the watch."""
        self.cores.start()
        self._wall_s -= time.perf_counter()
        self._worked_s -= time.thread_time()

    def stop(self) -> None:
        """Pause the watch."""
        self._worked_s += time.thread_time()
        self._wall_s += time.perf_counter()
        self.cores.stop()

    def leave_out(self, wall_s: float, worked_s: float) -> None:
        """Leave out a call in which this thread may have waited for threads of its own."""
        self._wall_s -= wall_s
        self._worked_s -= worked_s

    def waited_share(self) -> float:
        """Share of its time that this thread stood still though it had work to do: beyond its processor time."""
        return max(1.0 - self._worked_s / self._wall_s, 0.0) if self._wall_s > 0.0 else 0.0

    def share(self) -> float:
        """The greater of both signs: the planners stood still, or others ran on the cores."""
        return max(self.waited_share(), self.cores.others_share() or 0.0)


@dataclass
class Instruments:
    """Instruments that are read between the measured calls; none by default."""

    sensors: SensorLog | None = None
    trace: Trace | None = field(default=None)

    def read(self, disturbance: Disturbance) -> None:
        """Read the sensors if it is time; that counts neither as work nor as waiting."""
        if self.sensors is None or not self.sensors.due():
            return
        began, worked = time.perf_counter(), time.thread_time()
        self.sensors.read()
        disturbance.leave_out(time.perf_counter() - began, time.thread_time() - worked)
