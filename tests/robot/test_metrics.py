"""The counters as Prometheus reads them."""

import socket
import urllib.parse
import urllib.request
from dataclasses import fields, replace

import pytest
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from nnpp_edge.robot.operations.metrics import metrics_registry, serving_metrics
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Counters

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


def metrics_text(counters):
    return generate_latest(metrics_registry(lambda: counters)).decode()


def test_every_counter_is_told_with_help_and_type():
    samples, types = parse(metrics_text(COUNTERS))
    for field in fields(Counters):
        value = getattr(COUNTERS, field.name)
        if isinstance(value, int) and field.name != "rss_bytes":
            assert samples[f"nnpp_edge_{field.name}_total", ()] == value
            assert types[f"nnpp_edge_{field.name}"] == "counter"
    for name, label, kind, count in (
        ("degraded", "kind", "timeout", 5),
        ("drops", "sink", "zenoh", 6),
        ("lost", "sink", "mcap", 8),
        ("errors", "place", 'sink "a\\b"\nc', 4),
    ):
        assert samples[f"nnpp_edge_{name}_total", ((label, kind),)] == count
    assert samples["nnpp_edge_resident_memory_bytes", ()] == 123_456_789
    assert types["nnpp_edge_tick_seconds"] == "histogram"
    buckets = {
        dict(labels)["le"]: n for (name, labels), n in samples.items() if name.endswith("_bucket")
    }
    assert buckets == {"0.001024": 100, "0.016384": 995, "+Inf": 999}
    for name, value in (("sum", 2.0), ("count", 999), ("max", 0.08)):
        assert samples[f"nnpp_edge_tick_seconds_{name}", ()] == pytest.approx(value)
    assert parse(metrics_text(Counters()))[0]["nnpp_edge_ticks_total", ()] == 0


def get(address):
    with urllib.request.urlopen(address, timeout=5.0) as answer:
        return answer.read().decode()


def test_the_newest_counters_are_served():
    counters = [COUNTERS]
    with serving_metrics(0, lambda: counters[0]) as address:
        assert get(address) == metrics_text(COUNTERS)
        place = urllib.parse.urlsplit(address)
        idle = socket.create_connection((place.hostname, place.port))  # says nothing
        counters[0] = replace(COUNTERS, ticks=1001)
        assert parse(get(address))[0]["nnpp_edge_ticks_total", ()] == 1001
        idle.close()
    with pytest.raises(OSError):
        get(address)


@pytest.mark.parametrize("taken", [True, False])
def test_a_port_that_is_taken_or_makes_no_sense_is_one_line(taken):
    with serving_metrics(0, lambda: COUNTERS) as address:
        port = urllib.parse.urlsplit(address).port if taken else 70000
        words = f"metrics cannot be served at 127.0.0.1:{port}"
        with pytest.raises(InvalidQueryError, match=words), serving_metrics(port, lambda: COUNTERS):
            pass
