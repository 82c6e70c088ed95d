"""Putting the onboard loop together: world, transports, and what watches over it."""

import signal
from collections.abc import Callable
from contextlib import ExitStack, closing

from nnpp_edge.robot.operations.systemd import Notifier
from nnpp_edge.robot.transports.mcap_log import McapLog
from nnpp_edge.robot.transports.recording import RecordedSource, RecordingFile
from nnpp_edge.robot.transports.wiring import Setup, Wiring
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop.connections import Incoming, Recorder, Sink
from nnpp_edge.runtime.loop.messages import Counters, PathMessage
from nnpp_edge.runtime.loop.runner import Loop, handling_signals
from nnpp_edge.runtime.loop.settings import OnboardLoop
from nnpp_edge.runtime.loop.timing import Handler, signal_handlers
from nnpp_edge.runtime.map.ground import Ground

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
    wiring: Wiring,
    settings: OnboardLoop,
    *,
    ticks: int | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Counters:
    """Load kernels and network, connect everything, and run the loop until it is stopped or its
    input ends.

    SIGTERM and SIGINT end it after the tick, as do so many `ticks`. For the main thread. `report`
    is called with a line for each thing that is started. SourceError where inputs can no longer be
    read.
    """
    with signal_handlers(_STARTING), ExitStack() as stack:
        notifier = stack.enter_context(closing(Notifier()))
        exercise()
        navigator = settings.navigator(ground)

        # the source comes first: a sink answers the inputs that are refused there
        entry, place = wiring.source
        setup = Setup(wiring, navigator)
        source = stack.enter_context(closing(entry.open(place, setup)))
        assert isinstance(source, Incoming)
        setup = setup._replace(source=source)
        opened = [
            stack.enter_context(closing(entry.open(place, setup))) for entry, place in wiring.sinks
        ]
        sinks: list[Sink] = [each for each in opened if isinstance(each, Sink)]
        recorders: list[Recorder] = []
        if wiring.record is not None:
            recording = RecordingFile(wiring.record, navigator.map.shape)
            recorders.append(stack.enter_context(closing(recording)))
            report(f"recording: {recording.path}")
        if wiring.log is not None:
            log = stack.enter_context(closing(McapLog(wiring.log, navigator.map)))
            recorders.append(log)
            sinks.append(log)
            report(f"log: {log.path}")
        recorded = RecordedSource(source, recorders, navigator.count_error, wait=wiring.fast)
        feed = stack.enter_context(closing(recorded))

        def after_tick(message: PathMessage) -> None:
            notifier.alive()
            if source.failure or source.ended:
                loop.finish()

        loop = Loop(
            navigator,
            feed,
            [*sinks, notifier],
            rate_hz=settings.rate_hz,
            cores=settings.cores,
            priority=settings.priority,
            paced=not wiring.fast,
            after_tick=after_tick,
        )
        with handling_signals(loop), stack:
            notifier.ready()
            rows, cols = navigator.map.shape
            report(f"ready: {settings.method} at {settings.rate_hz:g} Hz, {rows} × {cols} cells")
            counters = loop.run(ticks)
            notifier.stopping()
    if source.failure:
        raise SourceError(f"the input failed, and the loop has ended: {source.failure}")
    return counters
