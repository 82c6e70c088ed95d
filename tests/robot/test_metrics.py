import socket
import struct
import sys
import threading
import urllib.error
import urllib.request
from dataclasses import fields, replace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from nnpp_edge.robot.operations.metrics import CONTENT_TYPE, MetricsServer, metrics_text
from nnpp_edge.runtime.errors import InvalidQueryError, MissingExtraError
from nnpp_edge.runtime.loop.messages import Counters
from tests.robot.conftest import wait_until

COUNTERS = Counters(
    ticks=1000,
    planned=700,
    kept=290,
    failed=10,
    overruns=3,
    skipped=1,
    patches=77,
    cells_changed=12345,
    rss_bytes=123_456_789,
    tick_sum_s=2.0,
    degraded={"late": 2, "timeout": 5},
    errors={'sink "a\\b"\nc': 4},
    drops={"zenoh": 6},
    lost={"mcap": 8},
    tick_ms={"p50": 1.5, "p90": 3.0, "p99": 12.25, "max": 80.0, "mean": 2.0},
    tick_histogram={"1.024": 100, "16.384": 995, "inf": 999},
)


def parse(text):
    """By the library's own reader: {(name, labels): value}, and {family: type}."""
    families = list(text_string_to_metric_families(text))
    assert all(len(family.documentation) > 5 for family in families)
    samples = [sample for family in families for sample in family.samples]
    values = {(sample.name, tuple(sample.labels.items())): sample.value for sample in samples}
    assert len(values) == len(samples)
    return values, {family.name: family.type for family in families}


def test_every_counter_is_told_with_help_and_type():
    samples, types = parse(metrics_text(COUNTERS))
    for field in fields(Counters):
        value = getattr(COUNTERS, field.name)
        if isinstance(value, int) and field.name != "rss_bytes":
            assert samples[f"nnpp_edge_{field.name}_total", ()] == value
            assert types[f"nnpp_edge_{field.name}"] == "counter"
    labelled = {("degraded", "kind", "timeout"): 5, ("drops", "sink", "zenoh"): 6, ("lost", "sink", "mcap"): 8}
    for (name, label, kind), count in {**labelled, ("errors", "place", 'sink "a\\b"\nc'): 4}.items():
        assert samples[f"nnpp_edge_{name}_total", ((label, kind),)] == count
    assert samples["nnpp_edge_resident_memory_bytes", ()] == 123_456_789
    assert types["nnpp_edge_tick_seconds"] == "histogram"
    buckets = {dict(labels)["le"]: n for (name, labels), n in samples.items() if name.endswith("_bucket")}
    assert buckets == {"0.001024": 100, "0.016384": 995, "+Inf": 999}
    for name, value in (("sum", 2.0), ("count", 999), ("max", 0.08)):
        assert samples[f"nnpp_edge_tick_seconds_{name}", ()] == pytest.approx(value)
    assert parse(metrics_text(Counters()))[0]["nnpp_edge_ticks_total", ()] == 0


def get(server, path, method="GET"):
    request = urllib.request.Request(f"http://{server.host}:{server.port}{path}", method=method)
    try:
        with urllib.request.urlopen(request, timeout=5.0) as answer:
            return answer.status, answer.headers["Content-Type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read().decode()


def test_metrics_are_served():
    with MetricsServer(0, lambda: COUNTERS) as server:
        assert get(server, "/metrics") == (200, CONTENT_TYPE, metrics_text(COUNTERS))
        assert get(server, "/metrics?name[]=x")[0] == 200
        assert get(server, "/metrics", "HEAD") == (200, CONTENT_TYPE, "")
        assert get(server, "/")[0] == 404
        assert get(server, "/metrics", "POST")[0] == 501
        idle = socket.create_connection((server.host, server.port))  # says nothing, holds nobody up
        assert get(server, "/health")[0] == 200
        idle.close()
    with pytest.raises(OSError):
        get(server, "/metrics")


def test_connections_that_break_say_nothing(capsys):
    with MetricsServer(0, lambda: COUNTERS) as server:
        before = threading.active_count()
        for _ in range(5):
            broken = socket.create_connection((server.host, server.port))
            broken.sendall(b"GET /metrics")
            wait_until(lambda: threading.active_count() > before)
            broken.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset at the end
            broken.close()
            wait_until(lambda: threading.active_count() == before)
        assert get(server, "/health")[0] == 200
    assert capsys.readouterr().err == ""


def test_health_follows_the_ticks():
    counters, now = [Counters()], [100.0]
    with MetricsServer(0, lambda: counters[0], stale_s=0.15, clock=lambda: now[0]) as server:
        assert get(server, "/health")[0] == 200
        now[0] += 0.2
        status, _, body = get(server, "/health")
        assert status == 503 and body.startswith("stalled: no tick for 0.") and body.count("\n") == 1
        counters[0] = replace(counters[0], ticks=7)
        assert get(server, "/health")[::2] == (200, "ok: 7 ticks\n")
        counters.clear()  # they cannot be read any more
        assert get(server, "/health")[::2] == (503, "no counters: list index out of range\n")
        assert get(server, "/metrics")[0] == 503


def test_without_the_library_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(MissingExtraError, match=r"nnpp-edge\[robot\]"):
        MetricsServer(0, lambda: COUNTERS)


def test_an_address_that_is_taken_or_makes_no_sense_is_one_line():
    with (
        MetricsServer(0, lambda: COUNTERS) as server,
        pytest.raises(InvalidQueryError, match=f"127.0.0.1:{server.port}"),
    ):
        MetricsServer(server.port, lambda: COUNTERS)
    for address in ((70000, "127.0.0.1"), (0, "256.1.1.1.1")):
        with pytest.raises(InvalidQueryError, match="metrics cannot be served at"):
            MetricsServer(address[0], lambda: COUNTERS, host=address[1])
