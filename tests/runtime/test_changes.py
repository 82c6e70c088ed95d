"""Whoever reads the log of a map's changes, at whatever times, answers as on the map as it is."""

import gc
import math
from collections import deque
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicPlanner, Planner
from nnpp_edge.runtime.cells import enclosing
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map import changes
from nnpp_edge.runtime.map.changes import MANY_NODES, Change, ChangeLog
from nnpp_edge.runtime.planners.standing_path import Footing, StandingPath
from tests import oracles
from tests.strategies import flat, state_of, uniform

# --- weights of any size

ENDS = ((3, 5), (114, 111))
PLAIN = uniform(0, (120, 120), 1.0, 3.0)


def test_a_patch_of_extreme_weights_leaves_nothing_behind_once_it_is_taken_back():
    for value in (1e9, 1e30, 1e-9, 1e-37):
        planner = Planner(PLAIN, step_cost="length")
        before = {method: planner.plan(*ENDS, method=method) for method in ("astar", "corridor")}
        planner.update(40, 40, np.full((2, 3), value))
        planner.plan(*ENDS)
        planner.update(40, 40, PLAIN[40:42, 40:43])
        for method, plan in before.items():
            now = planner.plan(*ENDS, method=method)
            assert (now.cost, now.expansions, now.lower_bound) == (
                plan.cost,
                plan.expansions,
                plan.lower_bound,
            )


def test_mended_paths_are_optimal_where_all_weights_have_grown_beyond_comparison():
    """In units of the cheapest step that there was, the dearest of today would be too many for a
    float32.
    """
    planner = DynamicPlanner(PLAIN * np.float32(1e-30), ENDS[1], "dstar", step_cost="length")
    planner.move(ENDS[0])
    assert planner.replan().ok
    grown = (10.0 ** np.random.default_rng(1).uniform(0, 7, (120, 120))).astype(np.float32)
    planner.update(0, 0, grown)
    assert planner.replan().cost == pytest.approx(
        oracles.dijkstra(grown, ENDS[0], "length")[ENDS[1]], rel=1e-6
    )


# --- the log itself


def change_of(*nodes, old=1.0, row=0):
    """A change of one row of cells, by their columns, that all weighed the same."""
    part = (row, min(nodes), 1, max(nodes) - min(nodes) + 1)
    return Change(
        part,
        len(nodes),
        nodes=np.array(nodes, np.int32),
        old_weights=np.full(len(nodes), old, np.float32),
    )


@given(
    st.integers(1, 6),
    st.lists(st.tuples(st.sampled_from("aaaaar"), st.integers(0, 30)), max_size=60),
)
def test_merged_changes_cover_all_that_they_were_made_of(most, steps):
    with patch.object(changes, "MOST_LOGGED_CHANGES", most):
        log = ChangeLog()
        reader = log.reader(keeps_old_weights=True)
        unread = []
        for number, (what, col) in enumerate(steps):
            if what == "a":
                change = change_of(col, old=float(number), row=number)
                unread.append(change._replace(cheaper=col % 9 == 0, rescaled=col % 11 == 0))
                log.append(unread[-1])
                assert len(reader.peek()) <= most
                continue
            assert not log.reader().peek()
            read = reader.peek() if col % 3 == 0 else reader.read()
            whole = deque(unread)
            for change in read:  # each covers exactly the next of those that were appended
                merged = [whole.popleft() for _ in range(change.cells)]
                assert change.part == enclosing([each.part for each in merged])
                np.testing.assert_array_equal(
                    change.old_weights, [w for each in merged for w in each.old_weights]
                )
                for flag in ("cheaper", "rescaled"):
                    assert getattr(change, flag) == any(getattr(each, flag) for each in merged)
            assert not whole
            if col % 3:
                unread.clear()


def test_of_many_merged_nodes_each_is_kept_once_with_its_oldest_weight(monkeypatch):
    monkeypatch.setattr(changes, "MOST_LOGGED_CHANGES", 2)
    log = ChangeLog()
    nodes = np.arange(MANY_NODES, dtype=np.int32)
    reader = log.reader(keeps_old_weights=True)
    for old in range(1, 8):
        weights = np.full(len(nodes), float(old))
        log.append(Change((0, 0, 1, len(nodes)), len(nodes), nodes=nodes, old_weights=weights))
    assert sum(len(change.nodes) for change in reader.peek()) <= 3 * len(nodes)
    first = np.zeros(len(nodes))
    for change in reversed(reader.read()):
        first[change.nodes] = change.old_weights
    assert (first == 1.0).all()


def test_old_weights_are_noted_only_for_readers_that_want_them():
    """Or a robot that computes its whole map anew each time would hold dozens of maps."""
    cost = uniform(0, (300, 300)) * 0.5
    state = state_of(cost)
    slow = state.log.reader()
    assert state.update(0, 0, cost + np.float32(0.1)).nodes.size == 0
    weights = state.log.reader(keeps_old_weights=True)
    for n in range(20):
        state.update(0, 0, cost if n % 2 == 0 else cost + np.float32(0.1))
        assert sum(len(change.nodes) for change in weights.read()) == cost.size
        assert not any(len(change.nodes) for change in slow.peek())
    assert state.update(0, 0, cost + np.float32(0.1)).cells == 0  # which is not written down
    assert sum(change.cells for change in slow.peek()) == 21 * cost.size and not weights.peek()
    del weights
    gc.collect()
    assert not state.log.keeps_old_weights


# --- the standing path, by hand


def standing_on(cost, start, goal, **options):
    """A standing path along the optimum, its plan, and what patches the map."""
    planner = Planner(cost, **options)
    path = StandingPath(planner.state)
    plan = planner.plan(start, goal, method="astar")
    path.set(plan)
    return (
        path,
        plan,
        lambda row, col, patch: planner.update(row, col, np.array(patch, np.float32, ndmin=2)),
    )


def free(rows, cols):
    return flat(rows, cols, 0.2)


def test_changes_behind_the_robot_do_not_matter_and_off_its_path_it_stands_on_none():
    path, plan, put = standing_on(free(20, 60), (10, 0), (10, 59))
    put(10, 5, np.inf)
    assert (path.check((10, 0)).footing, path.check((10, 0)).blocked) == (Footing.BLOCKED, 5)
    later = path.check((10, 20))
    assert later.valid and later.index == 20
    assert later.cost == pytest.approx(plan.cost * 39 / 59) and later.bound == pytest.approx(
        1.0, rel=1e-5
    )
    assert later.added == pytest.approx(0.0, abs=1e-4)
    assert path.check((3, 3)).footing is Footing.OFF_PATH
    path.forget()
    found = path.check((10, 0))
    assert (found.footing, found.valid, found.lower_bound) == (Footing.NONE, False, 0.0)


def test_only_a_path_that_can_be_walked_can_stand():
    path, plan, put = standing_on(free(5, 2), (0, 0), (4, 0))
    put(2, 0, [[np.inf, np.inf]])
    for other in (plan, replace(plan, path=np.repeat(plan.path, 9, 0))):
        with pytest.raises(InvalidQueryError, match="walkable"):
            path.set(other)
        assert path.check((0, 0)).footing == "blocked"  # the one that stood still does


def test_costs_that_rise_leave_the_bound_and_what_is_far_off_saves_nothing():
    path, plan, put = standing_on(free(20, 60), (10, 0), (10, 59))
    put(0, 30, 0.15)
    assert path.check((10, 0)).added < 0.1 * plan.cost  # one cell's saving at most
    put(0, 30, 0.2)  # what was is what counts, not the order of changes
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-3)
    put(
        5, 0, np.full((10, 60), 0.3)
    )  # other rows stay cheap, as the octile distance goes by the cheapest cell
    found = path.check((10, 0))
    assert found.lower_bound == pytest.approx(plan.cost, rel=1e-3)
    assert found.added == pytest.approx(0.1 * 2 * 2.805 * 59, rel=1e-3)
    path.set(plan)  # which forgets what changed before it
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-6)
    cost = free(20, 60)
    path, plan, put = standing_on(cost, (10, 0), (10, 59))
    cost[9] = 0.1  # beside the path, where another saves on each cell twice
    put(9, 0, cost[9:10])
    optimum = Planner(cost).plan((10, 0), (10, 59), method="astar").cost
    assert 0.97 * optimum < path.check((10, 0)).lower_bound <= optimum < 0.9 * plan.cost
    cost = free(30, 60)
    cost[29, 0] = np.inf
    path, _, put = standing_on(cost, (0, 0), (0, 59))
    put(29, 0, 0.2)  # opened, but the way over it costs more
    assert path.check((0, 0)).added == 0.0
    cost = flat(6, 6)
    cost[2, 3] = np.inf
    path, plan, put = standing_on(cost, (0, 0), (5, 5), corner_cutting=False)
    put(2, 3, 0.0)  # opened, which frees a diagonal step beside it
    assert path.check((0, 0)).lower_bound <= 5 * math.sqrt(2.0) + 1e-5 < plan.cost
