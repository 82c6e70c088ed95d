"""The onboard loop: its rate, its messages, its map, its ladder, and what it does when things
around it fail.
"""

import gc
import itertools
import math
import os
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import (
    Goal,
    Ground,
    InProcessSink,
    InProcessSource,
    Loop,
    MapPatch,
    Method,
    Navigator,
    NetworkModel,
    Origin,
    PathMessage,
    Plan,
    Planner,
    Pose,
    Status,
    StatusMessage,
    Traversability,
    Vehicle,
    handling_signals,
)
from nnpp_edge.runtime.loop import workers
from nnpp_edge.runtime.loop.patches import Patches
from nnpp_edge.runtime.loop.timing import Histogram, Ticker
from nnpp_edge.runtime.map.state import map_state
from tests.strategies import flat, state_of


class Clock:
    """Time that passes only by sleeping, which ends `late` seconds late."""

    def __init__(self):
        self.now = 100.0
        self.late = 0.0
        self.slept = []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        assert seconds > 0.0
        self.slept.append(seconds)
        self.now += seconds + self.late


def free(shape=(40, 60)):
    return np.full(shape, 0.2, np.float32)


def one_cell(cell, cost):
    """A patch of one cell of a path."""
    return MapPatch(*map(int, cell), cost=np.full((1, 1), cost))


def navigator(cost=None, start=(5, 5), goal=(35, 55), **settings):
    nav = Navigator(Ground(free() if cost is None else cost), **settings)
    nav.offer(Pose(*start))
    nav.offer(Goal(*goal))
    return nav


def check(message, cost):
    """Cell by cell, by the definition: what is published as a path can be walked."""
    assert message.ok == bool(len(message.path))
    if message.ok:
        assert (tuple(message.path[0]), tuple(message.path[-1])) == (message.start, message.goal)
        assert all(cost[row, col] < 1.0 for row, col in message.path)
        assert (np.abs(np.diff(message.path, axis=0)).max(axis=1) == 1).all()


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Kernels are there before anything is timed."""
    nav = navigator()
    for col in (10, 55):
        nav.tick()
        nav.offer(MapPatch(10, col, cost=free((2, 2)) + 0.1))


# --- time


def test_a_late_tick_does_not_move_the_next():
    clock = Clock()
    ticker = Ticker(0.1, clock=clock, sleep=clock.sleep)
    starts = []
    for work in (0.03, 0.0999, 0.12, 0.01, 0.37, 0.02):
        starts.append(clock.now)
        clock.now += work
        ticker.wait()
    at = np.array([*starts[1:], clock.now]) - 100.0
    # 0.12 beyond its deadline begins at once; 0.37 skips what passed; then the old rhythm again
    np.testing.assert_allclose(at, [0.1, 0.2, 0.32, 0.4, 0.77, 0.8], atol=1e-9)
    assert (ticker.overruns, ticker.skipped) == (2, 2)
    assert min(clock.slept) > 0.0


def test_neither_rounding_nor_sleeps_that_end_early_or_late_move_the_deadlines():
    clock = Clock()
    ticker = Ticker(0.01, clock=clock, sleep=clock.sleep)
    for _ in range(100_000):
        ticker.wait()
    assert clock.now == pytest.approx(1100.0, abs=1e-6)
    assert ticker.overruns == 0
    longest = [0.03]
    ticker = Ticker(0.1, clock=clock, sleep=lambda s: clock.sleep(min(s, longest[0])))
    ticker.wait()
    assert clock.now == pytest.approx(1100.1)
    clock.late = 0.02
    longest[0] = math.inf
    for _ in range(5):
        ticker.wait()
    assert clock.now == pytest.approx(1100.62)


@given(
    st.lists(st.floats(1e-6, 100.0), min_size=1, max_size=300),
    st.sampled_from([0.5, 0.9, 0.99, 1.0]),
)
def test_quantiles_are_right_to_a_bucket(values, share):
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    exact = sorted(values)[math.ceil(share * len(values)) - 1]
    assert exact * (1 - 1e-9) <= histogram.quantile(share) <= exact * 2 ** (1 / 16) * (1 + 1e-9)
    assert histogram.max_s == max(values)
    assert histogram.summary_ms()["mean"] == pytest.approx(1e3 * np.mean(values))


def test_a_histogram_takes_any_duration():
    histogram = Histogram()
    assert histogram.quantile(0.5) == histogram.summary_ms()["mean"] == 0.0
    for value in (0.9e-3, 1.023e-3, 1.024e-3, 1.1e-3, 2.1e-3):
        histogram.add(value)
    assert histogram.sum_s == pytest.approx(6.147e-3)
    for value in (0.0, -1.0, 1e9):
        histogram.add(value)
    assert histogram.count == 8
    assert histogram.summary_ms()["max"] == 1e12


# --- messages and settings


# --- the map


def test_patches_off_the_map_and_of_the_wrong_kind_are_counted():
    nav = Navigator(Ground(free()))
    for row, col, layer in (
        (100, 0, "cost"),
        (-3, 0, "cost"),
        (0, 0, "elevation"),
        (-1, -1, "cost"),
    ):
        nav.offer(MapPatch(row, col, **{layer: free((3, 3)) + 0.1}))
    counters = nav.counters()
    assert (counters.patches, counters.patches_rejected, counters.patches_clipped) == (4, 3, 1)
    first = nav.tick()
    assert (first.map_version, first.outcome) == (1, Status.NO_POSE)
    nav.offer(Pose(1, 1))
    assert nav.tick().outcome is Status.NO_GOAL and nav.counters().failed == 0
    lengths = Navigator(Ground(free(), step_cost="length"))
    for weight in (0.0, 1e-39, 1.1e30):
        lengths.offer(MapPatch(0, 0, cost=np.full((1, 1), weight)))
    assert lengths.counters().patches_rejected == 3


def test_a_flood_of_patches_from_several_threads_is_merged_and_none_is_lost():
    cost = free()
    nav = navigator(method="astar")
    told = [
        [(first + 4 * (n % 10), n % 60, 0.1 + n / 1000) for n in range(500)] for first in range(4)
    ]

    def flood(patches):
        for row, col, value in patches:
            nav.offer(one_cell((row, col), value))

    threads = [threading.Thread(target=flood, args=(patches,)) for patches in told]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for row, col, value in itertools.chain(*told):
        cost[row, col] = value
    message = nav.tick()
    counters = nav.counters()
    check(message, cost)
    np.testing.assert_allclose(nav.map.cost(), cost, rtol=1e-6)
    assert counters.patches == message.map_version == 2000
    assert counters.patches_merged > 0


def test_heights_and_costs_that_the_map_has_already_change_nothing():
    soft = Traversability()
    heights = np.random.default_rng(0).normal(0.0, 0.01, (30, 40)).astype(np.float32)
    heights[3, 4] = np.nan
    for vehicle in (
        None,
        Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.3),
        Vehicle(radius_m=0.6),
    ):
        state = map_state(Ground.of_elevation(heights, 0.5, soft, vehicle=vehicle))
        assert state.update(0, 0, heights[:20, :20], layer="heights").cells == 0
        other = heights.copy()
        other[10:12, 15] = 0.5
        other[11, 17] = np.nan
        (row, col, rows, cols) = state.update(5, 5, other[5:25, 5:35], layer="heights").part
        assert row > 5 and col > 8 and row + rows < 20 and col + cols < 25
        np.testing.assert_array_equal(state.elevation(), other)
        np.testing.assert_array_equal(state.cost(), Ground.of_elevation(other, 0.5, soft).costs())
        assert state.update(2, 2, np.full((2, 2), np.nan)).cells == 0
        assert state.update(2, 2, np.ones((2, 2))).cells > 0
        assert vehicle is not None or state.update(2, 2, np.ones((2, 2))).cells == 0


# --- the navigator


def test_a_path_is_kept_while_it_holds_and_planned_anew_when_it_does_not():
    nav = navigator()
    first = nav.tick()
    assert (first.origin, first.degraded) == (Origin.FULL, False)
    nav.offer(Pose(*first.path[7]))
    kept = nav.tick()
    assert (kept.origin, kept.degraded) == (Origin.STANDING, False)
    np.testing.assert_array_equal(kept.path, first.path[7:])
    nav.offer(one_cell(first.path[25], np.inf))
    new = nav.tick()
    assert new.origin is Origin.FULL
    check(new, nav.map.cost())
    nav.offer(Goal(3, 50))
    assert nav.tick().goal == (3, 50)
    counters = nav.counters()
    assert (counters.ticks, counters.planned, counters.kept, counters.failed) == (4, 3, 1, 0)


def test_a_goal_that_nothing_is_known_of_is_approached_until_it_is_seen():
    cost = free()
    cost[:, 30:] = np.nan  # nothing is known of it
    cost[:18, 20] = np.inf
    blocked = navigator(cost, (5, 5), (5, 50)).tick()
    reason = "the goal is impassable; 1 of 1 cells around it are unknown"
    assert (blocked.outcome, blocked.reason) == (Status.GOAL_BLOCKED, reason)
    nav = navigator(cost, (5, 5), (5, 50), approach=True)
    message = nav.tick()
    check(message, cost)
    assert message.goal_moved and message.goal[1] in (28, 29)  # at the edge of what is known
    place = message.goal
    message = nav.tick()
    assert (message.origin, message.goal, message.goal_moved) == (Origin.STANDING, place, True)
    nav.offer(MapPatch(0, 50, cost=flat(3, 3, np.inf)))  # elsewhere: no other place for that
    nav.offer(MapPatch(place[0] + 2, 6, cost=free((1, 22)) * 0.9))  # nor for little
    assert nav.tick().goal == place
    nav.offer(MapPatch(0, 30, cost=free((40, 10))))
    assert nav.tick().goal[1] in (38, 39)
    nav.offer(MapPatch(3, 36, cost=flat(5, 24, np.inf)))  # the goal is seen, and is an obstacle
    assert nav.tick().goal == (2, 39)
    nav.offer(MapPatch(0, 30, cost=free((40, 30))))
    for goal in ((5, 50), (6, 50)):
        nav.offer(Goal(*goal))
        message = nav.tick()
        assert message.goal == goal and not message.goal_moved


def test_a_goal_that_is_shut_off_is_approached():
    cost = free()
    cost[:, 20] = np.inf
    assert navigator(cost, (5, 5), (5, 50)).tick().outcome is Status.NO_PATH
    nav = navigator(cost, (5, 5), (5, 50), approach=True)
    message = nav.tick()
    check(message, cost)
    assert message.goal == (5, 19) and message.goal_moved
    nav.offer(Pose(5, 30))  # on the other side of the wall, with the map as it was
    assert nav.tick().goal == (5, 50)


def test_a_cost_that_is_not_known_tells_a_map_of_heights_nothing():
    nav = Navigator(Ground.of_elevation(flat(9, 9), 1.0))
    for cost in (1.0, np.nan):
        nav.offer(MapPatch(4, 4, cost=flat(1, 1, cost)))
    nav.tick()
    assert not nav.planner.is_passable((4, 4))


def test_a_kept_path_tells_what_is_known_of_it_by_now():
    ground = Ground.of_coarse(flat(10, 12), 4.0, 4, prior="slope")
    nav = Navigator(ground, tolerance=10.0)
    nav.offer(Pose(5, 5))
    nav.offer(Goal(30, 40))
    nav.offer(MapPatch(0, 0, elevation=flat(20, 24)))
    first = nav.tick()
    nav.offer(MapPatch(0, 0, elevation=flat(40, 40)))
    nav.offer(Pose(*first.path[4]))
    kept = nav.tick()
    assert kept.origin is Origin.STANDING and kept.known > first.known > 4


def test_what_is_unknown_around_a_body_is_said():
    heights = flat(40, 40)
    heights[10:20, 10:20] = np.nan
    rover = Vehicle(length_m=0.6, width_m=0.4, clearance_m=0.2)
    nav = Navigator(Ground.of_elevation(heights, 0.1, vehicle=rover))
    nav.offer(Pose(15, 15))
    nav.offer(Goal(30, 30))
    message = nav.tick()
    assert message.outcome is Status.START_BLOCKED
    # the body reaches 4 cells far, and the start may move by 3
    assert (
        message.reason
        == "no passable cell within 3 of the robot; 100 of 225 cells around it are unknown"
    )


# --- the ladder, where planning fails, is late, or the map changes meanwhile


def raising(*_, **__):
    raise RuntimeError("inference\nfailed")


def test_a_network_that_raises_leaves_the_corridor(network, monkeypatch):
    nav = navigator(method="nnpp", model=network)
    monkeypatch.setattr(NetworkModel, "answer", raising)
    message = nav.tick()
    assert (message.outcome, message.origin) == (Status.OK, Origin.CORRIDOR)
    assert (message.method, message.degraded) == ("corridor", True)
    assert message.reason == "RuntimeError: inference failed"
    assert (nav.counters().degraded, nav.counters().errors) == ({"raised": 1}, {"full": 1})
    monkeypatch.undo()
    nav.offer(Goal(3, 50))
    assert nav.tick().origin is Origin.FULL


def test_when_all_planning_raises_the_standing_path_serves_while_it_holds(monkeypatch):
    nav = navigator(tolerance=0.0)
    first = nav.tick()
    monkeypatch.setattr(nav.planner, "replan", raising)
    nav.offer(MapPatch(0, 0, cost=np.full((30, 60), 0.19)))
    message = nav.tick()
    assert (message.outcome, message.origin, message.degraded) == (Status.OK, Origin.STANDING, True)
    np.testing.assert_array_equal(message.path, first.path)
    nav.offer(one_cell(first.path[20], np.nan))
    message = nav.tick()
    assert (message.outcome, message.origin) == (Status.UNKNOWN, Origin.NONE)
    assert "inference failed" in message.reason
    assert nav.counters().errors == {"full": 2, "corridor": 2}
    monkeypatch.setattr(nav.planner, "standing", raising)
    assert nav.tick().outcome is Status.UNKNOWN, "whatever raises is an outcome"
    assert nav.counters().errors["tick"] == 1


def test_out_of_time_is_a_timeout_and_the_standing_path_bridges_it(monkeypatch):
    nav = navigator(tolerance=0.0)
    partial = Plan(Status.TIMEOUT, Method.ASTAR, path=np.array([[5, 5], [6, 6]], np.int32))
    monkeypatch.setattr(nav.planner, "replan", lambda **options: partial)
    message = nav.tick()
    assert (message.outcome, message.origin, len(message.path)) == (Status.TIMEOUT, Origin.NONE, 0)
    monkeypatch.undo()
    whole = nav.tick()
    monkeypatch.setattr(nav.planner, "replan", lambda **options: partial)
    nav.offer(MapPatch(30, 5, cost=np.full((3, 3), 0.001)))
    late = nav.tick()
    assert (late.outcome, late.origin, late.degraded) == (Status.OK, Origin.STANDING, True)
    np.testing.assert_array_equal(late.path, whole.path)
    assert nav.counters().degraded == {"timeout": 2}


def test_a_map_that_changes_while_planning_holds_the_path_back(monkeypatch):
    nav = navigator(refine="any-angle")
    replan = nav.planner.replan
    later = [lambda plan: one_cell(plan.path[10], 0.9)]

    def and_then_a_patch(**options):
        plan = replan(**options)
        nav.offer(later.pop()(plan) if later else MapPatch(0, 30, cost=np.full((40, 1), np.inf)))
        return plan

    monkeypatch.setattr(nav.planner, "replan", and_then_a_patch)
    message = nav.tick()
    assert message.ok and message.map_version == 1
    assert message.waypoints is None, "the line was not checked on the map with the patch"
    assert message.cost == pytest.approx(
        Planner(nav.map.cost()).state.grid.costs_of(message.path)[0]
    )
    nav.offer(Goal(30, 58))
    message = nav.tick()
    assert message.outcome is Status.NO_PATH, "the corridor was planned on the map with the wall"
    assert nav.counters().degraded == {}, "by an answer that is right"
    monkeypatch.undo()
    nav.offer(MapPatch(0, 30, cost=free((40, 1))))
    assert nav.tick().waypoints is not None


@pytest.mark.parametrize("shut", [True, False])
def test_a_path_that_cannot_be_begun_where_the_robot_is_is_held_back(monkeypatch, shut):
    nav = navigator()
    replan = nav.planner.replan

    def and_then_the_first_cell_goes(**options):
        plan = replan(**options)
        if not shut:
            return plan.rest(1)
        nav.offer(one_cell(plan.path[0], np.inf))
        return plan

    monkeypatch.setattr(nav.planner, "replan", and_then_the_first_cell_goes)
    assert not nav.tick().ok


def test_a_map_update_that_raises_is_tried_again_and_no_path_is_published_without_it(monkeypatch):
    nav = navigator()
    first = nav.tick()
    update = nav.planner.update
    left = [1]

    def raising_at_first(*patch, **options):
        left[0] -= 1
        return raising() if left[0] >= 0 else update(*patch, **options)

    monkeypatch.setattr(nav.planner, "update", raising_at_first)
    nav.offer(MapPatch(10, 0, cost=np.full((1, 59), np.inf)))
    message = nav.tick()
    assert message.ok and message.path[:, 1].max() == 59
    check(message, nav.map.cost())
    assert nav.counters().errors == {"map": 1}
    left[0] = 2
    nav.offer(MapPatch(10, 59, cost=np.full((1, 1), np.inf)))
    assert nav.tick().outcome is Status.UNKNOWN, "which is better than a path through the wall"
    assert nav.tick().outcome is Status.NO_PATH, "the patch has waited"
    assert nav.counters().errors == {"map": 2, "tick": 1}
    assert first.map_version == 0


def test_patches_that_the_map_did_not_take_come_before_those_that_came_meanwhile():
    patches = Patches(state_of(free()))
    older, newer = (MapPatch(0, col, cost=free((2, 2))) for col in (3, 0))
    patches.offer(older)
    with pytest.raises(KeyError), patches.taking():
        patches.offer(newer)
        raise KeyError
    with patches.taking() as taken:
        assert [one.part[1] for one in taken] == [3, 0]


# --- the runner


def test_it_runs_at_its_rate_and_sends_answers_and_status():
    source = InProcessSource()
    sink = InProcessSink(1000)
    for n in range(5):
        assert source.put(Pose(3 + n, 3))
    source.put(Goal(30, 50))
    source.put(MapPatch(10, 10, cost=free((3, 3)) + 0.5))
    nav = Navigator(Ground(free()))
    tick = nav.tick
    deadlines = []
    nav.tick = lambda deadline: deadlines.append(deadline) or tick(deadline)
    spare_s = []
    nav.go_on = spare_s.append
    loop = Loop(nav, source, [sink], rate_hz=200.0, status_every_s=0.05, queue=100)
    began = time.monotonic()
    counters = loop.run(41)
    elapsed_s = time.monotonic() - began
    assert deadlines[-1] - deadlines[0] == pytest.approx((40 + counters.skipped) / 200.0)
    assert elapsed_s >= (40 - counters.skipped) / 200.0 - 1e-3
    assert 0.0 < max(spare_s) < 1.0 / 200.0, "time is left for a search"
    paths = [m for m in sink.messages if isinstance(m, PathMessage)]
    assert [m.tick for m in paths] == list(range(1, 42))
    assert paths[0].start == (7, 3)
    assert (counters.ticks, counters.patches) == (41, 1)
    assert counters.tick_ms["max"] >= counters.tick_ms["p50"] > 0.0
    assert counters.rss_bytes > 1e6
    status = [m for m in sink.messages if isinstance(m, StatusMessage)]
    assert 1 <= len(status) <= elapsed_s / 0.05 + 1
    assert status[-1].summary()["counters"]["ticks"] > 0
    assert paths[-1].summary()["outcome"] == "OK"
    assert gc.isenabled() and not gc.get_freeze_count()


def test_the_last_tick_counts_when_it_is_late():
    def late(message):
        time.sleep(0.035)

    counters = Loop(navigator(), InProcessSource(), rate_hz=100.0, after_tick=late).run(1)
    assert counters.overruns == 1 and counters.skipped >= 2


class Stuck:
    name = "stuck"

    def __init__(self, then=lambda: None):
        self.free = threading.Event()
        self.then = then
        self.gave_up = False

    def publish(self, message):
        self.then()
        self.gave_up |= not self.free.wait(20.0)


class Slow(InProcessSink):
    """Takes longer for an answer than the loop."""

    def publish(self, message):
        time.sleep(0.003)
        super().publish(message)


def test_at_full_speed_the_loop_waits_for_its_sinks_and_loses_no_answer():
    sink = Slow(1000)
    counters = Loop(navigator(), InProcessSource(), [sink], queue=2, rate_hz=1.0, paced=False).run(
        40
    )
    assert [m.tick for m in sink.messages if isinstance(m, PathMessage)] == list(range(1, 41))
    assert counters.drops == {"in-process": 0}


def test_at_full_speed_too_a_sink_that_hangs_does_not_outlast_a_stop():
    stuck = Stuck(lambda: threading.Timer(0.1, lambda: loop.stop()).start())
    loop = Loop(navigator(), InProcessSource(), [stuck], queue=2, rate_hz=1.0, paced=False)
    assert loop.run().ticks == 4, "one is taken, two wait, and one finds no room"
    assert not stuck.gave_up, "the sink still hangs"
    stuck.free.set()


class Broken:
    name = "broken"

    def publish(self, message):
        raise OSError("no such socket")

    def poll(self):
        raise OSError("no such socket")


def test_sinks_that_hang_or_raise_and_a_source_that_raises_do_not_stop_the_loop(caplog):
    stuck = Stuck()
    good = InProcessSink(1000)
    counters = Loop(navigator(), Broken(), [stuck, Broken(), good], rate_hz=500.0, queue=4).run(50)
    stuck.free.set()
    assert (counters.ticks, counters.kept) == (50, 49)
    assert counters.drops["stuck"] >= 40
    assert counters.errors["sink broken"] > 0 and counters.errors["source"] == 50
    assert good.path.ok
    for who in ("the sink broken", "the source"):
        assert sum(f"{who} failed" in record.message for record in caplog.records) == 1


class Ailing(InProcessSink):
    """Fails twice, and then works."""

    name = "ailing"
    lost = 3

    def publish(self, message):
        if message.tick <= 2:
            raise OSError("not yet")
        super().publish(message)


@pytest.mark.parametrize("calm_s", [0.0, 60.0])
def test_what_fails_and_works_again_is_logged_once_each(caplog, monkeypatch, calm_s):
    monkeypatch.setattr(workers, "_CALM_S", calm_s)
    options = {"rate_hz": 500.0, "queue": 100, "status_every_s": 1e9}
    with caplog.at_level("WARNING"):
        counters = Loop(navigator(), InProcessSource(), [Ailing(100)], **options).run(6)
    assert counters.errors["sink ailing"] == 2
    assert counters.lost == {"ailing": 3}
    said = [record.message for record in caplog.records if "sink ailing" in record.message]
    assert not any(record.exc_info for record in caplog.records), (
        "the message says all there is to say"
    )
    again = ["the sink ailing works again, after 2 failures"] if calm_s == 0.0 else []
    assert said == [
        "the sink ailing failed (not yet); more of the same is counted, not logged",
        *again,
    ]


def test_a_flood_of_inputs_leaves_time_to_plan():
    flood = (Pose(row % 40, 3) for row in range(2_000_000))  # of some seconds
    sink = InProcessSink(100)
    counters = Loop(navigator(), SimpleNamespace(poll=lambda: flood), [sink], rate_hz=50.0).run(10)
    assert next(flood, None) is not None, "none of the ticks waited for its end"
    assert (counters.ticks, counters.failed) == (10, 0)
    assert sink.path.ok


def test_inputs_that_one_tick_has_no_time_for_are_read_in_the_next():
    def slowly():
        for col in range(12):
            time.sleep(0.004)
            yield MapPatch(col, col, cost=free((1, 1)))

    polls = iter([slowly(), [MapPatch(20, 20, cost=free((1, 1)))]])
    source = SimpleNamespace(poll=lambda: next(polls, ()))
    assert Loop(navigator(), source, rate_hz=100.0).run(20).patches == 13


def test_a_signal_stops_it():
    sink = InProcessSink(3000)

    def send(message):
        if message.tick == 10:
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    loop = Loop(navigator(), InProcessSource(), [sink], rate_hz=200.0, queue=3000, after_tick=send)
    with handling_signals(loop):
        counters = loop.run()
    assert counters.ticks == 10
    assert len([m for m in sink.messages if isinstance(m, PathMessage)]) == counters.ticks
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_follows_a_tick_may_fail_and_ticks_that_are_not_paced_have_no_deadline(monkeypatch):
    monkeypatch.setattr(time, "sleep", raising)
    seen = []
    deadlines = []
    nav = navigator()
    tick = nav.tick
    nav.tick = lambda deadline: deadlines.append(deadline) or tick(deadline)

    def after_tick(message):
        seen.append(message.tick)
        raise OSError("no manager")

    counters = Loop(nav, InProcessSource(), rate_hz=1e-3, paced=False, after_tick=after_tick).run(5)
    assert seen == [1, 2, 3, 4, 5]
    assert (counters.errors, counters.overruns, counters.skipped) == ({"after_tick": 5}, 0, 0)
    assert min(deadlines) == math.inf


def test_cores_and_priority_are_taken_as_far_as_allowed_and_given_back():
    before = os.sched_getaffinity(0)
    seen = []

    class Spy:
        def poll(self):
            seen.append(os.sched_getaffinity(0))
            return ()

    core = min(before)
    Loop(navigator(), Spy(), rate_hz=500.0, cores=[core], priority=1).run(2)
    assert seen == [{core}] * 2
    assert os.sched_getaffinity(0) == before
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    for beyond in (9999, 2**32):
        Loop(navigator(), Spy(), rate_hz=500.0, cores=[beyond]).run(1)
        assert seen[-1] == before
