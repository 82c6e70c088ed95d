"""The loop's counters for Prometheus: over HTTP, or as a file for the node exporter's textfile collector.

One family for each counter of `Counters`, named ``nnpp_edge_…``. The work of a tick is a histogram. See https://prometheus.io/docs/instrumenting/exposition_formats/.
"""

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from nnpp_edge import __version__
from nnpp_edge.files import write_whole
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Counters

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_TOTALS = {
    "ticks": "Ticks of the loop.",
    "planned": "Ticks that planned a new path.",
    "kept": "Ticks whose path stood.",
    "failed": "Ticks without a path, though there were pose and goal.",
    "overruns": "Ticks that took longer than the period.",
    "skipped": "Deadlines that passed unused.",
    "patches": "Map patches taken in.",
    "cells_changed": "Cells that patches changed.",
    "patches_clipped": "Map patches that stuck out of the map.",
    "patches_rejected": "Map patches that were refused.",
    "patches_merged": "Changed rectangles that were taken together.",
    "starts_moved": "Ticks whose path starts beside the robot, which stood in an impassable cell.",
    "reloads": "Models that were loaded anew.",
}
_LABELLED = {
    "degraded": ("kind", "Answers that were less than asked for."),
    "errors": ("place", "Errors that were caught."),
    "drops": ("sink", "Messages that a sink was too slow for."),
    "lost": ("sink", "Messages that a sink took and could not keep."),
}


def metrics_text(counters: Counters) -> str:
    """The counters in Prometheus' text format."""
    lines = [*_family("build_info", "gauge", "The version that runs.", [({"version": __version__}, 1)])]
    for name, words in _TOTALS.items():
        lines += _family(f"{name}_total", "counter", words, [({}, getattr(counters, name))])
    for name, (label, words) in _LABELLED.items():
        counted = sorted(getattr(counters, name).items())
        lines += _family(f"{name}_total", "counter", words, [({label: kind}, count) for kind, count in counted])
    lines += _tick_seconds(counters)
    worst = 1e-3 * counters.tick_ms.get("max", 0.0)
    lines += _family("tick_seconds_max", "gauge", "Longest work of a tick.", [({}, worst)])
    memory = "Resident memory of the process."
    lines += _family("resident_memory_bytes", "gauge", memory, [({}, counters.rss_bytes)])
    return "\n".join(lines) + "\n"


def write_metrics(path: Path, counters: Counters) -> None:
    """Put the counters into a file, whole or not at all; OutputError if it cannot be written."""
    write_whole(Path(path), metrics_text(counters).encode())


class MetricsServer:
    """Serves ``/metrics`` for Prometheus and ``/health`` for whoever watches the process, from threads of its own.

    Health is 200 while the loop ticks and 503 once it has not for `stale_s` seconds, or cannot be asked.

    Parameters
    ----------
    port : int
        0 takes any that is free; see `port`.
    snapshot : callable
        The newest counters (`Loop.counters`); called from other threads, at each request.
    host : str
        Address to listen at; by default this machine alone can ask.
    stale_s : float
        Longer than the loop's period.

    Raises
    ------
    InvalidQueryError
        The address cannot be listened at.
    """

    def __init__(
        self, port: int, snapshot: Callable[[], Counters], host: str = "127.0.0.1", *, stale_s: float = 5.0
    ) -> None:
        self._snapshot, self._stale_s = snapshot, stale_s
        self._lock = threading.Lock()
        self._seen, self._seen_at = 0, time.monotonic()

        class Handler(_Handler):
            owner = self

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InvalidQueryError(f"metrics cannot be served at {host}:{port} ({reason})") from error
        self._server.daemon_threads = True
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

    def __enter__(self) -> "MetricsServer":
        """The server."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

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
        now = time.monotonic()
        with self._lock:
            if ticks != self._seen:
                self._seen, self._seen_at = ticks, now
            rests_s = now - self._seen_at
        if rests_s > self._stale_s:
            return 503, CONTENT_TYPE, f"stalled: no tick for {rests_s:.1f} s, after {ticks}\n"
        return 200, CONTENT_TYPE, f"ok: {ticks} ticks\n"


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

    def log_message(self, *_: Any) -> None:
        """Requests are not worth a line."""


def _tick_seconds(counters: Counters) -> Iterable[str]:
    name = "nnpp_edge_tick_seconds"
    yield f"# HELP {name} Work of a tick."
    yield f"# TYPE {name} histogram"
    for bound, count in counters.tick_histogram.items():
        le = _number(1e-3 * float(bound)) if bound != "inf" else "+Inf"
        yield f'{name}_bucket{{le="{le}"}} {count}'
    yield f"{name}_sum {_number(counters.tick_sum_s)}"
    yield f"{name}_count {counters.tick_histogram.get('inf', 0)}"


def _family(name: str, kind: str, words: str, samples: Iterable[tuple[Mapping[str, str], float]]) -> Iterable[str]:
    yield f"# HELP nnpp_edge_{name} {words}"
    yield f"# TYPE nnpp_edge_{name} {kind}"
    for labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        yield f"nnpp_edge_{name}{'{' + inside + '}' if inside else ''} {_number(value)}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))
