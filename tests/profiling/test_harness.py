"""The harness that times rivals in turns: what counts, in which order, and the quantiles."""

import gc
from functools import partial
from itertools import permutations

import pytest

from nnpp_edge.outcome import gap
from nnpp_edge.profiling.contest import Harness


class FakeClock:
    """Time that passes only while a rival is called."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return FakeClock()


def taking(clock, seconds, calls=None, name=""):
    """A rival whose call takes so many seconds, one for each call in turn, and returns the case."""
    left = iter(seconds)

    def call(case):
        if calls is not None:
            calls.append((name, case))
        clock.now += next(left)
        return case

    return call


def test_every_rival_is_timed_on_every_case_and_what_is_done_between_does_not_count(clock):
    def slow(*told):
        clock.now += 50.0

    calls = []
    seconds = {"plain": [9.0, 8.0, 7.0, 6.0], "ours": [3.0, 1.0, 2.0, 4.0]}
    rivals = {name: taking(clock, each, calls, name) for name, each in seconds.items()}
    given = {"repeats": 2, "before": slow, "after": slow}
    times = []
    for records in Harness(clock=clock).measure(rivals, ["a", "b"], **given):
        times.append([(name, record.case, record.elapsed_s) for name, record in records.items()])
        clock.now += 1000.0
    assert times[0] == [("plain", "a", (9.0, 8.0)), ("ours", "a", (3.0, 1.0))]
    assert times[1] == [("plain", "b", (7.0, 6.0)), ("ours", "b", (2.0, 4.0))]
    assert len(calls) == 8


def test_rivals_take_turns_in_an_order_that_is_drawn_anew_and_the_same_for_the_same_seed(clock):
    def order(seed):
        calls = []
        rivals = {name: taking(clock, [1.0] * 40, calls, name) for name in "abc"}
        list(Harness(seed, clock).measure(rivals, [0, 1], repeats=20))
        return [name for name, _ in calls]

    called = order(1)
    turns = {tuple(called[at : at + 3]) for at in range(0, 120, 3)}
    assert turns == set(permutations("abc")), "each once in a turn, in every order"
    assert called == order(1) != order(2)


def test_medians_the_middle_call_and_no_garbage_collected_meanwhile(clock):
    seconds = iter([5.0, 1.0, 3.0, 2.0, 4.0])
    collected = []

    def call(case):
        collected.append(gc.isenabled())
        took = next(seconds)
        clock.now += took
        return f"took {took}"

    harness = Harness(clock=clock)
    for records in harness.measure({"x": call}, [0], repeats=4):
        collected.append(gc.isenabled())
    record = records["x"]
    assert record.median_s == 2.5
    assert record.middle() == (2.0, "took 2.0")  # of the two in the middle the faster one
    assert harness.timed(partial(call, 0)) == (4.0, "took 4.0")
    assert collected == [*[False] * 4, True, False] and gc.isenabled()


def test_a_gap_is_a_share_of_the_optimum_also_where_energy_is_got_back():
    assert (gap(1.5, 1.0), gap(-1.0, -2.0), gap(0.0, 0.0)) == (0.5, 0.5, 0.0)
