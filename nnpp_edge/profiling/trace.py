"""A timeline as a file that Perfetto and chrome://tracing open: Chrome's trace events in JSON."""

import json
import os
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from nnpp_edge.profiling.sensors import Reading
from nnpp_edge.runtime.loop.messages import PathMessage, Span

MOST = 400_000
"""Events that a trace holds; older ones are dropped: about a hundred megabytes, ten minutes of ticks at 100 Hz."""
PLANNERS, LOOP = 1, 2
_THREADS = {PLANNERS: "planners", LOOP: "onboard loop"}
_NS = 1e9


class _Event(NamedTuple):
    name: str
    thread: int
    began_ns: int
    ended_ns: int
    facts: Mapping[str, object]


class Trace:
    """Collects spans in memory; `to_json` gives the file. Moments are seconds of `time.perf_counter`."""

    def __init__(self, process: str, most: int = MOST) -> None:
        self._process = process
        self._events: deque[_Event] = deque(maxlen=most)
        self._counters: deque[tuple[str, int, dict[str, float]]] = deque(maxlen=most)

    def span(
        self,
        name: str,
        began_s: float,
        ended_s: float,
        stages_ms: Mapping[str, float] | None = None,
        thread: int = PLANNERS,
        facts: Mapping[str, object] | None = None,
    ) -> None:
        """Add what ran from one moment to another, and its stages, laid end to end from its begin in their order.

        The clock of a plan keeps each stage's sum, not its moments; what no stage counts stays bare at the end.
        """
        began, ended = round(_NS * began_s), round(_NS * ended_s)
        self._events.append(_Event(name, thread, began, ended, facts or {}))
        at = began
        for stage, ms in (stages_ms or {}).items():
            until = min(at + round(1e6 * ms), ended)
            if stage != "total":
                self._events.append(_Event(stage, thread, at, until, {}))
                at = until

    def tick(self, message: PathMessage, spans: Sequence[Span]) -> None:
        """Add a tick of the loop with its parts, the whole first; its answer is told with it."""
        whole, *parts = spans
        names = ("outcome", "origin", "method", "choice", "reason", "map_version")
        answer = {name: getattr(message, name) for name in names}
        self.span(f"tick {message.tick}", whole.began_s, whole.ended_s, None, LOOP, answer)
        for part in parts:
            self.span(part.name, part.began_s, part.ended_s, part.stages_ms, LOOP)

    def sensors(self, readings: Iterable[Reading]) -> None:
        """Add curves of the clocks and temperatures."""
        for reading in readings:
            at, clocks = round(_NS * reading.at_s), {f"core {core}": mhz for core, mhz in reading.clock_mhz.items()}
            for name, values in (("clock MHz", clocks), ("temperature °C", reading.temperature_c)):
                if values:
                    self._counters.append((name, at, values))

    def to_json(self) -> bytes:
        """The file: complete events ("X") in microseconds from the first one, counters ("C"), names of threads."""
        process = os.getpid()
        zero = min((at for at in (*(e.began_ns for e in self._events), *(c[1] for c in self._counters))), default=0)
        named = {"ph": "M", "pid": process, "tid": 0}
        events: list[dict[str, object]] = [{**named, "name": "process_name", "args": {"name": self._process}}]
        for thread in sorted({event.thread for event in self._events}):
            events.append({**named, "tid": thread, "name": "thread_name", "args": {"name": _THREADS[thread]}})
        for event in sorted(self._events, key=lambda each: (each.began_ns, -each.ended_ns)):
            place = {"ph": "X", "pid": process, "tid": event.thread, "ts": (event.began_ns - zero) / 1e3}
            facts = {"args": event.facts} if event.facts else {}
            events.append({"name": event.name, **place, "dur": (event.ended_ns - event.began_ns) / 1e3, **facts})
        for name, at, values in self._counters:
            place = {"ph": "C", "pid": process, "tid": 0, "ts": (at - zero) / 1e3}
            events.append({"name": name, **place, "args": values})
        return json.dumps({"displayTimeUnit": "ms", "traceEvents": events}).encode()
