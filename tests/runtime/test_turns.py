"""One call at a time, and what a planner answers after a call that was broken off."""

import threading
from contextlib import suppress

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner
from nnpp_edge.runtime.errors import ConcurrentUseError
from nnpp_edge.runtime.planners.standing_path import Footing
from tests.fuzz.sequences import interrupting

SIDE = 24
ENDS = (0, 0), (SIDE - 1, SIDE - 1)


def broken_off(call, line):
    """Call, and break off at that place, where a signal could; whether it came so far."""
    with suppress(KeyboardInterrupt), interrupting(line) as where:
        call()
    return bool(where)


def test_the_standing_path_outlives_a_call_that_was_broken_off():
    cost = np.random.default_rng(6).uniform(1.0, 4.0, (SIDE, SIDE))
    cost[SIDE // 2, :-1] = np.inf
    cost[SIDE // 2, 3:5] = 0.1
    planner = DynamicPlanner(cost, ENDS[1], "dstar", step_cost="length")
    planner.move(ENDS[0])
    before = planner.replan()
    planner.standing()  # compiles what it needs: to break off a compiler is another matter
    assert broken_off(planner.replan, 20)
    standing = planner.standing()
    assert standing.valid and standing.cost == pytest.approx(before.cost)
    assert 0.0 < standing.lower_bound <= before.cost
    for line in range(1, 60):
        planner.set_goal(ENDS[1])
        planner.replan()
        if not broken_off(lambda: planner.set_goal((0, SIDE - 1)), line):
            break
        assert planner.standing().footing is (Footing.VALID if planner.goal == ENDS[1] else Footing.NONE)
    assert line > 10


@pytest.mark.parametrize("kind", [Planner, DynamicPlanner])
def test_a_second_thread_is_refused_while_the_first_is_at_work(kind):
    cost, inside, leave, found = np.full((30, 40), 0.3), threading.Event(), threading.Event(), []

    class Slow:
        """Cells that take as long to read as the test wants."""

        def __array__(self, dtype=None, copy=None):
            inside.set()
            leave.wait(10.0)
            return np.full((2, 2), 0.4)

    planner = kind(cost) if kind is Planner else kind(cost, (29, 39), "dstar")
    other = threading.Thread(target=lambda: found.append(planner.update(0, 0, Slow())))
    other.start()
    try:
        assert inside.wait(10.0)
        with pytest.raises(ConcurrentUseError, match="one call at a time"):
            planner.update(5, 5, np.ones((2, 2)))
        if kind is DynamicPlanner:
            planner.move((0, 0))
        with pytest.raises(ConcurrentUseError):
            planner.plan((0, 0), (29, 39)) if kind is Planner else planner.replan()
    finally:
        leave.set()
        other.join()
    assert found == [4]
    assert planner.update(0, 0, np.full((2, 2), 0.3)) == 4


def test_the_nearest_of_several_goals_is_looked_for_on_one_map():
    """All its plans are one call: none may be made on a map that another thread has changed in between."""
    planner, refused = Planner(np.full((30, 40), 0.3)), []

    def change():
        try:
            planner.update(0, 0, np.ones((2, 2)))
        except ConcurrentUseError as error:
            refused.append(error)

    class Interrupted(float):
        """A number that lets another thread run whenever it is looked at."""

        def __ge__(self, other):
            thread = threading.Thread(target=change)
            thread.start()
            thread.join()
            return super().__ge__(other)

    ranked = planner.nearest((5, 5), [(29, 39), (9, 8)], count=2, method="astar", epsilon=Interrupted("inf"))
    assert [number for number, _ in ranked] == [1, 0]
    assert len(refused) == 2


def test_refused_calls_cost_nothing_that_was_kept():
    planner = Planner(np.full((30, 40), 0.3))
    planner.prepare(landmarks=4)
    few = planner.plan((0, 0), (29, 39), method="astar").expansions
    for wrong in ({"epsilon": float("nan")}, {"time_limit_s": float("nan")}, {"method": "best"}):
        with pytest.raises(ValueError, match="got"):
            planner.plan((0, 0), (29, 39), **wrong)
    assert few == planner.plan((0, 0), (29, 39), method="astar").expansions
