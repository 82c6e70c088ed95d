"""A plan is frozen and owns its data; planners share a network unnoticed, and serve one call at a
time.
"""

import copy
import dataclasses
import json
import math
import pickle
import threading
from contextlib import suppress

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicMethod,
    DynamicPlanner,
    Method,
    NetworkModel,
    Plan,
    Planner,
    Region,
    Status,
)
from nnpp_edge.runtime.errors import ConcurrentUseError
from nnpp_edge.runtime.planners.standing_path import Footing
from tests.fuzz.sequences import interrupting
from tests.strategies import flat, uniform

SHAPE = (210, 250)
START = (8, 9)
GOAL = (200, 240)


def rough(seed=3):
    return uniform(seed, SHAPE, 0.0, 0.6)


def facts(value):
    """A plan, or a part of it, as plain values that can be compared."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.tolist()
    if isinstance(value, Region):
        return [facts(part) for part in value]
    if isinstance(value, Plan):
        return {
            field.name: facts(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    return repr(value)


@pytest.fixture(scope="module", params=["sees all at once", "in two parts"])
def shared_network(network, request):
    """The tiny network, and the shipped one; every planner here is given the same."""
    return network if request.param == "sees all at once" else NetworkModel("edge")


def static_planner(network, seed=3):
    """A planner, and the question that its methods are asked."""
    planner = Planner(rough(seed), model=network)

    def plan(method, start, keep=True):
        return planner.plan(start, GOAL, method=method, keep_regions=keep)

    return planner, plan


def dynamic_planner(network, seed=3):
    """A planner for a map that changes, and the same."""
    planner = DynamicPlanner(rough(seed), GOAL, "auto", model=network)
    planner.prepare()

    def plan(method, start):
        planner.move(start)
        return planner.replan(method=method)

    return planner, plan


@pytest.mark.parametrize(
    ("make", "methods"), [(static_planner, tuple(Method)), (dynamic_planner, tuple(DynamicMethod))]
)
def test_a_plan_stays_what_it_was(shared_network, make, methods):
    planner, plan = make(shared_network)
    kept = []
    for turn in range(2):
        for method in methods:
            found = plan(method, (START[0] + turn, START[1] + 7 * turn))
            assert found.ok
            kept.append((found, facts(found), pickle.dumps(found), copy.deepcopy(found)))
        planner.update(20 + 30 * turn, 30, flat(20, 25, 0.8))
    planner.update(0, 0, rough(4))
    for method in methods:
        plan(method, (START[0] + 50, START[1]))
    with pytest.raises(dataclasses.FrozenInstanceError):
        kept[0][0].cost = 1.0
    for found, wanted, pickled, copied in kept:
        for each in (
            found,
            pickle.loads(pickled),
            copied,
            pickle.loads(pickle.dumps(found)),
            copy.deepcopy(found),
        ):
            assert facts(each) == wanted


@pytest.mark.parametrize("make", [static_planner, dynamic_planner])
def test_what_is_written_into_a_plans_arrays_reaches_no_planner(shared_network, make):
    (_, spoiled), (_, plan) = make(shared_network), make(shared_network)
    for method in ("corridor", "nnpp"):
        for start in (START, (30, 9)):
            found = spoiled(method, start)
            wanted = plan(method, start)
            assert facts(found.path) == facts(wanted.path)
            assert facts(found.region) == facts(wanted.region)
            found.path[:] = 0
            for region in (found.region, found.network_region):
                for array in () if region is None else region[:3]:
                    array[:] = 7


def test_regions_are_kept_only_when_asked_for(network):
    _, plan = static_planner(network)
    for method, has_region, by_network in (
        ("astar", False, False),
        ("corridor", True, False),
        ("nnpp", True, True),
    ):
        found = plan(method, START)
        assert (found.region is not None, found.network_region is not None) == (
            has_region,
            by_network,
        )
        assert (found.threshold > 0.0) == by_network
        if has_region:
            assert found.region.mask()[tuple(found.path.T)].all()
        if by_network:
            assert found.network_region.mask()[tuple(np.array([START, GOAL]).T)].all()
        plain = plan(method, START, keep=False)
        assert (plain.region, plain.network_region) == (None, None)
        np.testing.assert_array_equal(plain.path, found.path)


def test_planners_that_share_a_network_answer_in_turns_as_those_with_one_of_their_own(
    shared_network,
):
    makes = (static_planner, 1), (static_planner, 2), (dynamic_planner, 5)
    sharing, alone = (
        [make(model, seed) for make, seed in makes]
        for model in (shared_network, shared_network.path)
    )
    for turn in range(4):
        start = (START[0] + 3 * turn, START[1] + turn)
        for pair in zip(sharing, alone, strict=True):
            plans = []
            for planner, plan in pair:
                plans.append(plan("nnpp", start))
                planner.update(60, 70 + turn, flat(30, 30, 0.9 - 0.1 * turn))
            one, two = (facts(dataclasses.replace(plan, timings_ms={})) for plan in plans)
            assert one == two
            assert plans[0].threshold > 0.0


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))], ids=["copy", "pickle"]
)
def test_a_copy_of_a_planner_answers_alike_and_goes_its_own_way(copied):
    planner, plan = static_planner("edge")
    planner.update(20, 20, np.ones((30, 3)))
    wanted = plan("nnpp", START)
    other = copied(planner)
    again = other.plan(START, GOAL, method="nnpp")
    assert (again.cost, facts(again.path)) == (wanted.cost, facts(wanted.path))
    assert other.update(0, 0, np.ones((SHAPE[0], 2))) == 2 * SHAPE[0]
    assert facts(plan("nnpp", START).path) == facts(wanted.path)


def told_by(plan):
    """Its summary, as JSON gives it back."""
    return json.loads(json.dumps(plan.summary(), allow_nan=False))


def test_what_a_plan_says_is_short_and_ready_for_json():
    plan = Plan(Status.NO_PATH, Method.ASTAR)
    assert plan.cost == plan.length == plan.traverse_cost == plan.bound == math.inf
    assert (plan.ok, plan.lower_bound, plan.path.shape) == (False, 0.0, (0, 2))
    told = told_by(plan)
    assert (told["status"], told["method"], told["source"]) == ("NO_PATH", "astar", None)
    assert told["cost"] is told["bound"] is told["threshold"] is None
    planner = DynamicPlanner(rough(), GOAL, "corridor-dstar")
    planner.move(START)
    plan = planner.replan()
    lines = str(plan).splitlines()
    assert len(lines) < 12 and max(map(len, lines)) < 120
    assert lines[0].split() == ["status", "OK"] and f"{plan.cost:.6g}, likely" in str(plan)
    assert len(repr(plan)) < 1200 and "array" not in repr(plan)
    told = told_by(plan)
    assert (told["method"], told["source"], told["status"]) == ("corridor-dstar", "region", "OK")
    assert (plan.method, plan.source, told["cells"]) == ("corridor", "region", len(plan.path))
    assert plan.length == pytest.approx(np.hypot(*np.diff(plan.path, axis=0).T).sum())
    assert plan.traverse_cost == pytest.approx(rough()[tuple(plan.path.T)].sum(), rel=1e-5)
    numbers = [told["cost"], told["bound"]]
    assert numbers == pytest.approx([plan.cost, plan.cost / plan.lower_bound], abs=1e-6)
    times = told["timings_ms"]
    assert 2 * times["total"] >= sum(times.values()) - 0.01


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
        assert planner.standing().footing is (
            Footing.VALID if planner.goal == ENDS[1] else Footing.NONE
        )
    assert line > 10


@pytest.mark.parametrize("kind", [Planner, DynamicPlanner])
def test_a_second_thread_is_refused_while_the_first_is_at_work(kind):
    cost = np.full((30, 40), 0.3)
    inside = threading.Event()
    leave = threading.Event()
    found = []

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
