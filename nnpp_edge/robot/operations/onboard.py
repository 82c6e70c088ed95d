"""Putting the onboard loop together: world, input, sinks, and what watches over it."""

import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.robot.operations.metrics import serving_metrics
from nnpp_edge.robot.operations.systemd import Notifier
from nnpp_edge.robot.operations.wiring import REPLAY, STDIN, STDOUT, ZENOH, Wiring
from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.mcap_log import McapLog
from nnpp_edge.robot.transports.recording import RecordedSource, RecordingFile, ReplaySource
from nnpp_edge.robot.transports.rerun_view import RerunSink
from nnpp_edge.robot.transports.stdio import StdioSink, StdioSource
from nnpp_edge.robot.transports.zenoh_io import LOOPBACK, ZenohLink, ZenohSink, ZenohSource
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.connections import InputSource, Sink
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Counters, Input, PathMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop, handling_signals
from nnpp_edge.runtime.loop.timing import Handler, signal_handlers
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState

_STARTING: dict[signal.Signals, Handler] = {
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGINT: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_IGN,
}
"""Until the loop runs there is nothing to finish: the system ends the process at once. A hangup
ends nothing.
"""


class SourceError(NnppEdgeError, RuntimeError):
    """Inputs can no longer be read."""


def run(
    ground: Ground,
    settings: NavigatorSettings,
    wiring: Wiring,
    pace: OnboardLoop,
    *,
    ticks: int | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Counters:
    """Load kernels and network, connect everything, and run the loop until it is stopped or its
    input ends.

    SIGTERM and SIGINT end it after the tick, as do so many `ticks`. For the main thread. Of `pace`
    rate, cores and priority count. `report` is called with a line for each thing that is started.
    SourceError where inputs can no longer be read.
    """
    with signal_handlers(_STARTING), ExitStack() as stack:
        notifier = stack.enter_context(closing(Notifier()))
        exercise()
        navigator = Navigator(ground, settings)
        source, sinks = _connected(stack, wiring, navigator)
        feed: InputSource = source
        observers, recorders = _observers(stack, wiring, navigator.map, report)
        if recorders:
            recorded = RecordedSource(source, recorders, navigator.count_error, wait=wiring.fast)
            feed = stack.enter_context(closing(recorded))
        sinks += [*observers, notifier]

        def after_tick(message: PathMessage) -> None:
            notifier.alive()
            if source.failure or (source.ended and not wiring.stay):
                loop.finish()

        loop = Loop(
            navigator,
            feed,
            sinks,
            rate_hz=pace.rate_hz,
            cores=pace.cores,
            priority=pace.priority,
            paced=not wiring.fast,
            after_tick=after_tick,
        )
        if wiring.metrics is not None:
            report(
                f"metrics: {stack.enter_context(serving_metrics(wiring.metrics, loop.counters))}"
            )
        with handling_signals(loop), stack:
            notifier.ready()
            rows, cols = navigator.map.shape
            report(f"ready: {settings.method} at {pace.rate_hz:g} Hz, {rows} × {cols} cells")
            counters = loop.run(ticks)
            notifier.stopping()
    if source.failure:
        raise SourceError(f"the input failed, and the loop has ended: {source.failure}")
    return counters


def _connected(
    stack: ExitStack, wiring: Wiring, navigator: Navigator
) -> tuple[MailboxSource | ReplaySource, list[Sink]]:
    """The source, and sinks for the answers; refused inputs are answered where they come from."""
    (kind, place), refusals, sinks = (
        wiring.input_kind,
        Refusals(navigator.count_error),
        list[Sink](),
    )
    link = None
    if ZENOH in (kind, *wiring.output_kinds):
        endpoint = next(iter(wiring.endpoints), LOOPBACK)
        link = ZenohLink(endpoint, connect=wiring.zenoh_connect, prefix=wiring.zenoh_prefix)
        stack.callback(link.close)
        if ZENOH in wiring.output_kinds:
            sinks.append(ZenohSink(link, refusals if kind == ZENOH else None))
    if STDOUT in wiring.output_kinds:
        sys.stdout.flush()
        sinks.append(StdioSink(refusals if kind == STDIN else None))
    if kind == REPLAY:
        return ReplaySource(Path(place), shape=navigator.map.shape, fast=wiring.fast), sinks
    if link is not None and kind == ZENOH:
        return ZenohSource(link, refusals, navigator.count_error), sinks
    return StdioSource(refusals), sinks


def _observers(
    stack: ExitStack, wiring: Wiring, state: MapState, report: Callable[[str], None]
) -> tuple[list[Sink], list[Callable[[Input, float], object]]]:
    """Further sinks for the answers, and recorders of the inputs."""
    sinks: list[McapLog | RerunSink] = []
    recorders: list[Callable[[Input, float], object]] = []
    if wiring.record is not None:
        recording = stack.enter_context(closing(RecordingFile(wiring.record, state.shape)))
        recorders.append(recording.record)
        report(f"recording: {recording.path}")
    if wiring.log is not None:
        log = stack.enter_context(closing(McapLog(wiring.log, state)))
        sinks.append(log)
        report(f"log: {log.path}")
    if wiring.view is not None:
        sinks.append(stack.enter_context(closing(RerunSink(wiring.view, state))))
    return list(sinks), [*recorders, *(sink.record for sink in sinks)]
