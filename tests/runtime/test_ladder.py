"""The rungs of the loop's ladder, seen from outside: what a late tick answers, and one whose path has got worse."""

import numpy as np
import pytest

from nnpp_edge.runtime import Goal, MapPatch, Navigator, NavigatorSettings, Origin, Pose, World

STEP = 1.0 + 2 * 2.805 * 0.2
"""What a straight step costs where the map costs 0.2."""


class Clock:
    """Seconds that pass by themselves each time somebody looks."""

    now, step = 0.0, 1e-6

    def __call__(self):
        self.now += self.step
        return self.now


def two_lanes():
    """Two ways of one cell's width, of the same cost, from one side to the other."""
    cost = np.full((3, 61), 0.2, np.float32)
    cost[1, 1:-1] = np.inf
    return cost


def made_dearer(share):
    """A navigator whose standing path costs more by a share of itself since it was planned, and that path."""
    clock = Clock()
    navigator = Navigator(World(two_lanes()), NavigatorSettings("astar", tolerance=0.02), clock=clock)
    navigator.offer(Pose(1.5, 0.5))
    navigator.offer(Goal(1, 60))
    return navigator, clock, lambda: raise_cost(navigator, share)


def raise_cost(navigator, share):
    path = navigator.tick().path
    row, col = path[len(path) // 2].tolist()
    more = share * 60 * STEP / (2 * 2.805)  # each cell counts in two steps
    navigator.offer(MapPatch(row, col - 4, cost=np.full((1, 10), 0.2 + more / 10, np.float32)))
    return row


@pytest.mark.parametrize(("share", "origin"), [(0.015, Origin.STANDING), (0.03, Origin.FULL), (0.3, Origin.FULL)])
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


@pytest.mark.parametrize("reload", [False, True])
def test_a_method_that_was_slow_once_is_not_trusted_after_one_quick_answer_but_another_network_is(reload):
    navigator, clock, make_dearer = made_dearer(0.3)
    clock.step = 1.0
    make_dearer()
    clock.step = 1e-6
    if reload:
        navigator.reload()
    else:
        assert navigator.tick().origin is Origin.FULL  # there is time enough
        make_dearer()
    message = navigator.tick(deadline=clock.now + 0.5)
    assert message.ok and message.origin is (Origin.FULL if reload else Origin.CORRIDOR)
    assert message.degraded is not reload and navigator.counters().reloads == reload


@pytest.mark.parametrize(
    ("cell", "status"), [((18, 13), "OK"), ((17, 13), "START_BLOCKED"), ((17, 12), "START_BLOCKED")]
)
def test_a_robot_in_an_obstacle_starts_beside_it_no_farther_than_its_radius(cell, status):
    """What is free begins at (20, 15); the radius is 3 cells as the crow flies."""
    cost = np.full((30, 30), np.inf, np.float32)
    cost[20:, 15:] = 0.2
    navigator = Navigator(World(cost), NavigatorSettings("astar", snap_radius=3))
    navigator.offer(Goal(25, 25))
    navigator.offer(Pose(cell[0] + 0.5, cell[1] + 0.5))
    message = navigator.tick()
    assert message.outcome == status and message.start_moved == message.ok
