"""The trace file by its structure: what Perfetto needs to show it."""

import json

import numpy as np
import pytest

from nnpp_edge.profiling.sensors import Reading
from nnpp_edge.profiling.trace import Trace
from nnpp_edge.runtime.loop.connections import InProcessSource
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Goal, MapPatch, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.loop.runner import Loop
from nnpp_edge.runtime.map.ground import Ground
from tests.profiling.traces import check_trace, spans_of, within


def test_stages_lie_end_to_end_inside_their_call():
    trace = Trace("test")
    trace.span("a call", 10.0, 10.005, {"search": 2.0, "path": 1.0, "total": 3.0}, facts={"expansions": 7})
    call, search, path = check_trace(trace.to_json())
    assert (call["ts"], call["dur"], call["args"]) == (0.0, 5000.0, {"expansions": 7})
    assert [(each["name"], each["ts"], each["dur"]) for each in (search, path)] == [
        ("search", 0.0, 2000.0),
        ("path", 2000.0, 1000.0),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_stages_that_a_coarser_clock_made_too_long_still_nest(seed):
    rng, trace, at = np.random.default_rng(seed), Trace("test"), 1234.5
    for _ in range(50):
        stages = dict(zip("abcd", rng.exponential(1.0, 4), strict=True))
        ended = at + 1e-3 * sum(stages.values()) * rng.uniform(0.9, 1.2)
        trace.span("a call", at, ended, stages)
        at = ended
    assert len(check_trace(trace.to_json())) == 250


def test_a_trace_of_endless_work_keeps_the_newest():
    trace = Trace("test", most=10)
    assert check_trace(trace.to_json()) == []
    for at in range(100):
        trace.span(str(at), float(at), at + 0.5)
    assert [each["name"] for each in check_trace(trace.to_json())] == [str(at) for at in range(90, 100)]


def test_sensors_are_curves():
    trace = Trace("test")
    trace.sensors([Reading(2.0, {"0": 1800.0}, {"cpu 0": 61.5}), Reading(3.0)])
    curves = [each for each in json.loads(trace.to_json())["traceEvents"] if each["ph"] == "C"]
    assert [(each["name"], each["args"]) for each in curves] == [
        ("clock MHz", {"core 0": 1800.0}),
        ("temperature °C", {"cpu 0": 61.5}),
    ]


def test_the_ticks_of_a_loop_and_their_stages():
    source, trace = InProcessSource(), Trace("test")
    navigator = Navigator(Ground(np.full((60, 80), 0.2, np.float32)), NavigatorSettings(method="corridor"))
    source.put(Pose(5, 5))
    source.put(Goal(50, 70))
    ticks = []

    def after_tick(message):
        ticks.append(message)
        trace.tick(message, loop.spans)
        source.put(MapPatch(0, 30 + message.tick, cost=np.full((40, 2), np.inf)))

    loop = Loop(navigator, source, rate_hz=100.0, after_tick=after_tick)
    loop.run(4)
    events = check_trace(trace.to_json())
    wholes = spans_of(events, "tick")
    assert [each["name"] for each in wholes] == ["tick 1", "tick 2", "tick 3", "tick 4"]
    for whole, message in zip(wholes, ticks, strict=True):
        inside = [each["name"] for each in within(events, whole)]
        assert inside[:2] == ["inputs", "map"] and inside[-1] == "publish"
        assert whole["args"]["outcome"] == "OK" and whole["args"]["map_version"] == message.map_version
        if message.origin != "standing":
            assert "plan by corridor" in inside and {"coarse", "search", "path"} <= set(inside)
    assert any("plan by corridor" in each["name"] for each in events)
