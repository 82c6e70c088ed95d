"""Putting the onboard loop together: world, source, sinks, and what watches over it."""

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nnpp_edge.profiling.profile_file import OnboardLoop
from nnpp_edge.robot.transports.mailbox import Refusals
from nnpp_edge.robot.transports.recording import EndingSource, RecordedSource, RecordingFile, ReplaySource
from nnpp_edge.robot.transports.stdio import StdioSink, StdioSource
from nnpp_edge.robot.transports.wire import Fault
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Counters, Input, Output, PathMessage, StatusMessage
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop, handling_signals
from nnpp_edge.runtime.loop.sinks import Sink
from nnpp_edge.runtime.loop.world import World
from nnpp_edge.runtime.warmup import exercise

if TYPE_CHECKING:
    from nnpp_edge.robot.transports.zenoh_io import ZenohLink

STDIN, REPLAY, ZENOH, STDOUT, NONE = "stdin", "replay", "zenoh", "stdout", "none"


@dataclass(frozen=True)
class Wiring:
    """What the loop is connected to.

    Raises
    ------
    InvalidQueryError
        Input or outputs are unknown, or do not go together.
    """

    input: str = STDIN
    """``stdin``, ``replay:FILE``, or ``zenoh`` or ``zenoh:ENDPOINT``."""
    outputs: tuple[str, ...] = ()
    """``stdout``, ``zenoh[:ENDPOINT]`` or ``none``; empty: ``zenoh`` for input from there, else ``stdout``."""
    framing: str = "lines"
    """Of stdin and stdout."""
    zenoh_connect: str | None = None
    """Go to this endpoint instead of listening."""
    zenoh_prefix: str = "nnpp_edge"
    fast: bool = False
    """Replay without waiting: each tick gets the inputs of one recorded tick, and follows the one before at once."""
    stay: bool = False
    """Go on when stdin is closed, or the replay is over."""
    record: Path | None = None
    log: Path | None = None
    metrics_port: int | None = None
    metrics_file: Path | None = None
    view: str | None = None
    """Where rerun shows map and path, as for `RerunSink.at`."""

    def __post_init__(self) -> None:
        """Check."""
        kind, place = _split(self.input)
        if kind not in (STDIN, REPLAY, ZENOH) or (kind == STDIN and place) or (kind == REPLAY and not place):
            raise InvalidQueryError(f"input must be stdin, replay:FILE or zenoh[:ENDPOINT], got {self.input!r}")
        if self.fast and kind != REPLAY:
            raise InvalidQueryError(f"only a replay can be fast, got input {self.input!r}")
        kinds = self.output_kinds
        if not set(kinds) <= {STDOUT, ZENOH, NONE} or len(set(kinds)) < len(kinds):
            raise InvalidQueryError(
                f"outputs must be different ones of stdout, zenoh[:ENDPOINT] or none, got {', '.join(self.outputs)}"
            )
        if NONE in kinds and len(kinds) > 1:
            raise InvalidQueryError(f"output none goes with no other, got {', '.join(self.outputs)}")
        if len(self._endpoints) > 1:
            raise InvalidQueryError(f"input and output must name one endpoint, got {', '.join(self._endpoints)}")

    @property
    def output_kinds(self) -> tuple[str, ...]:
        """Without endpoints."""
        if self.outputs:
            return tuple(_split(output)[0] for output in self.outputs)
        return (ZENOH if _split(self.input)[0] == ZENOH else STDOUT,)

    @property
    def endpoint(self) -> str | None:
        """Zenoh's, where one is named."""
        return next(iter(self._endpoints), None)

    @property
    def _endpoints(self) -> list[str]:
        named = [_split(text) for text in (self.input, *self.outputs)]
        return sorted({place for kind, place in named if kind == ZENOH and place})


def run(
    world: World, loop: OnboardLoop, wiring: Wiring, *, ticks: int | None = None, cell_size_m: float = 1.0,
    tell: Callable[[str], None] = lambda line: None,
) -> Counters:  # fmt: skip
    """Load kernels and network, connect everything, and run the loop until it is stopped or its input ends.

    SIGTERM and SIGINT end it after the tick, SIGHUP reloads the model. For the main thread.

    Parameters
    ----------
    world : World
        The map at the begin.
    loop : OnboardLoop
        Rate and planner.
    wiring : Wiring
        Inputs, outputs and observers.
    ticks : int
        End after so many.
    cell_size_m : float
        Side of a cell, for logs.
    tell : callable
        Told in a line what has begun.

    Returns
    -------
    Counters
        What was done.
    """
    from nnpp_edge.robot.operations.systemd import Notifier

    with ExitStack() as stack:
        stack.enter_context(_stopping_quietly())
        notifier = Notifier()
        stack.callback(notifier.close)
        exercise()
        settings = NavigatorSettings(
            method=loop.method, model=loop.model, tolerance=loop.tolerance, corner_cutting=loop.corner_cutting
        )
        navigator = Navigator(world, settings)
        link = stack.enter_context(_linked(wiring))
        sinks, answer = _outputs(wiring, link)
        source = _source(wiring, world, navigator, link, answer)
        observers, recorders = _observers(stack, wiring, world, cell_size_m, tell)
        if recorders:
            recorded = RecordedSource(source, recorders, navigator.count_error)
            stack.callback(recorded.close)
            source = recorded
        observers.append(_StatusSink("systemd", lambda status: notifier.status(status.text)))

        def after_tick(message: PathMessage) -> None:
            notifier.alive()
            if source.ended and not wiring.stay:
                running.stop()

        running = Loop(
            navigator, source, [*sinks, *observers], rate_hz=loop.rate_hz, cores=loop.cores, priority=loop.priority,
            paced=not wiring.fast, after_tick=after_tick,
        )  # fmt: skip
        _serve_metrics(stack, wiring, running, tell)
        with handling_signals(running):
            notifier.ready()
            tell(f"ready: {loop.method} at {loop.rate_hz:g} Hz, {world.shape[0]} × {world.shape[1]} cells")
            counters = running.run(ticks)
            notifier.stopping()
        if wiring.metrics_file is not None:
            _write_metrics(wiring.metrics_file, counters)
        return counters


class _StatusSink:
    """Passes status messages to a function."""

    def __init__(self, name: str, told: Callable[[StatusMessage], object]) -> None:
        self.name, self._told = name, told

    def publish(self, message: Output) -> None:
        if isinstance(message, StatusMessage):
            self._told(message)


def _outputs(wiring: Wiring, link: "ZenohLink | None") -> tuple[list[Sink], Callable[[Fault], None] | None]:
    """Sinks for the answers, and the way back to whoever sends inputs, if they are connected to it."""
    sinks: dict[str, Any] = {}
    if STDOUT in wiring.output_kinds:
        sys.stdout.flush()
        sinks[STDIN] = StdioSink(framing=wiring.framing)  # by the input that it is the way back for
    if ZENOH in wiring.output_kinds:
        from nnpp_edge.robot.transports.zenoh_io import ZenohSink

        assert link is not None
        sinks[ZENOH] = ZenohSink(link)
    back = sinks.get(_split(wiring.input)[0])
    return list(sinks.values()), None if back is None else back.answer


def _source(
    wiring: Wiring, world: World, navigator: Navigator, link: "ZenohLink | None",
    answer: Callable[[Fault], None] | None,
) -> EndingSource:  # fmt: skip
    kind, place = _split(wiring.input)
    refusals = Refusals(navigator.count_error, answer)
    if kind == REPLAY:
        return ReplaySource(Path(place), shape=world.shape, fast=wiring.fast)
    if kind == STDIN:
        return StdioSource(refusals, framing=wiring.framing)
    from nnpp_edge.robot.transports.zenoh_io import ZenohSource

    assert link is not None
    return ZenohSource(link, refusals, navigator.count_error)


@contextmanager
def _linked(wiring: Wiring) -> "Iterator[ZenohLink | None]":
    """The session, where Zenoh is asked for."""
    if ZENOH not in (_split(wiring.input)[0], *wiring.output_kinds):
        yield None
        return
    from nnpp_edge.robot.transports.zenoh_io import LOOPBACK, ZenohLink

    link = ZenohLink(wiring.endpoint or LOOPBACK, connect=wiring.zenoh_connect, prefix=wiring.zenoh_prefix)
    try:
        yield link
    finally:
        link.close()


Recording = Callable[[Input, float], None]


def _observers(
    stack: ExitStack, wiring: Wiring, world: World, cell_size_m: float, tell: Callable[[str], None]
) -> tuple[list[Sink], list[Recording]]:
    """Who else gets the answers, and who gets the inputs."""
    sinks: list[Sink] = []
    recorders: list[Recording] = []
    if wiring.record is not None:
        recorder = RecordingFile(wiring.record, world.shape)
        stack.callback(recorder.close)
        recorders.append(recorder.record)
        tell(f"recording: {recorder.path}")
    if wiring.log is not None:
        from nnpp_edge.robot.transports.mcap_log import McapLog

        log = stack.enter_context(McapLog(wiring.log, world=world, cell_size_m=cell_size_m))
        sinks.append(log)
        recorders.append(lambda message, at_s: log.record(message))
    if wiring.view is not None:
        from nnpp_edge.robot.transports.rerun_view import RerunSink

        view = stack.enter_context(RerunSink.at(wiring.view, world))
        sinks.append(view)
        recorders.append(lambda message, at_s: view.record(message))
    if (file := wiring.metrics_file) is not None:
        _write_metrics(file, Counters())  # at the begin, so that a name that cannot be written is told now
        sinks.append(_StatusSink("metrics", lambda status: _write_metrics(file, status.counters)))
    return sinks, recorders


def _write_metrics(path: Path, counters: Counters) -> None:
    from nnpp_edge.robot.operations.metrics import write_metrics

    write_metrics(path, counters)


def _serve_metrics(stack: ExitStack, wiring: Wiring, loop: Loop, tell: Callable[[str], None]) -> None:
    if wiring.metrics_port is not None:
        from nnpp_edge.robot.operations.metrics import MetricsServer

        server = stack.enter_context(MetricsServer(wiring.metrics_port, loop.counters))
        tell(f"metrics: http://{server.host}:{server.port}/metrics")


@contextmanager
def _stopping_quietly() -> Iterator[None]:
    """Before the loop runs, SIGTERM ends the process with exit code 0, and SIGHUP has nothing to reload."""
    before = {
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(0)),
        signal.SIGHUP: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _split(text: str) -> tuple[str, str]:
    kind, _, place = text.partition(":")
    return kind, place


def summary(counters: Counters) -> str:
    """The counters for people; what never happened is left out."""
    c = counters
    lines = {"ticks": f"{c.ticks}: {c.planned} planned, {c.kept} kept, {c.failed} without a path"}
    if c.tick_ms:
        lines["tick"] = ", ".join(f"{name} {ms:.2f} ms" for name, ms in c.tick_ms.items())
    if c.overruns or c.skipped:
        lines["late"] = f"{c.overruns} overruns, {c.skipped} deadlines skipped"
    for name, counts in (("degraded", c.degraded), ("errors", c.errors), ("dropped", c.drops), ("lost", c.lost)):
        if shown := [f"{where} {count}" for where, count in counts.items() if count]:
            lines[name] = ", ".join(shown)
    if c.patches:
        odd = {"clipped": c.patches_clipped, "rejected": c.patches_rejected, "merged": c.patches_merged}
        shown = [f"{count} {what}" for what, count in odd.items() if count]
        lines["patches"] = ", ".join([f"{c.patches} ({c.cells_changed} cells changed)", *shown])
    if c.reloads:
        lines["reloads"] = str(c.reloads)
    lines["memory"] = f"{c.rss_bytes / 1e6:.0f} MB"
    return "\n".join(f"{name:<10}{value}" for name, value in lines.items())


def summary_json(counters: Counters) -> str:
    """The counters for programs."""
    from dataclasses import asdict

    return json.dumps(asdict(counters))
