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


def test_rivals_take_turns_in_an_order_that_is_drawn_anew_and_what_is_between_does_not_count(clock):
    def order(seed):
        calls = []

        def call(name, case):
            calls.append((name, case))
            clock.now += 1.0 + case
            return f"{name} of {case}"

        def between(*told):
            clock.now += 50.0

        rivals = {name: partial(call, name) for name in "abc"}
        given = {"repeats": 20, "before": between, "after": between}
        for records in Harness(seed, clock).measure(rivals, [0, 1], **given):
            _, case = calls[-1]
            for name, record in records.items():
                assert (record.case, record.elapsed_s) == (case, (1.0 + case,) * 20)
                assert record.results == (f"{name} of {case}",) * 20
            between()
        return "".join(name for name, _ in calls)

    called = order(1)
    turns = {called[at : at + 3] for at in range(0, 120, 3)}
    assert len(called) == 120 and turns == {*map("".join, permutations("abc"))}
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
