"""Plans of a body that drives arcs, and the drive itself. Beside Dijkstra's algorithm over a
lattice of its own they are in `test_robots`.

More cases: ``NNPP_EDGE_MAPS=500 pytest tests/runtime/test_arcs.py``.
"""

import itertools
import math
import os
from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    Ground,
    MapPatch,
    Navigator,
    Planner,
    Pose,
    Source,
    Vehicle,
)
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT
from nnpp_edge.runtime.planners import joining
from nnpp_edge.runtime.planners.standing_path import StandingPath
from nnpp_edge.runtime.robots.body.primitives import primitives
from nnpp_edge.terrain.dem import sample_dem
from tests import pose_oracles
from tests.pose_oracles import bend, rocks
from tests.worlds import CAR, CARS

MAPS = int(os.environ.get("NNPP_EDGE_MAPS", "6"))
CELL_M = 0.25
pytestmark = pytest.mark.filterwarnings("ignore:the network .* was trained for omega")


def planner(dem, vehicle=CAR, **options):
    options.setdefault("cell_size_m", CELL_M)
    return Planner.of_elevation(dem, vehicle=vehicle, warn=False, **options)


def of_both(made, *ends, **options):
    """The plans of the exact search, and of that in a corridor."""
    return [made.plan(*ends, method=name, **options) for name in ("astar", "corridor")]


def drives(dem, start, heading, goal, vehicle=CAR):
    """A planner of a body that stands there."""
    moving = DynamicPlanner.of_elevation(dem, CELL_M, goal, vehicle=vehicle)
    moving.move(start, heading)
    return moving


def best_cost(dem, start, heading, goal, vehicle=CAR, to_heading=None):
    """Of the whole map, searched by a new planner."""
    ends = {"start_heading_deg": heading, "goal_heading_deg": to_heading}
    return planner(dem, vehicle).plan(start, goal, method="astar", **ends).cost


def driven(plan, every_m=0.02):
    """Places (N, 2) in cells and headings (N,) from down the rows, by small steps along gears and
    curvatures.
    """
    places = []
    headings = []
    for arc in plan.arcs:
        x, y, degrees = arc.start_pose
        count = max(math.ceil(arc.length_m / every_m), math.ceil(abs(arc.turn_deg)), 1)
        heading = math.radians(degrees)
        step = arc.gear * arc.length_m / count
        for _ in range(count):
            turned = (
                -arc.curvature_per_m * step if arc.gear else -math.radians(arc.turn_deg) / count
            )
            x += step * math.sin(heading + turned / 2.0)
            y -= step * math.cos(heading + turned / 2.0)
            heading += turned
            places.append((y / CELL_M, x / CELL_M))
            headings.append(math.pi - heading)
    return np.array(places), np.array(headings)


@pytest.mark.parametrize("vehicle", CARS)
def test_arcs_join_keep_the_radius_and_break_no_limit_between_the_cells(vehicle):
    metres = 0.0
    for seed in range(max(MAPS // 2, 3)):
        dem = rocks(seed, 60, 64, 0.01)
        options = {
            "start_heading_deg": 90.0 + 22.0 * seed,
            "goal_heading_deg": 170.0,
            "goal_tolerance_deg": 30.0,
        }
        made = planner(dem, vehicle)
        for plan in of_both(made, (10, 10), (50, 52 - seed % 40), **options):
            if not plan.ok:
                continue
            places, headings = driven(plan)
            assert np.abs(places[-1] - plan.path[-1]).max() < 0.02, (
                "Euler's steps end where the path does"
            )
            for before, after in itertools.pairwise(plan.arcs):
                assert before.at(1.0) == pytest.approx(after.start_pose, abs=1e-6)
            assert (
                max(abs(arc.curvature_per_m) for arc in plan.arcs)
                <= 1.0 / vehicle.turning_radius_m + 1e-9
            )
            gears = {1, vehicle.reverse_cost and -1, 0 if vehicle.turns_on_spot else 1}
            assert {arc.gear for arc in plan.arcs} <= gears
            assert pose_oracles.breaks_at(dem, CELL_M, vehicle, places, headings) is None
            metres += sum(arc.length_m for arc in plan.arcs)
    assert metres > 20.0


def test_an_unswept_arc_breaks_a_limit_that_the_swept_one_is_refused_for(monkeypatch):
    from nnpp_edge.runtime.robots.body import motions

    def broken():
        motions.all_motions.cache_clear()
        found = 0
        for seed in range(24):
            dem = rocks(seed, 60, 64, 0.02)
            plan = planner(dem).plan((10, 10), (50, 52), method="astar")
            found += plan.ok and pose_oracles.breaks_at(dem, CELL_M, CAR, *driven(plan)) is not None
        motions.all_motions.cache_clear()
        return found

    assert not broken()
    whole = motions.arc_poses
    monkeypatch.setattr(
        motions,
        "arc_poses",
        lambda *a: [each._replace(sweep_m=0.0, turn_rad=0.0) for each in whole(*a)][:1],
    )
    assert broken()


def test_primitives_of_a_wide_turn_are_long_and_no_curve_is_shorter_than_their_bound():
    for radius, sides in itertools.product((0.3, 1.0, 4.0), ((0.25, 0.25), (0.25, 0.2))):
        found, shortest = primitives(replace(CAR, turning_radius_m=radius), sides)
        for k in range(16):
            place, metres = bend(k, sides, radius)
            at = 16 + 2 * k
            assert tuple(found.rays[at, :2]) == place and found.rays[at, 3] == 2 * AXIS_COUNT + k
            assert found.ray_fares[at] == pytest.approx(metres / min(sides), rel=1e-6)
        assert 0.97 < shortest <= 1.0


def test_a_corridor_to_a_goal_with_a_heading_is_hardly_more_work_than_the_whole_map():
    """Where it took 2.9 to 8 times the expansions: by states that were expanded again and again, by
    one region after another without a path, or as the region had no room to arrive as wanted.
    """
    rim = sample_dem("mars_victoria")
    car = Vehicle(3.0, 2.4, 0.6, turning_radius_m=3.0, reverse_cost=2.0, gear_change_m=1.0)
    forwards = Vehicle(1.5, 1.2, 0.3, turning_radius_m=3.0)
    for vehicle, start, goal, heading, begin in (
        (car, (165, 52), (44, 133), 184.5, None),
        (car, (238, 152), (146, 133), 119.0, 325.0),
        (forwards, (226, 73), (184, 66), 207.0, None),
    ):
        made = planner(rim.elevation, vehicle, cell_size_m=rim.cell_size_m)
        headings = {"start_heading_deg": begin, "goal_heading_deg": heading}
        exact, other = of_both(made, start, goal, **headings)
        assert exact.status is other.status and (not exact.ok or other.cost <= 1.02 * exact.cost)
        assert other.expansions <= (1.25 * exact.expansions if exact.ok else 4_000)


@pytest.mark.parametrize("headings", ({"start_heading_deg": 270.0}, {"goal_heading_deg": 270.0}))
def test_a_corridor_has_room_to_turn_round_at_an_end_with_a_heading(headings):
    """Without it the body went back and forth there, for 7 to 11 % more."""
    slow_to_reverse = replace(CAR, turning_radius_m=3.0, reverse_cost=3.0, gear_change_m=2.0)
    made = planner(np.zeros((100, 340)), slow_to_reverse)
    exact, other = of_both(made, (50, 35), (50, 310), **headings)
    assert other.source is Source.REGION
    assert other.cost <= 1.002 * exact.cost


def test_a_region_whose_paths_cost_far_more_than_promised_is_given_up_for_the_wider_one():
    """To its end it took 7,200 expansions, for a path 3 % dearer; without what one gear says of the
    other both take 14,800.
    """
    vehicle = replace(CAR, turning_radius_m=4.0, reverse_cost=2.0, gear_change_m=1.0)
    made = planner(rocks(47, 100, 100, 0.012), vehicle)
    plan = made.plan((25, 52), (90, 15), start_heading_deg=107.0, method="corridor")
    assert plan.source is Source.WIDENED
    assert plan.expansions < 14_000


@pytest.mark.parametrize(
    ("ways", "to_heading"),
    [
        ({"turning_radius_m": 4.0, "reverse_cost": 2.0, "gear_change_m": 1.0}, False),
        ({"turning_radius_m": 2.0}, True),
    ],
)
def test_paths_in_corridors_cost_hardly_more_than_the_best(ways, to_heading):
    vehicle = replace(CAR, **ways)
    rng = np.random.default_rng(7)
    gaps = []
    for seed in range(6):
        made = planner(rocks(seed, 120, 120, 0.006), vehicle)
        while len(gaps) < 4 * (seed + 1):
            start, goal = rng.integers(8, 112, (2, 2))
            begin, end = rng.uniform(0.0, 360.0, 2)
            if np.abs(start - goal).max() < 50:
                continue
            options = {
                "start_heading_deg": begin,
                "goal_heading_deg": end if to_heading else None,
            }
            exact, other = of_both(made, start.tolist(), goal.tolist(), **options)
            assert exact.status is other.status
            if exact.ok:
                gaps.append(other.cost / exact.cost - 1.0)
    assert np.mean(gaps) < 0.0035 and max(gaps) < 0.025


def test_where_no_arc_leads_out_of_a_dead_end_no_second_region_is_searched():
    dem = np.zeros((80, 120))
    dem[33:48, 70:115] = 3.0
    dem[38:43, 70:110] = 0.0  # a street, open to the left
    within = (40, 100)
    outside = (40, 20)
    made = planner(dem)
    for ends, facing_the_end, facing_the_way_out in (
        ((outside, within), {"goal_heading_deg": 90.0}, {"goal_heading_deg": 270.0}),
        ((within, outside), {"start_heading_deg": 270.0}, {"start_heading_deg": 90.0}),
    ):
        assert made.plan(*ends, method="corridor", **facing_the_end).ok
        plan = made.plan(*ends, method="corridor", **facing_the_way_out)
        assert (plan.status, plan.source) == (Status.NO_PATH, Source.REGION)
        assert plan.expansions < 2000


def test_where_a_standing_path_crosses_itself_the_heading_says_how_far_the_robot_is():
    made = planner(np.zeros((60, 60), np.float32))
    plan = made.plan((30, 30), (30, 31), start_heading_deg=0.0, goal_heading_deg=90.0)
    crossing = np.flatnonzero((plan.path == (30, 30)).all(1)).tolist()
    assert len(crossing) == 2
    path = StandingPath(made.state)
    path.set(plan)
    directions = (plan.states[crossing] % 16).tolist()
    assert [path.check((30, 30), each).index for each in directions] == crossing


def test_the_way_between_the_same_cells_depends_on_the_headings():
    made = planner(np.zeros((80, 100)))
    ends = (40, 30), (40, 70)
    straight = made.plan(*ends, goal_heading_deg=90.0, method="corridor")
    around = made.plan(*ends, start_heading_deg=270.0, goal_heading_deg=270.0)
    assert straight.cost == pytest.approx(40.0, rel=1e-6) and len(straight.arcs) == 1
    assert around.cost > 40.0 + 2.0 * math.pi * 1.1 / CELL_M * 0.9
    rest = around.rest(3)
    assert rest.path.tolist() == around.path[3:].tolist()
    place = (*(around.path[3, ::-1] * CELL_M), around.headings_deg[3])
    assert rest.poses[0] == pytest.approx(place, abs=1e-6)
    spot = made.plan(ends[0], ends[0], start_heading_deg=90.0, goal_heading_deg=270.0)
    assert spot.cost > 10.0
    assert spot.poses[-1] == pytest.approx((7.5, 10.0, 270.0), abs=1e-6)


@pytest.mark.parametrize("vehicle", CARS[:3])
@pytest.mark.parametrize("best_order", [False, True])
def test_a_tour_of_arcs_is_driven_on_through_its_stops(vehicle, best_order):
    made = planner(np.zeros((60, 60), np.float32), vehicle)
    via = [(40, 20), (40, 20), (15, 40)]
    tour = made.plan_via((10, 10), (50, 50), via, best_order=best_order, method="astar")
    metres = sum(leg.along.distance_m[-1] for leg in tour.legs)
    assert tour.plan.along.distance_m[-1] == pytest.approx(metres, rel=1e-3)
    poses = tour.plan.poses
    apart = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turned = np.abs((np.diff(poses[:, 2]) + 180.0) % 360.0 - 180.0)
    assert apart.max() <= 0.25 + 1e-9
    assert (np.radians(turned) <= apart / vehicle.turning_radius_m + 1e-6).all()


def test_a_robot_on_a_goal_that_has_become_impassable_does_not_stand_well():
    for vehicle in (CAR, replace(CAR, turning_radius_m=None)):
        moving = drives(np.zeros((40, 40)), (20, 12), 90.0, (20, 20), vehicle)
        moving.replan()
        moving.move((20, 20), 90.0)
        assert moving.standing().valid
        moving.update_elevation(20, 20, np.full((1, 1), 3.0))
        assert not moving.standing().valid


def test_the_loop_goes_to_a_goal_with_a_heading_and_to_another_when_that_changes():
    dem = np.zeros((60, 60), np.float32)
    navigator = Navigator(Ground.of_elevation(dem, CELL_M, vehicle=CAR))
    navigator.offer(Pose(30.5, 15.5, heading_deg=90.0))
    for heading in (0.0, 180.0, 90.0, None):
        navigator.offer(Goal(30, 45, heading_deg=heading))
        answer = navigator.tick()
        best = best_cost(dem, (30, 15), 90.0, (30, 45), to_heading=heading)
        assert answer.ok and answer.cost <= 1.1 * best
        if heading is not None:
            assert answer.headings[-1] == heading
    point = Navigator(Ground(np.full((60, 60), 0.1, np.float32)))  # a point has no heading
    point.offer(Pose(30, 15))
    point.offer(Goal(30, 45, heading_deg=10.0))
    assert point.tick().ok
    point.forget(goal=False)
    assert point.tick().outcome is Status.NO_POSE
    point.forget()
    point.offer(Pose(30, 15))
    assert point.tick().outcome is Status.NO_GOAL


def test_a_path_of_arcs_stands_while_the_body_drives_between_its_states():
    dem = np.zeros((60, 60), np.float32)
    car = replace(CAR, reverse_cost=1.2, gear_change_m=0.2)
    navigator = Navigator(Ground.of_elevation(dem, CELL_M, vehicle=car))
    navigator.offer(Goal(33, 20, heading_deg=90.0))
    navigator.offer(Pose(30.5, 20.5, heading_deg=90.0))  # to the side: backwards and forwards
    first = navigator.tick()
    assert {arc.gear for arc in first.arcs} == {1, -1}
    rng = np.random.default_rng(1)
    starts = []
    for arc in first.arcs:
        for share in np.arange(0.0, 1.0, 0.1 / arc.length_m):
            x, y, heading = np.add(arc.at(share), rng.uniform(-1.0, 1.0, 3) * (0.05, 0.05, 5.0))
            place = np.array((y, x)) / CELL_M + 0.5
            navigator.offer(Pose(*place.tolist(), heading_deg=float(heading)))
            answer = navigator.tick()
            index = len(first.path) - len(answer.path)
            np.testing.assert_array_equal(answer.path, first.path[index:])
            assert answer.headings == first.headings[index:]
            starts.append(index)
    assert starts == sorted(starts)
    assert len(first.path) - 2 in starts


def test_a_body_exactly_in_a_state_of_its_path_sets_out_from_there():
    """Where the path came by that place before, in another gear, it was sent back each time."""
    moving = drives(np.zeros((60, 60)), (30, 30), 90.0, (30, 20))
    plan = moving.replan()
    assert len(plan.path) > 4
    for (row, col), heading in zip(plan.path.tolist(), plan.headings_deg, strict=True):
        assert moving.passed(row, col, heading) is None
    assert moving.passed(row, col + 0.1, heading) is not None
    row, col = plan.path[1].tolist()
    assert moving.passed(row, col + 0.1, plan.headings_deg[1]) is None, "it came by before"


def test_where_the_arc_is_blocked_that_a_body_drives_its_path_begins_in_its_cell():
    dem = np.zeros((80, 80), np.float32)
    wide = replace(CAR, turning_radius_m=4.0, reverse_cost=2.0)
    navigator = Navigator(Ground.of_elevation(dem, CELL_M, vehicle=wide))
    navigator.offer(Pose(60.5, 15.5, heading_deg=90.0))
    navigator.offer(Goal(20, 60, heading_deg=0.0))
    bend = next(arc for arc in navigator.tick().arcs if arc.curvature_per_m)
    x, y, heading = bend.at(0.6 / bend.length_m)
    pose = Pose(y / CELL_M + 0.5, x / CELL_M + 0.5, heading_deg=heading)
    navigator.offer(pose)
    begun = np.multiply(navigator.tick().start, CELL_M)
    assert np.hypot(*(begun - (y, x))) == pytest.approx(0.6, abs=0.02)
    ahead = math.radians(heading)
    col = round((x + 1.5 * math.sin(ahead)) / CELL_M)
    row = round((y - 1.5 * math.cos(ahead)) / CELL_M)
    navigator.offer(MapPatch(row, col, elevation=np.full((1, 1), 2.0, np.float32)))
    answer = navigator.tick()
    assert answer.ok and answer.start == pose.cell


def test_what_guided_plans_to_a_goal_with_a_heading_misleads_none_with_another():
    """Costs of the last metres are kept for one heading: taken for another they cost up to 28 %."""
    vehicle = replace(CAR, reverse_cost=2.0)
    start, goal = (12, 14), (60, 64)
    for seed in (12, 13):
        dem = rocks(seed, 80, 80, 0.004)
        moving = drives(dem, start, 90.0, goal, vehicle)
        for heading in (0.0, 180.0, None):
            moving.set_goal(goal, heading)
            best = best_cost(dem, start, 90.0, goal, vehicle, heading)
            assert moving.replan().cost <= 1.06 * best


def test_a_path_of_arcs_is_left_where_it_is_blocked_and_joined_again(monkeypatch):
    monkeypatch.setattr(joining, "JOIN_EXPANSIONS", 1 << 16)
    dem = np.zeros((160, 240))
    moving = drives(dem, (80, 15), 90.0, (80, 220))
    for time_s in np.geomspace(2e-4, 4e-3, 12):
        assert moving.replan(time_limit_s=time_s).status in ("OK", "TIMEOUT")
    first = moving.replan()
    moving.update_elevation(79, 60, np.full((2, 2), 2.0))
    dem[79:81, 60:62] = 2.0
    assert not moving.standing().valid
    for cell in (80, 15), (82, 17):  # on the path, and beside it
        moving.move(cell, 90.0)
        again = moving.replan()
        assert again.ok and again.source is Source.STANDING
        assert again.path[-100:].tolist() == first.path[-100:].tolist()
        assert pose_oracles.breaks_at(dem, CELL_M, CAR, *driven(again)) is None
        best = best_cost(dem, cell, 90.0, (80, 220))
        assert again.lower_bound <= best * (1.0 + 1e-5)
        assert best * (1.0 - 1e-5) <= again.cost <= 1.02 * best
    moving.update_elevation(
        79, 110, np.full((2, 2), 2.0)
    )  # farther on than where it is joined as a rule
    again = moving.replan()
    assert (
        again.source is Source.STANDING and again.path[-60:].tolist() == first.path[-60:].tolist()
    )
    monkeypatch.setattr(joining, "JOIN_EXPANSIONS", 1)
    assert moving.replan().walked.tolist() == again.walked.tolist()
    moving.update_elevation(79, 150, np.full((2, 2), 2.0))
    assert moving.replan().source is Source.REGION  # blocked, and no way found by so few expansions


@pytest.mark.parametrize("seed", [0, 6])
def test_a_clear_path_is_driven_to_its_end_though_its_dear_part_comes_last(seed, monkeypatch):
    monkeypatch.setattr(joining, "JOIN_EXPANSIONS", 1)
    vehicle = replace(CAR, turning_radius_m=1.5, reverse_cost=2.0, gear_change_m=2.0)
    dem = rocks(seed, 44, 52, 0.012)
    moving = drives(dem, (8, 8), 90.0, (35, 44), vehicle)
    plan = moving.replan()
    while len(plan.path) > 2:
        moving.move(tuple(plan.path[1].tolist()), float(plan.headings_deg[1]))
        plan = moving.replan()
        assert plan.source is Source.STANDING


def test_a_way_around_what_blocks_the_path_joins_it_close_behind(monkeypatch):
    joined = []
    search = joining.Joiner.search

    def noted(joiner, query):
        joined.append(query.goal)
        return search(joiner, query)

    monkeypatch.setattr(joining.Joiner, "search", noted)
    moving = drives(np.zeros((80, 240)), (40, 20), 90.0, (40, 220))
    moving.replan()
    moving.update_elevation(39, 35, np.full((3, 2), 2.0))
    stance = moving.state.grid.robot.stance
    before = stance.checks
    plan = moving.replan()
    assert plan.ok
    assert 40 < joined[-1][1] < 80
    assert plan.checks == stance.checks - before


@pytest.mark.parametrize(("method", "most"), [("corridor", 100_000), ("astar", 28_000)])
def test_a_goal_to_which_legs_lead_and_arcs_do_not_is_found_out_from_there(method, most):
    dem = np.zeros((150, 200))
    dem[90:140, 90:140] = 3.0
    dem[98:103, 100:130] = 0.0  # a street to the goal, at whose corner legs pass
    dem[85:101, 98:103] = 0.0
    dem[97:104, 97:104] = 0.0
    wide = replace(CAR, turning_radius_m=2.5)
    plan = planner(dem, wide).plan((20, 20), (100, 125), method=method)
    assert plan.expansions < 25_000  # from the start 243,000
    assert "no path exists on the known map; the search from the goal got to" in plan.reason
    dem[98:103, 130:140] = 0.0  # open at the far end, too; without the last metres 160,000
    plan = planner(dem, wide).plan((20, 20), (100, 125), method=method)
    assert plan.ok and plan.expansions < most


def test_once_much_of_the_map_has_changed_a_path_is_searched_for():
    dem = rocks(3, 120, 120, 0.004)
    moving = drives(dem, (15, 15), 130.0, (100, 100))
    sources = [moving.replan().source]
    for side in (25, 60):
        dem[-side:, :side] += 0.001  # far from the path
        moving.update_elevation(120 - side, 0, dem[-side:, :side])
        sources.append(moving.replan().source)
    assert sources == [Source.REGION, Source.STANDING, Source.REGION]
