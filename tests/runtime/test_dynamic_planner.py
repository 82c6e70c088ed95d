import numpy as np
import pytest

from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, ModelError, Status
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from tests import oracles


def free(shape=(30, 40)):
    return np.full(shape, 0.2, np.float32)


def test_auto_says_what_it_picked_and_why():
    cost = free((400, 400))
    planner = DynamicPlanner(cost, (380, 380))
    planner.move((5, 5))
    first = planner.replan()
    assert first.planner is DynamicMethod.CORRIDOR
    seen = []
    for step in range(1, 4):  # small changes just ahead
        start = tuple(int(x) for x in first.path[5 * step])
        planner.update(start[0] + 3, start[1] + 3, np.full((2, 2), 1.0, np.float32))
        planner.move(start)
        seen.append(planner.replan())
        assert seen[-1].ok
    assert {plan.planner for plan in seen} == {DynamicMethod.CORRIDOR_DSTAR}
    assert "near the start" in seen[-1].choice
    assert seen[-1].expansions < first.expansions
    planner.move((350, 350))
    near = planner.replan()
    assert near.planner is DynamicMethod.ASTAR
    assert "less than" in near.choice
    assert near.summary()["method"] == "astar"
    cost[200, 2:] = np.inf  # a goal beyond a wall is not looked for long
    planner = DynamicPlanner(cost, (201, 350))
    planner.move((199, 350))
    assert planner.replan().ok and planner.replan().planner is DynamicMethod.CORRIDOR


@pytest.mark.parametrize(("method", "base"), [("corridor-dstar", "corridor"), ("nnpp-dstar", "nnpp")])
def test_a_region_is_mended_or_searched_afresh_whichever_is_less_work(network, method, base):
    cost = (np.random.default_rng(3).random((300, 300)) * 0.2 + 0.3).astype(np.float32)
    planner, fresh = (DynamicPlanner(cost, (280, 280), m, model=network) for m in (method, base))
    start, put = (10, 10), [*((12 + 4 * k, 12 + 4 * k) for k in range(7)), (250, 250), (44, 44)]
    said, plans = [], []
    for step, at in enumerate(put):
        for each in (planner, fresh):
            each.move((start[0] + 4 * step, start[1] + 4 * step))
            if step:
                each.update(at[0] + 4, at[1] + 4, np.full((4, 4), 0.9, np.float32))
        plans.append((planner.replan(), fresh.replan()))
        said.append(plans[-1][0].choice.split(":")[0])
        assert plans[-1][0].ok
        assert plans[-1][0].cost <= plans[-1][1].cost * (1 + 1e-5)
        assert plans[-1][1].choice == ""
    # a first search by D* Lite takes longer than a fresh one: it is made once changes ahead of the robot, which it
    # would have dealt with in no time, make up for that; a change near the goal is searched afresh again
    assert said[:3] == ["searched afresh"] * 3
    assert plans[2][0].expansions == plans[2][1].expansions
    assert said[5:] == ["mended", "mended", "searched afresh", "searched afresh"]
    assert plans[6][0].expansions < 0.5 * plans[6][1].expansions
    assert "times the work of a fresh search" in plans[-1][0].choice


@pytest.mark.parametrize("body", [False, True], ids=["point", "body"])
def test_what_the_robot_can_reach_is_what_a_path_leads_to(body):
    rng = np.random.default_rng(6)
    cost = np.where(rng.random((30, 36)) < (0.05 if body else 0.4), np.inf, 0.3).astype(np.float32)
    cost[1:11, 1:11] = 0.3
    planner = of_body(cost) if body else DynamicPlanner(cost, (0, 0), "astar")
    planner.move((5, 5))
    if body:
        planner.update_elevation(12, 12, np.full((3, 3), np.nan))
    else:
        planner.update(12, 12, np.ones((3, 3)))
    reached = np.isfinite(planner.reach())
    assert 100 < reached.sum() < 0.7 * cost.size
    for cell in np.ndindex(cost.shape):
        planner.set_goal(cell)
        assert planner.replan().ok == reached[cell]
    planner.move((39, 80))
    with pytest.raises(InvalidQueryError, match=r"start \(39, 80\) lies outside the map"):
        planner.reach()


def of_body(cost):
    """A planner of a body that does not stand where costs are infinite."""
    heights = np.where(np.isfinite(cost), 0.0, np.nan).astype(np.float32)
    rover = Vehicle(length_m=0.2, width_m=0.2, clearance_m=0.1)
    return DynamicPlanner.of_elevation(heights, 0.1, (0, 0), method="astar", vehicle=rover)


def test_a_way_through_a_large_map_that_changes(network):
    for method in DynamicMethod:
        rng = np.random.default_rng(3)
        cost = (rng.random((260, 300)) * 0.6).astype(np.float32)
        start, goal = (10, 10), (250, 290)
        planner, exact = DynamicPlanner(cost, goal, method, model=network), DynamicPlanner(cost, goal, "astar")
        planner.prepare()
        for step in range(4):
            for each in (planner, exact):
                each.move(start)
            plan, best = planner.replan(), exact.replan()
            assert plan.ok and best.cost * (1 - 1e-5) <= plan.cost <= 1.1 * best.cost
            assert oracles.path_problem(plan.path, np.where(cost < 1.0, cost, np.inf), plan.path[0], goal) == ""
            start = tuple(int(x) for x in best.path[40])
            row, col = (int(x) for x in best.path[60 if step % 2 else 140] - 8)
            cost[row : row + 16, col : col + 16] = 1.0
            for each in (planner, exact):
                assert each.update(row, col, np.full((16, 16), 1.0, np.float32)) > 0


def test_a_patch_that_changes_nothing_and_one_that_is_refused_leave_the_map_as_it_was():
    for method in ("astar", "corridor-dstar"):
        planner = DynamicPlanner(free(), (20, 30), method)
        before = planner.state.grid.weights.copy()
        assert planner.update(3, 4, np.full((5, 6), 0.2)) == 0
        bad = np.full((3, 3), 0.5)
        bad[1, 1] = -0.1
        with pytest.raises(InvalidMapError, match=r"at least 0, got one of -0\.1"):
            planner.update(2, 2, bad)
        for row, col in ((-1, 0), (28, 0), (0, 39)):
            with pytest.raises(InvalidMapError, match="inside the map"):
                planner.update(row, col, np.zeros((3, 3)))
        np.testing.assert_array_equal(planner.state.grid.weights, before)
        assert planner.update(5, 7, np.full((1, 1), np.nan)) == 1 and not planner.is_passable((5, 7))


def test_wrong_use_is_told(network, tmp_path):
    for goal, options, words in (
        ((1, 1), {"method": "dijkstra"}, "method must be one of"),
        ((30, 1), {}, "goal must lie inside"),
    ):
        with pytest.raises(InvalidQueryError, match=words):
            DynamicPlanner(free(), goal, **options)
    planner = DynamicPlanner(free(), (1, 1), "astar")
    with pytest.raises(InvalidQueryError, match="wanted a start"):
        planner.replan()
    planner.move((3, 3))
    with pytest.raises(InvalidQueryError, match="made for"):
        planner.replan(method="corridor")
    planner.use_model(tmp_path / "none.onnx")  # which is for methods that ask one
    assert planner.replan().ok
    planner = DynamicPlanner(free((80, 80)), (60, 70), "nnpp", model=network)
    planner.move((5, 5))
    with pytest.raises(ModelError, match="none"):
        planner.use_model(tmp_path / "none.onnx")
    assert planner.replan().ok


def test_out_of_time_is_a_timeout():
    cost = np.random.default_rng(0).random((700, 700)).astype(np.float32) * 0.9
    for method in ("astar", "dstar"):
        planner = DynamicPlanner(cost, (690, 690), method)
        planner.move((5, 5))
        assert planner.replan(time_limit_s=0.0).status is Status.TIMEOUT
        assert planner.replan().ok
