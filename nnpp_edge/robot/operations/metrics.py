"""The loop's counters for Prometheus: over HTTP, or as a file for the node exporter's textfile collector.

Each counter of `Counters` is a family named ``nnpp_edge_…``. The work of a tick is a histogram.
"""

import errno
import logging
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, get_type_hints

from nnpp_edge import __version__
from nnpp_edge.files import write_whole
from nnpp_edge.robot.closing import Closing
from nnpp_edge.runtime.errors import InvalidQueryError, MissingExtraError, OutputError
from nnpp_edge.runtime.loop.messages import Counters
from nnpp_edge.runtime.loop.sinks import FailureLog

if TYPE_CHECKING:
    from prometheus_client import Metric

_LOG = logging.getLogger(__name__)
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def metrics_text(counters: Counters) -> str:
    """The counters in Prometheus' text format; MissingExtraError where `prometheus-client` is not installed."""
    try:
        from prometheus_client import CollectorRegistry, generate_latest
        from prometheus_client.registry import Collector
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"metrics need {error.name}: pip install 'nnpp-edge[robot]'") from error

    class Snapshot(Collector):
        def collect(self) -> "Iterator[Metric]":
            return _families(counters)

    registry = CollectorRegistry()
    registry.register(Snapshot())
    return generate_latest(registry).decode()


def write_metrics(path: Path, counters: Counters) -> None:
    """Put the counters into a file, whole or not at all; OutputError if it cannot be written."""
    write_whole(Path(path), metrics_text(counters).encode())


class MetricsFile:
    """Keeps the counters in a file. A full disk is told once, and never ends the loop.

    OutputError if the file cannot be written for another reason, at the beginning.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._failures = path, FailureLog("keeping the metrics")
        try:
            write_metrics(path, Counters())
        except OutputError as error:
            if getattr(error.__cause__, "errno", None) not in (errno.ENOSPC, errno.EDQUOT):
                raise
            self._failures.failed(error)

    def keep(self, counters: Counters) -> None:
        """Put these into the file, or leave it as it is."""
        try:
            write_metrics(self._path, counters)
        except OutputError as error:
            self._failures.failed(error)
        else:
            self._failures.worked()


class MetricsServer(Closing):
    """Serves ``/metrics`` for Prometheus and ``/health`` for supervisors, from threads of its own.

    Health is 200 while the loop ticks, and 503 if it has not ticked for `stale_s` seconds, which are longer than its
    period, or its counters cannot be read. `snapshot` gives the newest counters (`Loop.counters`) at each request. By
    default only this machine can connect; port 0 is any free one, see `port`. InvalidQueryError where the address
    cannot be listened at, MissingExtraError without `prometheus-client`.
    """

    def __init__(
        self,
        port: int,
        snapshot: Callable[[], Counters],
        host: str = "127.0.0.1",
        *,
        stale_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        metrics_text(Counters())  # fails here where the library is missing, not at the first request
        self._snapshot, self._stale_s, self._clock = snapshot, stale_s, clock
        self._lock = threading.Lock()
        self._seen, self._seen_at = 0, clock()

        class Handler(_Handler):
            owner = self

        try:
            self._server = _Server((host, port), Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InvalidQueryError(f"metrics cannot be served at {host}:{port} ({reason})") from error
        self.host, self.port = host, int(self._server.server_address[1])
        """Where it listens."""
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="nnpp-edge metrics", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def answer(self, path: str) -> tuple[int, str, str]:
        """HTTP status, content type and body for a path."""
        try:
            counters = self._snapshot()
        except Exception as error:
            return 503, CONTENT_TYPE, " ".join(f"no counters: {error}".split()) + "\n"
        if path == "/metrics":
            return 200, CONTENT_TYPE, metrics_text(counters)
        if path == "/health":
            return self._health(counters.ticks)
        return 404, CONTENT_TYPE, "wanted /metrics or /health\n"

    def _health(self, ticks: int) -> tuple[int, str, str]:
        now = self._clock()
        with self._lock:
            if ticks != self._seen:
                self._seen, self._seen_at = ticks, now
            silent_s = now - self._seen_at
        if silent_s > self._stale_s:
            return 503, CONTENT_TYPE, f"stalled: no tick for {silent_s:.1f} s, after {ticks}\n"
        return 200, CONTENT_TYPE, f"ok: {ticks} ticks\n"


class _Server(ThreadingHTTPServer):
    """A connection that breaks is closed in silence."""

    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        _LOG.debug("a request from %s broke off", client_address, exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    owner: MetricsServer
    timeout = 5.0
    server_version = "nnpp-edge"

    def do_GET(self) -> None:
        status, kind, body = self.owner.answer(self.path.partition("?")[0])
        content = body.encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        """Log no requests."""


def _families(counters: Counters) -> "Iterator[Metric]":
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

    build = GaugeMetricFamily("nnpp_edge_build_info", "The version that runs.", labels=["version"])
    build.add_metric([__version__], 1)
    yield build
    for name, kind in get_type_hints(Counters, include_extras=True).items():
        words, *labels = getattr(kind, "__metadata__", ("",))
        if not words:
            continue
        family = CounterMetricFamily(f"nnpp_edge_{name}", words, labels=labels)
        count = getattr(counters, name)
        if not labels:
            family.add_metric([], count)
        else:
            for label, number in sorted(count.items()):
                family.add_metric([label], number)
        yield family
    bounds = counters.tick_histogram or {"inf": 0}
    buckets = [("+Inf" if ms == "inf" else repr(1e-3 * float(ms)), float(count)) for ms, count in bounds.items()]
    seconds, words = "nnpp_edge_tick_seconds", "Work of a tick."
    yield HistogramMetricFamily(seconds, words, buckets=buckets, sum_value=counters.tick_sum_s)
    longest_s = 1e-3 * counters.tick_ms.get("max", 0.0)
    yield GaugeMetricFamily(f"{seconds}_max", "Longest work of a tick.", value=longest_s)
    yield GaugeMetricFamily(
        "nnpp_edge_resident_memory_bytes", "Resident memory of the process.", value=counters.rss_bytes
    )
