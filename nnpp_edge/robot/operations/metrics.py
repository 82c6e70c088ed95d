"""The loop's counters for Prometheus, over HTTP.

Each counter of `Counters` is a family named ``nnpp_edge_…``. The work of a tick is a histogram.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, get_type_hints

from nnpp_edge import __version__
from nnpp_edge.robot.closing import Closing
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.loop.messages import Counters

if TYPE_CHECKING:
    from prometheus_client import Metric

_LOG = logging.getLogger(__name__)
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def metrics_text(counters: Counters) -> str:
    """The counters in Prometheus' text format; MissingExtraError where `prometheus-client` is not installed."""
    client = optional_module("prometheus_client", "metrics", "robot")

    class Snapshot:
        def collect(self) -> "Iterator[Metric]":
            return _families(counters)

    registry = client.CollectorRegistry()
    registry.register(Snapshot())
    return str(client.generate_latest(registry).decode())


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
        handler = type("Handler", (_Handler,), {"owner": self})
        try:
            self._server = _Server((host, port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InvalidQueryError(f"metrics cannot be served at {host}:{port} ({reason})") from error
        self.host, self.port = host, int(self._server.server_address[1])
        """Where it listens."""
        serve = self._server.serve_forever
        self._thread = threading.Thread(target=serve, args=(0.1,), name="nnpp-edge metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def answer(self, path: str) -> tuple[int, str]:
        """HTTP status and body for a path."""
        try:
            counters = self._snapshot()
        except Exception as error:
            return 503, " ".join(f"no counters: {error}".split()) + "\n"
        if path == "/metrics":
            return 200, metrics_text(counters)
        if path != "/health":
            return 404, "wanted /metrics or /health\n"
        ticks, now = counters.ticks, self._clock()
        with self._lock:
            if ticks != self._seen:
                self._seen, self._seen_at = ticks, now
            silent_s = now - self._seen_at
        if silent_s > self._stale_s:
            return 503, f"stalled: no tick for {silent_s:.1f} s, after {ticks}\n"
        return 200, f"ok: {ticks} ticks\n"


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
        status, body = self.owner.answer(self.path.partition("?")[0])
        content = body.encode()
        self.send_response(status)
        self.send_header("Content-Type", CONTENT_TYPE)
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
        family, count = CounterMetricFamily(f"nnpp_edge_{name}", words, labels=labels), getattr(counters, name)
        for label, number in sorted(count.items()) if labels else [("", count)]:
            family.add_metric([label] * len(labels), number)
        yield family
    bounds = counters.tick_histogram or {"inf": 0}
    buckets = [("+Inf" if ms == "inf" else repr(1e-3 * float(ms)), float(count)) for ms, count in bounds.items()]
    name, longest_s = "nnpp_edge_tick_seconds", 1e-3 * counters.tick_ms.get("max", 0.0)
    yield HistogramMetricFamily(name, "Work of a tick.", buckets=buckets, sum_value=counters.tick_sum_s)
    yield GaugeMetricFamily(f"{name}_max", "Longest work of a tick.", value=longest_s)
    memory = "nnpp_edge_resident_memory_bytes", "Resident memory of the process."
    yield GaugeMetricFamily(*memory, value=counters.rss_bytes)
