"""Searches that go on from one tick to the next: what they find while the map and the robot's place
change, and how little each slice may do.

More maps: ``NNPP_EDGE_MAPS=500 pytest tests/runtime/test_slices.py``.
"""

import copy
import gc
import itertools
import math
import os
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    Ground,
    Loop,
    MapPatch,
    Method,
    Navigator,
    Origin,
    Plan,
    Pose,
    Source,
    Status,
    Vehicle,
)
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.planners import joining
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.dynamic import DynamicMethod
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.standing_path import Footing
from tests.pose_oracles import rocks
from tests.strategies import flat

MAPS = int(os.environ.get("NNPP_EDGE_MAPS", "3"))
CELL_M = 0.25
SHAPE = (120, 120)
START, GOAL = (12, 12), (105, 104)
ROBOTS = {
    "point": None,
    "body": Vehicle(1.3, 0.9, 0.3),
    "arcs": Vehicle(1.3, 0.9, 0.3, turning_radius_m=1.1, reverse_cost=1.5),
}
pytestmark = pytest.mark.parametrize("robot", ROBOTS)


def moving(robot, dem, method="auto"):
    planner = DynamicPlanner.of_elevation(
        dem, CELL_M, GOAL, vehicle=ROBOTS[robot], method=method, warn=False
    )
    planner.move(START, 100.0)
    return planner


def sliced(planner, between=lambda: None, **options):
    """The plan of a search by the shortest slices, and how many they were."""
    for slices in range(1, 20_000):
        plan = planner.replan(time_limit_s=0.0, goes_on=True, **options)
        if plan.status is not Status.TIMEOUT:
            return plan, slices
        between()
    raise AssertionError("the search does not end")


def near_the_best(plan, exact):
    """Whether a plan's bound holds beside a new search, and its path costs little more."""
    best = exact.replan().cost
    return plan.lower_bound <= best * (1 + 1e-5) and plan.cost <= 1.1 * best


def walled():
    """A plane with a wall across, and a gate in its middle."""
    dem = np.zeros(SHAPE)
    dem[58:62] = 5.0
    dem[58:62, 50:70] = 0.0
    return dem


@pytest.mark.parametrize("method", ["auto", "corridor", "astar", "dstar"])
def test_on_a_map_that_stays_a_search_in_slices_finds_what_one_at_once_finds(robot, method):
    dem = rocks(5, *SHAPE, 0.004)
    at_once = moving(robot, dem, method).replan()
    planner = moving(robot, dem, method)
    plan, slices = sliced(planner)
    assert at_once.ok and slices > 1 and not planner.searching
    assert np.array_equal(plan.walked, at_once.walked)
    assert (plan.cost, plan.lower_bound) == (at_once.cost, at_once.lower_bound)
    assert plan.expansions == at_once.expansions


def test_a_brief_search_is_as_brief_in_slices(robot):
    """The goal is near, behind a wall."""
    dem = walled()
    dem[58:62, 50:70] = 5.0
    dem[58:62, 100:] = 0.0
    plans = []
    for goes_on in (False, True):
        planner = moving(robot, dem)
        planner.set_goal((66, 50))
        planner.move((54, 50), 0.0)
        plans.append(sliced(planner)[0] if goes_on else planner.replan())
    at_once, plan = plans
    assert plan.ok and plan.choice == at_once.choice and plan.expansions == at_once.expansions
    assert robot == "arcs" or "corridor" in plan.choice


@pytest.mark.parametrize("seed", range(MAPS))
def test_while_the_map_changes_a_search_ends_at_a_path_that_the_newest_map_allows(robot, seed):
    dem = rocks(seed, *SHAPE, 0.004)
    planner = moving(robot, dem, ("auto", "dstar")[seed % 2])
    rng = np.random.default_rng(seed)
    left = [12]

    def change():
        if left[0] and rng.random() < 0.1:
            left[0] -= 1
            row, col = rng.integers(20, 90, 2)
            patch = dem[row : row + 6, col : col + 6]
            patch[2:4, 2:4] += rng.choice([-0.5, 0.5])
            planner.update_elevation(row, col, patch)

    plan, _ = sliced(planner, change)
    exact = moving(robot, dem, "astar").replan()
    assert plan.ok == exact.ok
    if plan.ok:
        assert planner.first_blocked(plan.walked) < 0
        walked = np.empty(len(plan.path))
        planner.state.grid.walk(plan.walked, 0, walked)
        assert plan.cost == pytest.approx(walked[-1], rel=1e-6)
        assert plan.lower_bound <= exact.cost * (1 + 1e-5)
        assert exact.lower_bound <= plan.cost * (1 + 1e-5)


def before_the_last_slice(planner, change):
    """The plan of a search during which the map changes when there is one slice left to do."""
    _, slices = sliced(copy.deepcopy(planner))
    number = itertools.count(2)
    plan, _ = sliced(planner, lambda: change() if next(number) == slices else None)
    return plan


def test_no_path_is_no_answer_of_a_search_during_which_the_wall_was_opened(robot):
    dem = walled()
    dem[58:62] = 5.0
    planner = moving(robot, dem)
    plan = before_the_last_slice(
        planner, lambda: planner.update_elevation(58, 50, np.zeros((4, 20)))
    )
    assert plan.ok


def test_a_bound_of_the_map_as_it_was_is_none_once_a_shorter_way_was_opened(robot):
    dem = walled()
    dem[58:62, 45:75] = 5.0
    dem[58:62, 100:] = 0.0
    planner = moving(robot, dem, "astar")
    dem[58:62, 50:70] = 0.0
    plan = before_the_last_slice(
        planner, lambda: planner.update_elevation(58, 50, dem[58:62, 50:70])
    )
    exact = moving(robot, dem, "astar").replan()
    assert plan.ok and exact.cost < 0.95 * plan.cost and plan.lower_bound <= exact.cost


def test_a_path_that_was_blocked_while_it_was_searched_for_is_no_answer(robot):
    dem = walled()
    dem[58:62, 100:] = 0.0
    planner = moving(robot, dem)
    plan = before_the_last_slice(
        planner, lambda: planner.update_elevation(58, 45, np.full((4, 30), 5.0))
    )
    assert plan.ok and planner.first_blocked(plan.walked) < 0
    assert (plan.path[:, 1] > 95).any()


def test_no_path_is_the_answer_where_the_map_only_got_more_walls(robot):
    """Of a point: a body's changes do not tell whether they opened a way."""
    dem = walled()
    dem[58:62] = 5.0
    planner = moving(robot, dem)
    planner.replan(time_limit_s=0.0, goes_on=True)
    planner.update_elevation(30, 30, np.full((4, 4), 5.0))
    plan, _ = sliced(planner)
    assert plan.status is Status.NO_PATH


def test_a_path_begins_where_the_robot_is_by_then(robot):
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    planner.replan(time_limit_s=0.0, goes_on=True)
    for cell in ((13, 14), (14, 16)):
        planner.move(cell, 120.0)
        plan = planner.replan(time_limit_s=0.0, goes_on=True)
    plan, _ = sliced(planner)
    assert tuple(plan.path[0]) == (14, 16) and tuple(plan.path[-1]) == GOAL
    assert planner.first_blocked(plan.walked) < 0
    assert plan.states is None or plan.states[0] % 16 == planner.state.grid.robot.moves.direction(
        120.0
    )
    exact = moving(robot, rocks(5, *SHAPE, 0.004), "astar")
    exact.move((14, 16), 120.0)
    assert near_the_best(plan, exact)


def test_a_slice_does_little_more_than_its_time_allows(robot):
    """One of no time at all: the clock is looked at after few states, as each may check poses."""
    planner = moving(robot, rocks(5, *SHAPE, 0.01))
    planner.prepare()
    stance = planner.state.grid.robot.stance
    checks = [stance.checks]
    status = Status.TIMEOUT
    while status is Status.TIMEOUT:
        status = planner.replan(time_limit_s=0.0, goes_on=True).status
        checks.append(stance.checks)
    checked = np.diff(checks)
    assert max(checked) <= 6000 and np.quantile(checked, 0.99) <= 800


@pytest.mark.parametrize("drop", ["goal", "method", "at once", "broken off"])
def test_a_search_that_is_dropped_opens_the_links_that_it_closed(robot, drop, monkeypatch):
    """A body's search closes links of coarse levels: posts, between which none passes, are cheap on
    average. Their gap is aside.
    """
    opened = []
    close = CoarseLevel.close_dead_ends

    def noted(self, *given):
        before = self.level.links.copy()
        closed = close(self, *given)
        opened.append((self.level, before & ~self.level.links))
        return closed

    monkeypatch.setattr(CoarseLevel, "close_dead_ends", noted)
    dem = flat(256, 256)
    dem[::4, 128] = 0.06
    dem[20:44, 128] = 0.0
    vehicle = ROBOTS[robot] and replace(ROBOTS[robot], clearance_m=0.05, max_step_m=0.04)
    ends = ((150, 20), (150, 230))
    planner = DynamicPlanner.of_elevation(dem, CELL_M, ends[1], warn=False, vehicle=vehicle)
    planner.move(ends[0])
    plan = planner.replan(time_limit_s=0.0, goes_on=True)
    while robot != "point" and not opened and plan.status is Status.TIMEOUT:
        plan = planner.replan(time_limit_s=0.0, goes_on=True)
    assert planner.searching and (opened or robot == "point")
    if drop == "goal":
        planner.set_goal((100, 20))
    elif drop == "method":
        planner.replan(method="astar", time_limit_s=0.0, goes_on=True)
    elif drop == "broken off":
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(planner.state, "update", interrupted)
            planner.update(0, 0, flat(1, 1))
        planner.standing()
    else:
        planner.replan(method="astar")
    assert planner.searching == (drop == "method")
    for level, closed in opened:
        assert closed.any() and not (closed & ~level.links).any()


def interrupted(*given):
    raise KeyboardInterrupt


def test_pauses_are_no_time_of_the_search(robot, monkeypatch):
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    now = [0.0]
    monkeypatch.setattr("nnpp_edge.runtime.stopwatch.time.perf_counter", lambda: now[0])
    plan, slices = sliced(planner, lambda: now.__setitem__(0, now[0] + 1.0))
    assert slices > 1 and sum(plan.timings_ms.values()) == 0.0


def test_the_robot_follows_what_is_clear_of_its_path_while_a_search_goes_on(robot, monkeypatch):
    monkeypatch.setattr(joining, "JOIN_EXPANSIONS", 1)
    dem = walled()
    ground = Ground.of_elevation(dem, CELL_M, vehicle=ROBOTS[robot])
    navigator = Navigator(ground, slice_ms=0.0)
    navigator.offer(Goal(*GOAL))
    navigator.offer(Pose(12.5, 12.5, heading_deg=100.0))
    first = navigator.tick()
    assert first.ok and not first.goal_moved
    # the gate is walled up but for its left side; the search has not seen that yet
    navigator.planner.replan = unanswered(navigator.planner)
    navigator.offer(MapPatch(58, 57, elevation=np.full((4, 13), 5.0)))
    message = navigator.tick()
    assert message.ok and message.degraded and message.goal_moved
    assert message.origin is Origin.STANDING and "goes on" in message.reason
    assert navigator.planner.first_blocked(message.walked) < 0
    assert np.array_equal(message.path, first.path[: len(message.path)])
    assert message.goal == tuple(message.path[-1]) and message.goal[0] < 58
    assert 0 < message.cost < first.cost and message.lower_bound == 0.0
    del navigator.planner.replan
    again = navigator.tick()
    assert again.ok and not again.goal_moved and again.goal == GOAL


def unanswered(planner):
    """A `replan` whose slices have no time at all."""
    replan = type(planner).replan
    return lambda **options: replan(planner, **(options | {"time_limit_s": 0.0}))


def test_ticks_with_a_deadline_work_their_slice_and_those_without_until_the_end(robot):
    asked = []
    navigator = Navigator(Ground.of_elevation(np.zeros(SHAPE), CELL_M, vehicle=ROBOTS[robot]))
    replan = navigator.planner.replan

    def noted(**options):
        asked.append((options["goes_on"], options["time_limit_s"]))
        return replan(**options)

    navigator.planner.replan = noted
    navigator.offer(Pose(12.5, 12.5, heading_deg=100.0))
    for n, deadline in enumerate((math.inf, 1e12)):
        navigator.offer(Goal(*GOAL, stamp=n))
        navigator.planner.set_goal((0, 0))
        navigator.tick(deadline=deadline)
    assert asked == [(True, math.inf), (True, 0.01)]
    assert DynamicMethod.AUTO is navigator.planner.method


def test_why_there_is_no_path_is_told_in_slices_too(robot, monkeypatch):
    dem = walled()
    dem[58:62] = 5.0
    at_once = moving(robot, dem).replan()
    counts = []
    for words in (1 << 18, 1 << 12):
        monkeypatch.setattr("nnpp_edge.runtime.search.workspace._AT_ONCE", words)
        plan, slices = sliced(moving(robot, dem))
        assert plan.status is Status.NO_PATH and plan.reason == at_once.reason
        counts.append(slices)
    assert robot == "point" or counts[1] > counts[0]


@pytest.fixture
def detour(robot, monkeypatch):
    """A planner whose standing path is blocked far ahead, and whose search for another goes on from
    a place on it; and that path's plan.
    """
    monkeypatch.setattr(joining, "JOIN_EXPANSIONS", 1)
    dem = walled()
    planner = moving(robot, dem)
    first = planner.replan()
    planner.update_elevation(58, 57, np.full((4, 13), 5.0))
    for _ in range(2):
        planner.replan(time_limit_s=0.0, goes_on=True)
    return planner, first


def test_a_long_search_starts_ahead_of_the_robot_and_its_path_leads_there_first(robot, detour):
    planner, first = detour
    ahead = len(planner.clear_part().path) - 1
    assert ahead == 16
    planner.move(tuple(first.path[3].tolist()), float(first.headings_deg[3]))
    plan, _ = sliced(planner)
    assert plan.ok and np.array_equal(plan.walked[: ahead - 3], first.walked[3:ahead])
    assert planner.first_blocked(plan.walked) < 0 and tuple(plan.path[-1]) == GOAL
    walked = np.empty(len(plan.path))
    planner.state.grid.walk(plan.walked, 0, walked)
    assert plan.cost == pytest.approx(walked[-1], rel=1e-6) and planner.standing().valid


def test_where_the_way_to_its_start_is_blocked_a_search_begins_anew(robot, detour):
    planner, first = detour
    row, col = first.path[10].tolist()
    planner.update_elevation(row - 1, col - 1, np.full((3, 3), 5.0))
    plan = planner.replan(time_limit_s=0.0, goes_on=True)
    part = planner.clear_part()
    assert part is None or len(part.path) <= planner.standing().blocked - 7
    if not plan.ok:
        plan, _ = sliced(planner)
    assert plan.ok and tuple(plan.path[0]) == START and planner.first_blocked(plan.walked) < 0


def test_a_search_from_ahead_that_finds_nothing_is_followed_by_one_from_the_robot(robot, detour):
    planner, _ = detour
    planner.update_elevation(58, 50, np.full((4, 20), 5.0))
    plan, _ = sliced(planner)
    assert plan.status is Status.NO_PATH


def test_a_tick_gives_a_search_one_slice_also_where_its_path_was_blocked_meanwhile(robot):
    asked = []
    navigator = Navigator(Ground.of_elevation(np.zeros(SHAPE), CELL_M, vehicle=ROBOTS[robot]))
    nothing = Plan(Status.TIMEOUT, Method.AUTO)
    navigator.planner.replan = lambda **options: asked.append(options) or nothing
    navigator.offer(Goal(*GOAL))
    navigator.offer(Pose(12.5, 12.5, heading_deg=100.0))
    assert navigator.tick(deadline=1e12).outcome is Status.TIMEOUT
    assert len(asked) == 1 and not navigator.planner.searching


def test_another_thread_begins_a_search_anew(robot):
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    planner.replan(time_limit_s=0.0, goes_on=True)
    assert planner.searching
    with ThreadPoolExecutor(1) as other:
        plan = other.submit(planner.replan, goes_on=True).result()
    assert plan.ok and not planner.searching


def test_a_search_that_is_dropped_within_another_ends_alone(robot, monkeypatch):
    dem = rocks(5, *SHAPE, 0.004)
    dropped = [moving(robot, dem)]
    dropped[0].replan(time_limit_s=0.0, goes_on=True)
    assert dropped[0].searching
    plan = Methods.plan

    def dropping(*given, **options):
        dropped.clear()
        return plan(*given, **options)

    monkeypatch.setattr(Methods, "plan", dropping)
    assert sliced(moving(robot, dem))[0].ok


def test_a_search_that_raised_is_over(robot):
    planner = moving(robot, np.zeros(SHAPE))
    raised = []

    def broken(*given, **options):
        raised.append(1)
        raise ModelError("no such network")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nnpp_edge.runtime.planners.methods.Methods.plan", broken)
        for _ in range(2):
            with pytest.raises(ModelError, match="no such network"):
                planner.replan(time_limit_s=0.0, goes_on=True)
    assert len(raised) == 2 and not planner.searching
    assert sliced(planner)[0].ok


# --- the ends move, and the map changes, while a search goes on


def test_a_search_is_kept_where_the_goal_moves_a_little_and_its_path_leads_there(robot):
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    goals = itertools.cycle([(103, 104)])
    plan, _ = sliced(planner, lambda: planner.set_goal(next(goals)))
    assert plan.ok and tuple(plan.path[-1].tolist()) == planner.goal
    assert tuple(plan.path[0]) == START and planner.first_blocked(plan.walked) < 0
    exact = moving(robot, rocks(5, *SHAPE, 0.004), "astar")
    exact.set_goal(planner.goal)
    assert near_the_best(plan, exact)


def test_a_goal_that_moves_far_drops_the_search_and_the_path(robot):
    planner = moving(robot, np.zeros(SHAPE))
    assert planner.replan().ok
    planner.replan(time_limit_s=0.0, goes_on=True)
    planner.set_goal((60, 20))
    assert not planner.searching and planner.joined() is None


def test_the_path_to_where_the_goal_was_is_led_on_to_where_it_is(robot, monkeypatch):
    """While a search is paused in the middle."""
    monkeypatch.setattr("nnpp_edge.runtime.planners.dynamic.JOIN_MS", 1e6)
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    first = planner.replan()
    goal = (104, 100)
    planner.set_goal(goal)
    assert planner.standing_plan is None and planner.standing().footing is Footing.NONE
    planner.replan(time_limit_s=0.0, goes_on=True)
    planner.move(tuple(first.path[2].tolist()), float(first.headings_deg[2]))
    plan = planner.joined()
    assert plan.ok and tuple(plan.path[-1].tolist()) == goal and planner.standing().valid
    assert np.array_equal(plan.path[:20], first.path[2:22]) and plan.waypoints is None
    assert planner.searching and sliced(planner)[0].ok


def test_a_robot_beside_its_path_is_led_back_to_it_and_around_blocks(robot, monkeypatch):
    monkeypatch.setattr("nnpp_edge.runtime.planners.dynamic.JOIN_MS", 1e6)
    planner = moving(robot, np.zeros(SHAPE))
    first = planner.replan()
    for number in (40, 70):
        planner.update_elevation(*first.path[number].tolist(), np.full((1, 1), 5.0))
    planner.move((12, 16), 100.0)
    plan = planner.joined()
    assert plan.ok and tuple(plan.path[0]) == (12, 16) and tuple(plan.path[-1]) == GOAL
    assert plan.states is None or plan.states[0] % 16 == planner.state.grid.robot.moves.direction(
        100.0
    )
    planner.move(GOAL)  # where it stands, and there an obstacle comes
    planner.update(*GOAL, np.ones((1, 1)))
    assert planner.joined() is None


def test_a_path_is_led_to_the_heading_in_which_it_is_to_arrive_now(robot, monkeypatch):
    monkeypatch.setattr("nnpp_edge.runtime.planners.dynamic.JOIN_MS", 1e6)
    planner = moving(robot, np.zeros(SHAPE))
    assert planner.replan().ok
    for heading in (180.0, 90.0):
        planner.set_goal(GOAL, heading)
        plan = planner.joined()
        assert plan.ok and (robot != "arcs" or plan.headings_deg[-1] == pytest.approx(heading))


@pytest.mark.parametrize(("side", "source"), [(5, Source.STANDING), (20, Source.REGION)])
def test_auto_searches_anew_where_the_way_round_a_block_costs_much_more(robot, side, source):
    """A diagonal wall, two cells thick; a body on feet turns on the spot to go round it."""
    planner = moving(robot, np.zeros(SHAPE))
    first = planner.replan()
    wall = np.eye(side) + np.eye(side, k=1)
    row, col = first.path[len(first.path) // 2] - side // 2
    planner.update(row, col, wall[:, ::-1])
    assert planner.replan().source == {"point": Source.MAP, "body": Source.REGION}.get(
        robot, source
    )


@pytest.fixture
def enclosed(robot):
    """A planner to a goal behind a wall that leaves no way."""
    dem = walled()
    dem[58:62] = 5.0
    return moving(robot, dem)


def test_that_there_is_no_path_holds_while_nothing_opens_a_way_and_no_longer(enclosed):
    """Patches of a centimetre, on both sides of the wall."""
    rng = np.random.default_rng(3)

    def change():
        row, col = rng.choice((20, 30, 80, 100)), rng.integers(10, 100)
        enclosed.update_elevation(row, col, np.full((3, 3), rng.uniform(0.0, 0.01)))

    def seldom():
        if rng.random() < 0.02:
            change()

    plan, _ = sliced(enclosed, seldom)
    assert plan.status is Status.NO_PATH and not enclosed.searching
    for _ in range(20):
        change()
        enclosed.move(START, rng.uniform(60.0, 140.0))
        assert enclosed.replan(time_limit_s=0.0, goes_on=True).status is Status.NO_PATH
        assert not enclosed.searching
    enclosed.update_elevation(58, 50, np.zeros((4, 20)))
    assert enclosed.replan(time_limit_s=0.0, goes_on=True).status is Status.TIMEOUT
    assert sliced(enclosed)[0].ok


def test_once_another_search_has_had_its_memory_no_path_is_searched_anew(enclosed):
    assert sliced(enclosed)[0].status is Status.NO_PATH
    enclosed.set_goal((START[0] + 6, START[1]))
    assert enclosed.replan().ok
    enclosed.set_goal(GOAL)
    enclosed.update_elevation(58, 50, np.zeros((4, 20)))
    assert sliced(enclosed)[0].ok


@pytest.mark.parametrize("seed", range(MAPS))
def test_no_path_is_said_only_while_a_search_from_scratch_finds_none(robot, seed):
    """Walls that are opened and shut, in small pieces."""
    rng = np.random.default_rng(seed)
    dem = walled()
    dem[58:62] = 5.0
    dem[:, 58:62] = 5.0
    planner = moving(robot, dem)
    said = Counter()
    for _ in range(40):
        row, col = rng.integers(54, 64, 2)
        if rng.random() < 0.5:
            row = rng.integers(0, SHAPE[0] - 12)
        else:
            col = rng.integers(0, SHAPE[1] - 12)
        planner.update_elevation(row, col, np.full((12, 12), rng.choice((0.0, 0.0, 5.0))))
        if planner.is_passable(START) and planner.is_passable(GOAL):
            plan = planner.replan(time_limit_s=0.0, goes_on=True)
            plan = plan if plan.status is Status.NO_PATH else sliced(planner)[0]
            exact = moving(robot, planner.state.elevation(), "astar").replan()
            assert plan.ok == exact.ok
            said[plan.status] += 1
    assert len(said) == 2


def test_a_goal_without_a_path_is_approached_in_slices(enclosed):
    plan, _ = sliced(enclosed, approach=True)
    enclosed.update_elevation(30, 30, np.full((2, 2), 0.001))
    end = tuple(plan.path[-1].tolist())
    assert plan.ok and end != GOAL and 40 < end[0] < 58 and abs(end[1] - GOAL[1]) < 8
    assert enclosed.standing().valid and enclosed.search_due
    again, _ = sliced(enclosed, approach=True)
    assert tuple(again.path[-1].tolist()) == end and not enclosed.search_due


def test_a_planner_that_is_dropped_in_a_search_frees_its_memory_at_once(robot):
    planner = moving(robot, rocks(5, *SHAPE, 0.004))
    planner.replan(time_limit_s=0.0, goes_on=True)
    assert planner.searching
    held = [weakref.ref(planner), weakref.ref(planner.state), weakref.ref(planner.state.grid)]
    gc.disable()
    del planner
    gc.enable()
    assert [each() for each in held] == [None] * 3


def test_a_loop_searches_on_in_the_time_that_its_ticks_leave(robot):
    navigator = Navigator(
        Ground.of_elevation(rocks(5, *SHAPE, 0.004), CELL_M, vehicle=ROBOTS[robot]), slice_ms=0.0
    )
    inputs = iter([[Goal(*GOAL), Pose(12.5, 12.5, heading_deg=100.0)]])
    answers = []
    source = SimpleNamespace(poll=lambda: next(inputs, []))
    loop = Loop(navigator, source, rate_hz=20.0, after_tick=answers.append)
    loop.run(6)
    assert answers[-1].ok and (answers[0].outcome is Status.TIMEOUT or robot == "point")
    assert navigator.counters().errors == {}


def test_a_search_that_fails_between_ticks_is_counted(robot, monkeypatch):
    navigator = Navigator(Ground.of_elevation(np.zeros(SHAPE), CELL_M, vehicle=ROBOTS[robot]))
    slices = []

    def failing(searching, until):
        slices.append(until)
        if len(slices) > 1:
            raise ModelError("no such network")

    monkeypatch.setattr("nnpp_edge.runtime.planners.searching.Searching.go_on", failing)
    navigator.offer(Goal(*GOAL))
    navigator.offer(Pose(12.5, 12.5, heading_deg=100.0))
    assert navigator.tick(deadline=1e12).outcome is Status.TIMEOUT
    assert not navigator.go_on(0.1) and navigator.counters().errors == {"search": 1}
    assert not navigator.planner.searching and not navigator.go_on(0.1)
