"""What the loop answers late, and where it goes in place of a goal that it cannot reach."""

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    Ground,
    MapPatch,
    Method,
    Navigator,
    Origin,
    Plan,
    Planner,
    Pose,
    Status,
    Vehicle,
)
from nnpp_edge.runtime.planners.approach import place_towards
from tests.pose_oracles import rocks
from tests.strategies import flat

STEP = 1.0 + 2 * 2.805 * 0.2
"""What a straight step costs where the map costs 0.2."""


class Clock:
    """Seconds that pass by themselves each time somebody looks."""

    now = 0.0
    step = 1e-6

    def __call__(self):
        self.now += self.step
        return self.now


def two_lanes():
    """Two ways of one cell's width, of the same cost, from one side to the other."""
    cost = flat(3, 61, 0.2)
    cost[1, 1:-1] = np.inf
    return cost


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Kernels are there before a search has half a second."""
    planner = DynamicPlanner(two_lanes(), (1, 60), "corridor")
    planner.move((1, 0))
    assert planner.replan().ok


def made_dearer(share):
    """A navigator whose standing path costs more by a share of itself since it was planned, and
    that path.
    """
    clock = Clock()
    navigator = Navigator(Ground(two_lanes()), "astar", tolerance=0.02, clock=clock)
    navigator.offer(Pose(1.5, 0.5))
    navigator.offer(Goal(1, 60))
    return navigator, clock, lambda: raise_cost(navigator, share)


def raise_cost(navigator, share):
    path = navigator.tick().path
    row, col = path[len(path) // 2].tolist()
    more = share * 60 * STEP / (2 * 2.805)  # each cell counts in two steps
    navigator.offer(MapPatch(row, col - 4, cost=flat(1, 10, 0.2 + more / 10)))
    return row


@pytest.mark.parametrize(
    ("share", "origin"), [(0.015, Origin.STANDING), (0.03, Origin.FULL), (0.3, Origin.FULL)]
)
def test_a_path_is_kept_while_it_is_at_most_so_much_dearer_than_a_new_one(share, origin):
    navigator, _, make_dearer = made_dearer(share)
    lane = make_dearer()
    message = navigator.tick()
    assert message.ok and message.origin is origin
    assert (message.path[30, 0] == lane) == (origin is Origin.STANDING)


def test_a_tick_that_is_late_keeps_a_path_that_still_leads_there_and_says_so():
    navigator, clock, make_dearer = made_dearer(0.3)
    clock.step = 1.0  # planning seems to take seconds
    lane = make_dearer()
    message = navigator.tick(deadline=clock.now)
    assert message.ok and message.origin is Origin.STANDING and message.degraded
    assert message.path[30, 0] == lane and navigator.counters().degraded == {"late": 1}
    clock.step = 1e-6
    assert navigator.tick().origin is Origin.FULL


def test_a_method_that_was_slow_is_tried_again_after_a_while():
    navigator, clock, make_dearer = made_dearer(0.3)
    clock.step = 1.0
    make_dearer()
    clock.step = 1e-6
    origins = []
    navigator.offer(
        Goal(2, 60)
    )  # one quick answer, for which there is time enough, is no reason to trust it
    assert navigator.tick().origin is Origin.FULL
    for n in range(30):
        navigator.offer(Goal(2 * (n % 2), 60))
        origins.append(navigator.tick(deadline=clock.now + 0.5).origin)
    skipped = origins.count(Origin.CORRIDOR)
    assert 8 <= skipped <= 20  # until some seconds, shrunk by a tenth each time, fit
    assert origins == [*[Origin.CORRIDOR] * skipped, *[Origin.FULL] * (30 - skipped)]
    assert navigator.counters().degraded.get("late", 0) == skipped


def test_quick_answers_without_a_path_are_no_reason_to_trust_a_slow_method(monkeypatch):
    clock = Clock()
    asked = []
    navigator = Navigator(Ground(two_lanes()), "astar", clock=clock)
    replan = navigator.planner.replan

    def answer(method=None, time_limit_s=0.0, **options):
        asked.append(method)
        if len(asked) == 1:
            clock.now += 1.0
            return replan()
        return Plan(Status.NO_PATH, Method.ASTAR)

    monkeypatch.setattr(navigator.planner, "replan", answer)
    navigator.offer(Pose(1.5, 0.5))
    navigator.offer(Goal(1, 60))
    assert navigator.tick().ok
    navigator.offer(Goal(2, 60))
    for _ in range(5):
        assert navigator.tick().outcome is Status.NO_PATH
    navigator.tick(deadline=clock.now + 0.5)
    assert asked == [*[None] * 6, "corridor"]


@pytest.mark.parametrize(
    ("cell", "status"), [((18, 13), "OK"), ((17, 13), "START_BLOCKED"), ((17, 12), "START_BLOCKED")]
)
def test_a_robot_in_an_obstacle_starts_beside_it_no_farther_than_its_radius(cell, status):
    """What is free begins at (20, 15); the radius is 3 cells as the crow flies."""
    cost = flat(30, 30, np.inf)
    cost[20:, 15:] = 0.2
    navigator = Navigator(Ground(cost), "astar", snap_radius=3)
    navigator.offer(Goal(25, 25))
    navigator.offer(Pose(cell[0] + 0.5, cell[1] + 0.5))
    message = navigator.tick()
    assert message.outcome == status and message.start_moved == message.ok
    assert not message.ok or message.start == (20, 15)


FREE = np.float32(0.2)


def reached_from(cost, start):
    return Planner(np.where(np.isnan(cost), np.inf, cost)).reach(start)


def place_for(cost, goal, start, margin=2, present=None):
    """On a map of costs, NaN where unknown."""
    beyond = np.zeros(cost.shape, np.bool_)
    if cost[goal] < 1.0:
        beyond = np.isfinite(reached_from(cost, goal))
    beyond[goal] = True
    return place_towards(
        goal, start, reached_from(cost, start), beyond, np.isnan(cost), margin, present
    )


def drive(ground, truth, start, goal, *, sight, ticks):
    """Go two cells a tick along the loop's path, and see so far; the cells driven, and the last
    answer.
    """
    nav = Navigator(ground, approach=True)
    nav.offer(Goal(*goal))
    driven = [start]
    down, right = np.ogrid[: truth.shape[0], : truth.shape[1]]
    for _ in range(ticks):
        row, col = driven[-1]
        seen = np.where(np.hypot(down - row, right - col) <= sight, truth, np.float32(np.nan))
        nav.offer(
            MapPatch(
                0, 0, **{"cost" if ground.elevation is None else "elevation": seen}, keep_known=True
            )
        )
        nav.offer(Pose(row + 0.5, col + 0.5))
        message = nav.tick()
        driven += [tuple(cell) for cell in message.path[1:3].tolist()]
        if driven[-1] == goal:
            break
    return driven, message


def test_where_arcs_do_not_lead_to_a_place_another_is_approached():
    """Over their cells alone there would be a way."""
    dem = rocks(5, 120, 120, 0.012)
    dem[60:62] += 5.0
    car = Vehicle(4.3, 1.8, 0.3, turning_radius_m=5.0, reverse_cost=1.5)
    planner = DynamicPlanner.of_elevation(dem, 0.25, (112, 112), vehicle=car, warn=False)
    planner.move((10, 10))
    plan = planner.replan(approach=True)
    assert plan.ok
    end = tuple(plan.path[-1].tolist())
    planner.set_goal(end, 0.0)  # no path arrives so: there all the same
    assert tuple(planner.replan(approach=True).path[-1]) == end


def test_the_way_over_the_edge_of_the_unknown_is_the_shortest():
    """By all cells at the edge: the cost to there, in cells of usual cost, and the distance from
    there.
    """
    rng = np.random.default_rng(3)
    cost = np.where(rng.random((40, 50)) < 0.2, np.inf, FREE).astype(np.float32)
    cost[:, 30:] = np.nan
    cost[20, 20] = FREE
    cost[32:35, 20:23] = np.nan  # a hole, apart from the ground that holds the goal
    start = (20, 20)
    goal = (33, 45)
    costs = reached_from(cost, start)
    cells = [cell for cell in np.ndindex(cost.shape) if np.isfinite(costs[cell])]
    usual = np.median(
        [costs[cell] / max(np.hypot(cell[0] - 20, cell[1] - 20), 1.0) for cell in cells]
    )
    edge = [cell for cell in cells if cell[1] >= 28]  # two cells from it, or nearer
    worth = {cell: costs[cell] / usual + np.hypot(cell[0] - 33, cell[1] - 45) for cell in edge}
    place = place_for(cost, goal, start)
    best = min(worth.values())
    assert worth[place] == pytest.approx(best)
    kept = {cell: place_for(cost, goal, start, present=cell) == cell for cell in edge}
    assert kept == {cell: value <= best + 5.0 for cell, value in worth.items()}
    assert 3 < sum(kept.values()) < len(kept)
    assert place_for(cost, goal, start, present=start) == place  # which is not at the edge


def test_a_goal_that_is_known_and_shut_off_is_gone_near_to():
    cost = np.full((20, 30), FREE)
    assert place_for(cost, (15, 25), (2, 2)) == (15, 25)  # it can be reached
    cost[:, 15] = np.inf
    goal = (12, 25)
    start = (2, 2)
    assert place_for(cost, goal, start) == (12, 14)
    assert place_for(cost, goal, start, present=(9, 14)) == (9, 14)
    assert place_for(cost, goal, start, present=goal) == (12, 14)
    cost[4:7, 5:8] = np.nan  # a hole elsewhere changes nothing
    assert place_for(cost, goal, start) == (12, 14)
    cost[:3, 14:17] = np.nan  # where it is not known that the wall goes on is where a way may be
    row, col = place_for(cost, goal, start)
    assert row <= 4 and 12 <= col <= 14
    cost[:, 16:] = (
        np.nan
    )  # nothing is known beyond the wall, and no cell at its edge can be reached
    cost[:3, 14:17] = np.inf
    assert place_for(cost, goal, start, margin=1) == (12, 14)


def test_a_robot_finds_its_way_out_of_a_pocket_that_opens_away_from_the_goal():
    truth = np.full((60, 80), FREE)
    truth[20:41, 50] = truth[20, 25:51] = truth[40, 25:51] = np.inf
    ground = Ground(np.full(truth.shape, np.nan, np.float32))
    driven, message = drive(ground, truth, (30, 30), (30, 70), sight=9, ticks=150)
    assert driven[-1] == (30, 70) and message.ok and not message.goal_moved
    assert all(truth[cell] < 1.0 for cell in driven)
    assert (
        max(col for row, col in driven if 20 < row < 40 and col < 50) > 38
    )  # it saw the pocket's end first


def test_a_body_comes_as_near_to_the_unknown_as_it_can_and_goes_on():
    truth = flat(50, 70)
    truth[15:36, 30] = 1.0
    rover = Vehicle(length_m=0.6, width_m=0.4, clearance_m=0.2)
    ground = Ground.of_elevation(np.full(truth.shape, np.nan, np.float32), 0.1, vehicle=rover)
    driven, message = drive(ground, truth, (25, 10), (25, 60), sight=12, ticks=120)
    assert driven[-1] == (25, 60) and message.outcome is Status.OK
