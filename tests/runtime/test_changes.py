"""Whoever reads the log of a map's changes, at whatever times, answers as on the map as it is."""

import gc
import math
from collections import deque
from dataclasses import replace
from functools import partial
from unittest.mock import patch as replaced

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicMethod, DynamicPlanner, Planner
from nnpp_edge.runtime.cells import enclosing
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map import state as state_module
from nnpp_edge.runtime.map.changes import MANY_NODES, Change, ChangeLog
from nnpp_edge.runtime.planners.standing_path import Footing, StandingPath
from tests import oracles
from tests.strategies import flat, random_cell, random_costs, random_patch, state_of, uniform

CLOSE = {"rel": 1e-5, "abs": 1e-5}
PATCHES = ("part", "part", "part", "extremes", "whole")
ASKED = (*DynamicMethod, "stand", "stand", "stand")
STEPS = st.lists(st.sampled_from((*PATCHES * 3, *ASKED, "move", "goal")), max_size=30)


def changed(rng, cost, step_cost, kind):
    """Where a patch goes, and what it holds: a part, weights below and above all so far, or the
    whole map anew.
    """
    if kind == "whole":
        new = cost * np.float32(rng.choice([0.5, 1.0, 1.2]))
        new[(new >= 1.0) & (step_cost == "paper")] = np.inf
        new[rng.random(cost.shape) < 0.05] = 0.3
        return 0, 0, new
    row, col, patch = random_patch(rng, cost, step_cost)
    if kind == "extremes":  # in the `length` model all that is relative to them is out of date
        finite = cost[np.isfinite(cost)]
        least, greatest = (finite.min(), 1.5 * finite.max()) if finite.size else (0.4, 0.5)
        greatest = min(greatest, 0.99) if step_cost == "paper" else greatest
        patch = np.where(rng.random(patch.shape) < 0.5, least / 2, greatest).astype(np.float32)
    return row, col, patch


@settings(max_examples=40)
@given(
    steps=STEPS,
    shape=st.sampled_from([(7, 12), (24, 31), (33, 150)]),
    step_cost=st.sampled_from(["paper", "length"]),
    corner_cutting=st.booleans(),
    most=st.sampled_from([1, 2, 5, 64]),
    seed=st.integers(0, 2**32),
)
@example(["astar", *["part"] * 9, "whole", "stand"] * 2, (24, 31), "length", True, 2, 5)
@example(
    ["auto", *["part", "auto", "corridor-dstar", "stand"] * 8], (33, 150), "paper", True, 64, 7
)
def test_a_planner_that_is_asked_at_any_time_answers_as_the_map_is(
    network, steps, shape, step_cost, corner_cutting, most, seed
):
    """Of its changes all but a few are merged; `eager` is asked at once after each, and none of its
    are.
    """
    rng = np.random.default_rng(seed)
    cost = random_costs(rng, shape, step_cost, blocked=0.15)
    start = random_cell(rng, shape)
    goal = random_cell(rng, shape)
    model = {"step_cost": step_cost, "corner_cutting": corner_cutting}
    with replaced.object(state_module, "ChangeLog", partial(ChangeLog, most)):
        planner = DynamicPlanner(cost, goal, "auto", model=network, **model)
    eager = DynamicPlanner(cost, goal, "astar", **model)
    both = (planner, eager)
    alike = False
    for step in ("move", *steps, *ASKED):
        if step in PATCHES:
            row, col, patch = changed(rng, cost, step_cost, step)
            before = np.where(planner.state.grid.map() < np.inf, cost, np.inf)
            cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
            differ = (
                np.where(cost < (1.0 if step_cost == "paper" else np.inf), cost, np.inf) != before
            ).sum()
            assert [each.update(row, col, patch) for each in both] == [differ] * 2
            eager.standing()
        elif step == "goal":
            goal = random_cell(rng, shape)
            for each in both:
                each.set_goal(goal)
        elif step == "move":
            path = planner.standing_plan.path if planner.standing_plan is not None else ()
            start = (
                tuple(path[int(rng.integers(len(path)))].tolist())
                if len(path)
                else random_cell(rng, shape)
            )
            for each in both:
                each.move(start)
        optimum = math.inf
        if np.isfinite(cost[start]) and np.isfinite(cost[goal]):
            optimum = oracles.dijkstra(cost, start, step_cost, corner_cutting)[goal]
        if step == "stand":
            found = planner.standing()
            check_standing(found, planner.standing_plan, cost, optimum, model)
            if found.index >= 0:
                least = min(found.cost, planner.state.grid.least_cost(start, goal))
                assert found.lower_bound >= least * (1 - 1e-6)
            if alike:  # by the optimum
                other = eager.standing()
                assert (other.footing, other.blocked_at) == (found.footing, found.blocked_at)
                bounds = other.cost, other.lower_bound, other.floor
                assert bounds == pytest.approx(
                    (found.cost, found.lower_bound, found.floor), **CLOSE
                )
                assert not found.valid or found.floor <= optimum * (1 + 2e-5) + 1e-5
        elif step in tuple(DynamicMethod):
            if rng.random() < 0.1:
                planner.replan(method=step, time_limit_s=0.0)
            plan = planner.replan(method=step)
            assert plan.ok == math.isfinite(optimum)
            if plan.ok:
                assert oracles.path_problem(plan.path, cost, start, goal, corner_cutting) == ""
                assert plan.cost == pytest.approx(
                    oracles.path_cost(plan.path, cost, step_cost), **CLOSE
                )
                assert (
                    plan.lower_bound * (1 - 1e-5) - 1e-5 <= optimum <= plan.cost * (1 + 1e-5) + 1e-5
                )
                assert plan.method not in ("astar", "dstar") or plan.cost == pytest.approx(
                    optimum, **CLOSE
                )
            alike = step == "astar" and plan.ok
            if alike:
                assert eager.replan().cost == pytest.approx(plan.cost, **CLOSE)


def check_standing(found, plan, cost, optimum, model):
    """The standing path is what is left of it on the map as it is, and no path costs less than its
    bound.
    """
    if found.footing in (Footing.NONE, Footing.OFF_PATH):
        return
    rest = plan.path[found.index :]
    slack = 2e-5 * (plan.cost + 1.0)
    problem = oracles.path_problem(rest, cost, rest[0], rest[-1], model["corner_cutting"])
    assert found.valid == (problem == "")
    assert found.lower_bound <= optimum + slack
    if found.valid:
        assert found.cost == pytest.approx(
            oracles.path_cost(rest, cost, model["step_cost"]), **CLOSE
        )
        assert found.cost <= found.bound * optimum + slack


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
    log = ChangeLog(most)
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
        changes = reader.peek() if col % 3 == 0 else reader.read()
        whole = deque(unread)
        for change in changes:  # each covers exactly the next of those that were appended
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


def test_of_many_merged_nodes_each_is_kept_once_with_its_oldest_weight():
    log = ChangeLog(2)
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
    assert (path.check((10, 0)).footing, path.check((10, 0)).blocked_at) == (
        Footing.BLOCKED,
        (10, 5),
    )
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


def test_only_a_path_to_the_goal_can_stand():
    cost = free(5, 5)
    cost[:, 2] = np.inf
    path, plan, put = standing_on(cost, (0, 0), (4, 0))
    with pytest.raises(InvalidQueryError, match="NO_PATH"):
        path.set(Planner(cost).plan((0, 0), (4, 4), method="astar"))
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
