"""Putting the onboard loop together: world, input, sinks, and what watches over it."""

import logging
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.trace import Trace
from nnpp_edge.robot.operations.metrics import MetricsFile, MetricsServer
from nnpp_edge.robot.operations.systemd import Notifier
from nnpp_edge.robot.operations.wiring import REPLAY, STDIN, STDOUT, ZENOH, Wiring, kind_and_place
from nnpp_edge.robot.transports.mcap_log import McapLog
from nnpp_edge.robot.transports.recording import EndingSource, RecordedSource, RecordingFile, ReplaySource
from nnpp_edge.robot.transports.refusals import Refusals
from nnpp_edge.robot.transports.rerun_view import RerunSink
from nnpp_edge.robot.transports.stdio import StdioSink, StdioSource
from nnpp_edge.robot.transports.wire import Fault
from nnpp_edge.robot.transports.zenoh_io import LOOPBACK, ZenohLink, ZenohSink, ZenohSource
from nnpp_edge.runtime.errors import NnppEdgeError, OutputError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Counters, Input, Output, PathMessage, StatusMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.realtime import Handler, signal_handlers
from nnpp_edge.runtime.loop.runner import Loop, handling_signals
from nnpp_edge.runtime.loop.sinks import Sink
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState

_LOG = logging.getLogger(__name__)
_STARTING: dict[signal.Signals, Handler] = {
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGINT: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_IGN,
}
"""Until the loop runs there is nothing to finish, and nothing to reload: the system ends the process at once."""

Record = Callable[[Input, float], None]
"""Called with an input and the seconds since the loop began."""


class SourceError(NnppEdgeError, RuntimeError):
    """Inputs can no longer be read."""


@dataclass(frozen=True)
class Pace:
    """When and where the loop runs; as for `Loop`."""

    rate_hz: float = 17.0
    cores: tuple[int, ...] = ()
    priority: int = 0


def run(
    ground: Ground,
    settings: NavigatorSettings,
    wiring: Wiring,
    pace: Pace,
    *,
    ticks: int | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Counters:
    """Load kernels and network, connect everything, and run the loop until it is stopped or its input ends.

    SIGTERM and SIGINT end it after the tick, as do so many `ticks`; SIGHUP reloads the model. For the main thread.
    `report` is called with a line for each thing that is started.

    Raises
    ------
    SourceError
        Inputs could no longer be read.
    """
    with signal_handlers(_STARTING), ExitStack() as stack:
        notifier = stack.enter_context(Notifier())
        exercise()
        navigator = Navigator(ground, settings)
        link = None
        if wiring.uses_zenoh:
            endpoint = wiring.endpoint or LOOPBACK
            link = stack.enter_context(ZenohLink(endpoint, connect=wiring.zenoh_connect, prefix=wiring.zenoh_prefix))
        sinks, answer_fault = _answer_sinks(wiring, link)
        source = _input_source(wiring, navigator, link, answer_fault)
        observers, records = _observers(stack, wiring, navigator.map, ground.sides_m[0], report)
        if records:
            source = stack.enter_context(RecordedSource(source, records, navigator.count_error, wait=wiring.fast))
        metrics = None if wiring.metrics_file is None else MetricsFile(wiring.metrics_file)
        observers += [_Statuses("systemd", lambda status: notifier.status(status.text))]
        if metrics is not None:
            observers += [_Statuses("metrics", lambda status: metrics.keep(status.counters))]

        trace = None if wiring.trace is None else Trace("nnpp-edge run")

        def after_tick(message: PathMessage) -> None:
            notifier.alive()
            if trace is not None:
                trace.tick(message, loop.spans)
            if source.failure or (source.ended and not wiring.stay):
                loop.finish()

        loop = Loop(
            navigator,
            source,
            [*sinks, *observers],
            rate_hz=pace.rate_hz,
            cores=pace.cores,
            priority=pace.priority,
            paced=not wiring.fast,
            after_tick=after_tick,
        )
        if wiring.metrics_port is not None:
            server = stack.enter_context(MetricsServer(wiring.metrics_port, loop.counters))
            report(f"metrics: http://{server.host}:{server.port}/metrics")
        with handling_signals(loop), stack:
            notifier.ready()
            rows, cols = navigator.map.shape
            report(f"ready: {settings.method} at {pace.rate_hz:g} Hz, {rows} × {cols} cells")
            counters = loop.run(ticks)
            notifier.stopping()
            if metrics is not None:
                metrics.keep(counters)
            if wiring.trace is not None and trace is not None:
                _write_trace(wiring.trace, trace)
    if source.failure:
        raise SourceError(f"the input failed, and the loop has ended: {source.failure}")
    return counters


def _write_trace(path: Path, trace: Trace) -> None:
    """Write it, or say why not: as a log's, its loss costs the run nothing."""
    try:
        write_whole(path, trace.to_json())
    except OutputError as error:
        _LOG.warning("the trace is lost: %s", error)


class _Statuses:
    """Passes status messages to a function."""

    def __init__(self, name: str, use: Callable[[StatusMessage], object]) -> None:
        self.name, self._use = name, use

    def publish(self, message: Output) -> None:
        if isinstance(message, StatusMessage):
            self._use(message)


def _answer_sinks(wiring: Wiring, link: ZenohLink | None) -> tuple[list[Sink], Callable[[Fault], None] | None]:
    """Sinks for the answers, and how to answer a refused input, if its sender can be reached."""
    sinks: dict[str, StdioSink | ZenohSink] = {}
    """By the input whose sender each reaches."""
    if STDOUT in wiring.output_kinds:
        sys.stdout.flush()
        sinks[STDIN] = StdioSink(framing=wiring.framing)
    if ZENOH in wiring.output_kinds:
        assert link is not None
        sinks[ZENOH] = ZenohSink(link)
    back = sinks.get(kind_and_place(wiring.input)[0])
    return list(sinks.values()), None if back is None else back.answer


def _input_source(
    wiring: Wiring, navigator: Navigator, link: ZenohLink | None, answer_fault: Callable[[Fault], None] | None
) -> EndingSource:
    kind, place = kind_and_place(wiring.input)
    refusals = Refusals(navigator.count_error, answer_fault)
    if kind == REPLAY:
        return ReplaySource(Path(place), shape=navigator.map.shape, fast=wiring.fast)
    if kind == STDIN:
        return StdioSource(refusals, framing=wiring.framing)
    assert link is not None
    return ZenohSource(link, refusals, navigator.count_error)


def _observers(
    stack: ExitStack, wiring: Wiring, state: MapState, cell_size_m: float, report: Callable[[str], None]
) -> tuple[list[Sink], list[Record]]:
    """Further sinks for the answers, and recorders of the inputs."""
    sinks: list[Sink] = []
    records: list[Record] = []
    if wiring.record is not None:
        recording = stack.enter_context(RecordingFile(wiring.record, state.shape))
        records.append(recording.record)
        report(f"recording: {recording.path}")
    if wiring.log is not None:
        log = stack.enter_context(McapLog(wiring.log, state=state, cell_size_m=cell_size_m))
        sinks.append(log)
        records.append(lambda message, at_s: log.record(message))
    if wiring.view is not None:
        view = stack.enter_context(RerunSink.at(wiring.view, state))
        sinks.append(view)
        records.append(lambda message, at_s: view.record(message))
    return sinks, records
