"""The loop's counters for Prometheus, over HTTP.

Each counter of `Counters` is a family named ``nnpp_edge_…``. The work of a tick is a histogram.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, get_type_hints

from nnpp_edge import __version__
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.loop.messages import Counters
from nnpp_edge.runtime.reading import refused_as

if TYPE_CHECKING:
    from prometheus_client import CollectorRegistry, Metric

HOST = "127.0.0.1"
"""Only this machine can connect."""


@contextmanager
def serving_metrics(port: int, snapshot: Callable[[], Counters]) -> Iterator[str]:
    """Serve the counters from threads of their own; gives the address. Port 0 is any free one.

    `snapshot` gives the newest counters (`Loop.counters`) at each request. InvalidQueryError where
    the address cannot be listened at, MissingExtraError without `prometheus-client`.
    """
    registry = metrics_registry(snapshot)
    from prometheus_client import start_http_server

    with refused_as(InvalidQueryError, f"metrics cannot be served at {HOST}:{port}"):
        server, thread = start_http_server(port, HOST, registry)
    try:
        yield f"http://{HOST}:{server.server_port}/metrics"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def metrics_registry(snapshot: Callable[[], Counters]) -> "CollectorRegistry":
    """The counters of the moment at which they are asked for; MissingExtraError without
    `prometheus-client`.
    """
    registry: CollectorRegistry = optional_module(
        "prometheus_client",
        "metrics",
        "robot",
    ).CollectorRegistry()

    class Snapshot:
        def collect(self) -> "Iterator[Metric]":
            return _families(snapshot())

    registry.register(Snapshot())
    return registry


def _families(counters: Counters) -> "Iterator[Metric]":
    """Every counter, the histogram of ticks, memory and the version."""
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
        for label, number in sorted(count.items()) if labels else [("", count)]:
            family.add_metric([label] * len(labels), number)
        yield family

    buckets = []
    for ms, count in (counters.tick_histogram or {"inf": 0}).items():
        bound = "+Inf" if ms == "inf" else repr(1e-3 * float(ms))
        buckets.append((bound, float(count)))
    tick = "nnpp_edge_tick_seconds"
    yield HistogramMetricFamily(
        tick,
        "Work of a tick.",
        buckets=buckets,
        sum_value=counters.tick_sum_s,
    )
    longest_s = 1e-3 * counters.tick_ms.get("max", 0.0)
    yield GaugeMetricFamily(f"{tick}_max", "Longest work of a tick.", value=longest_s)
    words = "Resident memory of the process."
    yield GaugeMetricFamily("nnpp_edge_resident_memory_bytes", words, value=counters.rss_bytes)
