"""A query ends at its deadline, wherever it is by then, and the next one goes on. No test here
reads a clock.
"""

import math

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner, Status, Vehicle
from nnpp_edge.runtime import bands as bands_module
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.map.pyramid import Pyramid
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method
from nnpp_edge.runtime.planners.tour import tour
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.terrain.synthetic import fractal

ROVER = Vehicle(length_m=3.0, width_m=2.4, clearance_m=0.8)
DISC = Vehicle(radius_m=1.3)
SHAPE = (192, 260)
ENDS = ((8, 8), (180, 250))
GROUND = fractal(np.random.default_rng(3), 260, 1.0, 3.0)[: SHAPE[0]].copy()
MEANS = GROUND.reshape(48, 4, 65, 4).mean((1, 3))
KINDS = ("costs", "point", "disc", "body", "tobler", "body-tobler", "coarse", "body-coarse")


class Steps(Deadline):
    """Passes at the call after so many that ask, and never for kernels."""

    def __init__(self, calls):
        super().__init__(1e12)
        object.__setattr__(self, "left", [calls])

    @property
    def left_s(self):
        self.left[0] -= 1
        return math.inf if self.left[0] >= 0 else -1.0

    def share(self, of_it):
        return self


@pytest.fixture(autouse=True)
def narrow_stripes(monkeypatch):
    monkeypatch.setattr(bands_module, "STRIPE_CELLS", 4096)
    monkeypatch.setattr("nnpp_edge.runtime.map.unseen._TOGETHER", 4096)


def made(kind, method=None):
    vehicle = {"disc": DISC, "body": ROVER}.get(kind.partition("-")[0])
    if kind == "costs":
        cost = np.abs(GROUND) / np.abs(GROUND).max()
        return Planner(cost) if method is None else DynamicPlanner(cost, ENDS[1], method)
    if kind.endswith("coarse"):
        ground = Ground.of_coarse(MEANS, 4.0, 4, prior="slope", vehicle=vehicle)
        planner = Planner(ground) if method is None else DynamicPlanner(ground, ENDS[1], method)
        planner.update_elevation(0, 0, GROUND[:150])
        return planner
    given = {"vehicle": vehicle, "step_cost": "tobler" if kind.endswith("tobler") else "paper"}
    if method is None:
        return Planner.of_elevation(GROUND, 1.0, warn=False, **given)
    return DynamicPlanner.of_elevation(GROUND, 1.0, ENDS[1], method=method, **given)


def ask(planner, method, time_limit_s=math.inf):
    if isinstance(planner, Planner):
        return planner.plan(*ENDS, method=method, time_limit_s=time_limit_s)
    planner.move(ENDS[0])
    return planner.replan(time_limit_s=time_limit_s)


def test_a_deadline_is_a_number_of_seconds_from_now_on():
    assert NEVER.left_s == math.inf and not NEVER.passed
    late = Deadline.within(0.0)
    soon = Deadline.within(1e6)
    assert late.passed and not soon.passed and Deadline.within(math.inf).at == NEVER.at
    soon.check()
    with pytest.raises(OutOfTimeError):
        late.check()


@pytest.mark.parametrize("kind", ["costs", "point", "disc", "tobler"])
def test_dstar_searches_on_where_it_was_broken_off(kind):
    planner = made(kind, "dstar")
    rng = np.random.default_rng(0)
    for tries in range(1000):
        plan = ask(planner, None, 0.0)
        if plan.status is not Status.TIMEOUT:
            break
        if tries < 20 and tries % 5 == 0:
            row, col = (int(n) for n in rng.integers(20, 150, 2))
            if kind == "costs":
                planner.update(row, col, 0.9 * rng.random((9, 9)))
            else:
                rough = GROUND[row : row + 9, col : col + 9] + rng.random((9, 9)) * 0.1
                planner.update_elevation(row, col, rough)
    assert plan.ok and tries > 20
    assert plan.cost == pytest.approx(planner.replan(method="astar").cost, rel=1e-5)
    planner.set_goal((100, 100))
    assert ask(planner, None, 0.0).status is Status.TIMEOUT
    assert ask(planner, None).ok


def test_coarse_levels_are_made_in_stripes_and_are_those_made_at_once():
    grid = made("costs").state.grid
    tries = 0
    finished = False
    pyramid = Pyramid(grid)
    whole = Pyramid(grid).finish()
    while not finished:
        tries += 1
        try:
            pyramid.finish(Deadline(0.0))
            finished = True
        except OutOfTimeError:
            pass
    assert tries > 10
    for level, other in zip(pyramid.levels[1:], whole.levels[1:], strict=True):
        np.testing.assert_array_equal(level.grid.weights, other.grid.weights)
        np.testing.assert_array_equal(level.links, other.links)


def test_a_network_is_not_shown_a_map_without_time(tiny_model):
    state = made("costs").state
    network = NetworkModel(tiny_model)
    with pytest.raises(OutOfTimeError):
        MapView(state, network).show(*ENDS, Deadline(0.0))


@pytest.mark.parametrize("kind", KINDS)
def test_without_time_next_to_nothing_is_done(kind):
    for method in (*Method, *DynamicMethod):
        planner = made(kind, None if isinstance(method, Method) else method)
        computed = planner.state.costs_computed
        plan = ask(planner, method, 0.0)
        assert plan.status is Status.TIMEOUT and plan.reason
        assert plan.expansions <= 1100  # one look at the clock
        assert planner.state.grid.robot.stance.checks <= 4 * 16 * SHAPE[1]  # a row of D* Lite's
        assert planner.state.costs_computed - computed < 0.6 or kind in ("costs", "tobler")


@pytest.mark.parametrize("kind", ["costs", "point", "body", "tobler", "coarse"])
def test_wherever_a_query_is_broken_off_the_next_one_finds_what_a_fresh_planner_does(
    kind, monkeypatch
):
    for method in ("corridor", "nnpp", "astar"):
        wanted = ask(made(kind), method)
        steps = 0
        hurried_plan = None
        while hurried_plan is None or not hurried_plan.ok:
            planner = made(kind)
            with monkeypatch.context() as hurried:
                hurried.setattr(Deadline, "within", lambda seconds, steps=steps: Steps(steps))
                hurried_plan = ask(planner, method)
            plan = ask(planner, method)
            np.testing.assert_array_equal(plan.path, wanted.path)
            assert (plan.cost, plan.lower_bound) == (wanted.cost, wanted.lower_bound)
            assert hurried_plan.status in (Status.TIMEOUT, Status.OK)
            steps += 1 if steps < 4 else steps // 2
        assert steps > 1 or method == "astar"


def test_a_tour_whose_time_is_up_keeps_the_order_given(monkeypatch):
    planner = made("costs")
    planned = []
    stops = [ENDS[0], (20, 200), (150, 20), (90, 90), ENDS[1]]

    def leg(begin, end):
        planned.append((begin, end))
        return planner.plan(begin, end, time_limit_s=0.0, method="astar")

    found = tour(leg, stops, planner.state.grid, best_order=True, deadline=Deadline.within(0.0))
    assert found.order == (0, 1, 2) and found.plan.status is Status.TIMEOUT
    assert planned == [(ENDS[0], (20, 200))]
    whole = planner.plan_via(ENDS[0], ENDS[1], stops[1:-1], best_order=True, time_limit_s=0.0)
    assert whole.plan.status is Status.TIMEOUT and len(whole.legs) == 1
    best = planner.plan_via(*ENDS, stops[1:-1], best_order=True, method="astar")
    steps = 0
    found = None
    while found is None or found.plan.status is Status.TIMEOUT:
        monkeypatch.setattr(Deadline, "within", lambda seconds, steps=steps: Steps(steps))
        found = planner.plan_via(*ENDS, stops[1:-1], best_order=True, method="astar")
        steps += 1
        assert steps < 500
    assert found.order in ((0, 1, 2), best.order)
    assert math.isnan(found.given_cost) or found.plan.cost <= found.given_cost
