"""A timeline as a file that Perfetto and chrome://tracing open: Chrome's trace events in JSON."""

import json
import os
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from nnpp_edge.profiling.contest import Facts
from nnpp_edge.profiling.sensors import Reading
from nnpp_edge.runtime.loop.messages import PathMessage, Span

MOST = 400_000
"""Events that a trace holds; older ones are dropped: about a hundred megabytes, ten minutes of ticks at 100 Hz."""
_CURVES, PLANNERS, LOOP = 0, 1, 2
_THREADS = {PLANNERS: "planners", LOOP: "onboard loop"}
_NS = 1e9


class _Event(NamedTuple):
    began_ns: int
    ended_ns: int
    name: str
    thread: int
    facts: Mapping[str, object]


class Trace:
    """Collects spans in memory; `to_json` gives the file. Moments are seconds of `time.perf_counter`."""

    def __init__(self, process: str, most: int = MOST) -> None:
        self._process = process
        self._events: deque[_Event] = deque(maxlen=most)

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
        at, ended = round(_NS * began_s), round(_NS * ended_s)
        self._events.append(_Event(at, ended, name, thread, facts or {}))
        for stage, ms in (stages_ms or {}).items():
            if stage != "total":
                until = min(at + round(1e6 * ms), ended)
                self._events.append(_Event(at, until, stage, thread, {}))
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
            clocks = {f"core {core}": mhz for core, mhz in reading.clock_mhz.items()}
            for name, values in (("clock MHz", clocks), ("temperature °C", reading.temperature_c)):
                if values:
                    self.span(name, reading.at_s, reading.at_s, None, _CURVES, values)

    def to_json(self) -> bytes:
        """The file: complete events ("X") in microseconds from the first one, counters ("C"), names of threads."""
        process = {"pid": os.getpid()}
        zero = min((event.began_ns for event in self._events), default=0)
        threads = {0: ("process_name", self._process)}
        threads |= {at: ("thread_name", _THREADS[at]) for at in sorted({e.thread for e in self._events} - {_CURVES})}
        events: list[Facts] = [
            {**process, "ph": "M", "tid": thread, "name": kind, "args": {"name": name}}
            for thread, (kind, name) in threads.items()
        ]
        for event in sorted(self._events, key=lambda each: (each.began_ns, -each.ended_ns)):
            found = {**process, "name": event.name, "tid": event.thread, "ts": (event.began_ns - zero) / 1e3}
            found |= {"args": event.facts} if event.facts else {}
            found |= {"ph": "C"} if event.thread == _CURVES else {"dur": (event.ended_ns - event.began_ns) / 1e3}
            events.append({"ph": "X", **found})
        return json.dumps({"displayTimeUnit": "ms", "traceEvents": events}).encode()
