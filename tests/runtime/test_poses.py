"""Motions of a robot with a body, and plans over them, beside plain and slow answers.

More cases of the same kind: ``python -m tests.fuzz --target bodies``.
"""

import functools
import itertools
import math
import random
from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Planner,
    Region,
    Source,
    Status,
    Traversability,
    Vehicle,
    pose_costs,
)
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, REFUSALS, check_run
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.robots.body import motions
from nnpp_edge.runtime.robots.body.attitude import attitudes, explain
from nnpp_edge.runtime.robots.body.poses import Poses
from nnpp_edge.runtime.robots.body.robot import BodyMoves
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.terrain.rocks import with_rocks
from tests import pose_oracles
from tests.fuzz import bodies, sequences
from tests.fuzz.cases import Place
from tests.pose_oracles import rocks
from tests.strategies import flat, scrambled

ROVER = Vehicle(length_m=1.3, width_m=0.9, clearance_m=0.3, wheel_length_m=0.21, wheel_width_m=0.13)
CELL_M = 0.25
OMEGA = 0.011
LIMITS = ("max_tilt_deg", "max_pitch_deg", "max_roll_deg", "max_step_m", "clearance_m")
WEIGHTS = (0.6, 0.2, 0.2)
pytestmark = pytest.mark.filterwarnings("ignore:the network .* was trained for omega")


@pytest.fixture
def planner(tiny_model):
    """Makes planners with a small network."""

    def make(dem, vehicle=ROVER, **options):
        return Planner.of_elevation(
            dem, CELL_M, vehicle=vehicle, model=tiny_model, ask_from=0, warn=False, **options
        )

    return make


def checked(dem, vehicle=ROVER, sides=(CELL_M, CELL_M)):
    """All motions on a map."""
    poses = Poses(np.asarray(dem, np.float32), sides, vehicle, WEIGHTS, 255 * OMEGA)
    poses.complete()
    return poses


def passing(poses):
    """(24, H, W) whether legs along the axes, turns to the next direction, and standing bodies
    pass.
    """
    return bodies.motions_on(poses) < FAILS


# --- the check


def test_a_smooth_plane_passes_up_to_the_limit_whichever_way_it_rises_and_not_above():
    rng = random.Random(4)
    for number, per_cell in enumerate((2.0, 2.0, 2.4, 3.0, 3.0, 3.7, 4.0, 5.5, 8.0, 11.0, 16.0)):
        long = number % 2 == 0
        cell = rng.uniform(0.1, 2.0)
        sides = [per_cell * cell, per_cell * cell * rng.uniform(1.0, 1.4)]
        size = dict(zip(("length_m", "width_m"), sides[::-1] if long else sides, strict=True))
        limit = rng.uniform(15.0, 35.0)
        vehicle = Vehicle(
            **size, clearance_m=0.2 * per_cell * cell, max_tilt_deg=limit, axles=rng.choice((2, 3))
        )
        side = 2 * math.ceil(1.4 * per_cell) + 9
        down, right = np.mgrid[:side, :side] * cell
        for angle in np.arange(0.0, 360.0, 22.5) + rng.uniform(0.0, 22.5):
            along = down * math.cos(math.radians(angle)) + right * math.sin(math.radians(angle))
            for share, wanted in ((0.97 if per_cell >= 3.0 else 0.9, True), (1.0001, False)):
                poses = checked(
                    along * math.tan(math.radians(share * limit)), vehicle, (cell, cell)
                )
                assert (passing(poses)[:, side // 2, side // 2] == wanted).all(), (
                    per_cell,
                    angle,
                    share,
                )


def test_pitch_and_roll_have_limits_of_their_own_by_the_direction():
    down = np.tan(np.radians(20.0)) * CELL_M * np.mgrid[:41, :41][0]
    for changes, fails in (({"max_pitch_deg": 19.0}, 0), ({"max_roll_deg": 19.0}, 4)):
        found = passing(checked(down, replace(ROVER, **changes)))[:, 20, 20]
        for kind in (0, 16):  # legs, and standing
            assert not found[kind + fails] and found[kind + 4 - fails]


def test_attitudes_on_a_plane_are_the_planes():
    gradient = np.array((0.15, -0.1))
    down, right = CELL_M * np.mgrid[:61, :61]
    path = np.cumsum([(30, 20), *pose_oracles.DIRECTIONS], axis=0).astype(np.int32)
    found = attitudes(checked(gradient[0] * down + gradient[1] * right), path)
    ahead = np.array((*pose_oracles.DIRECTIONS, pose_oracles.DIRECTIONS[-1]))
    ahead = ahead / np.hypot(*ahead.T)[:, None]
    left = np.stack((-ahead[:, 1], ahead[:, 0]), 1)
    assert found.pitch_deg == pytest.approx(np.degrees(np.arctan(ahead @ gradient)), abs=0.01)
    assert found.roll_deg == pytest.approx(np.degrees(np.arctan(left @ gradient)), abs=0.01)
    assert found.tilt_deg == pytest.approx(
        np.full(17, math.degrees(math.atan(np.hypot(*gradient)))), abs=0.01
    )
    assert found.clearance_m == pytest.approx(np.full(17, ROVER.clearance_m), abs=1e-3)


def test_the_axes_are_told_apart_by_lanes_in_which_one_alone_has_room():
    body = Vehicle(length_m=4.0, width_m=0.7, clearance_m=0.3)
    cells = np.stack(np.mgrid[:49, :49], 2) - 24
    for k, (row, col) in enumerate(pose_oracles.AXES):
        off = np.abs(cells @ (-col, row)) / math.hypot(row, col) * CELL_M
        dem = np.where(off > 0.75, np.nan, 0.0)
        assert np.flatnonzero(np.isfinite(pose_costs(dem, CELL_M, body)[:, 24, 24])).tolist() == [k]
        found = passing(checked(dem, body))[:, 24, 24]
        assert np.flatnonzero(found).tolist() == [k, 16 + k], "no turn, and the leg along it"


def test_t_is_that_of_eq_1():
    found = pose_costs(flat(20, 24, 7.0), CELL_M, ROVER)
    assert found.shape == (8, 20, 24) and found.dtype == np.float32
    assert (found[:, 6:-6, 6:-6] == 0.0).all()
    assert np.isinf(found[:, 0]).all() and np.isinf(found[:, :, -1]).all()
    slope = CELL_M * np.tan(np.radians(10.0)) * np.mgrid[:20, :24][0]
    dem = slope + np.where(np.arange(24) == 12, 0.1, 0.0)
    rock = 0.15 * (np.arange(20 * 24) == 10 * 24 + 12).reshape(20, 24)
    for ground, shares, wanted in (
        (slope, (1.0, 0.0, 0.0), 10.0 / 25.0),
        (slope, (0.5, 0.5, 0.0), 5.0 / 25.0),
        (slope + rock, (0.0, 1.0, 0.0), 0.5),
        (np.where(np.arange(20)[:, None] == 8, 0.12, 0.0) + 0.0 * dem, (0.0, 0.0, 1.0), 0.4),
    ):
        rule = Traversability(
            **dict(zip(("slope_weight", "roughness_weight", "step_weight"), shares, strict=True))
        )
        t = pose_costs(ground, CELL_M, ROVER, traversability=rule)[0, 10, 12]
        assert t == pytest.approx(wanted, abs=0.03), shares


def test_raising_a_limit_never_makes_a_motion_fail(monkeypatch):
    make = motions.all_motions
    for seed in range(12):
        case = bodies.generate(random.Random(seed), most_side=18)
        monkeypatch.setattr(motions, "all_motions", make)
        poses = checked(case.dem, case.vehicle, case.cell)
        before = passing(poses)
        limits = {name: getattr(case.vehicle, name) for name in LIMITS}
        raised = {name: 1.01 * limit for name, limit in limits.items() if limit is not None}
        tables = make(replace(case.vehicle, **raised), case.cell)
        # by any limits the poses of motions are the same: they are made once
        assert all(map(np.array_equal, tables, poses.motions))
        monkeypatch.setattr(motions, "all_motions", lambda *_, tables=tables: tables)
        for name, factor in itertools.product(raised, (1.02, 1.5)):
            more = limits[name] * factor
            more = min(more, 89.0) if name.endswith("deg") else more
            now = passing(checked(case.dem, replace(case.vehicle, **{name: more}), case.cell))
            assert not (before & ~now).any(), (seed, name)


def broken_on_ground_made_to_pass(seed, swept=1.0):
    """What a motion breaks on ground that is raised and lowered, cell by cell, as far as it still
    passes; its poses stand for so large a part of what they sweep, and no other motion has any.
    """
    motion = seed % (2 * AXIS_COUNT)
    kind, axis = divmod(motion, AXIS_COUNT)
    rng = np.random.default_rng(seed)
    side = 21
    vehicle = bodies.draw_vehicle(random.Random(seed), 1.0)
    dem = flat(side, side)

    def of_one(wanted, make):
        def poses(k, *given):
            found = make(k, *given) if wanted and k == axis else []
            return [
                each._replace(sweep_m=swept * each.sweep_m, turn_rad=swept * each.turn_rad)
                for each in found
            ]

        return poses

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motions, "leg_poses", of_one(not kind, motions.leg_poses))
        patch.setattr(motions, "turn_poses", of_one(kind, motions.turn_poses))
        patch.setattr(motions, "all_motions", motions.all_motions.__wrapped__)
        poses = Poses(dem, (1.0, 1.0), vehicle, WEIGHTS, 1.0)
    middle = (10, 10)
    cells = np.argwhere((np.abs(np.mgrid[:side, :side] - 10) <= 2 + int(vehicle.reach_m)).all(0))
    for row, col in rng.permutation(cells).tolist():
        way = vehicle.clearance_m * rng.choice((4.0, -4.0))
        share = 0.0
        step = 1.0
        while step > 0.005:  # the most that passes
            dem[row, col] = way * (share + step)
            poses.write((row, col, 1, 1), dem[row : row + 1, col : col + 1])
            check_run(poses.packed, *middle, motion)
            passes = poses.codes[11 * (side + 2) + 11, motion] < FAILS
            share = share + step * bool(passes)
            step = 0.5 * step
        dem[row, col] = way * share
        poses.write((row, col, 1, 1), dem[row : row + 1, col : col + 1])
    return pose_oracles.breaks_at(
        dem, 1.0, vehicle, *bodies.dense_places(motion, middle, (1.0, 1.0), 25)
    )


def test_no_motion_that_passes_breaks_a_limit_on_the_worst_ground_and_unswept_ones_do():
    assert not any(map(broken_on_ground_made_to_pass, range(32)))
    broken = {seed % 16 for seed in range(48) if broken_on_ground_made_to_pass(seed, swept=0.0)}
    assert min(broken) < AXIS_COUNT < max(broken) and len(broken) > 4


def test_among_rocks_most_that_dense_sampling_passes_passes():
    """Standing there; legs and turns stand for more than what is sampled."""
    dem = rocks(3, share=0.01)
    rng = np.random.default_rng(0)
    kept = np.zeros((3, 2))
    found = passing(checked(dem))
    drawn = rng.integers(0, 24, 900)
    drawn_cells = np.stack((rng.integers(8, 36, 900), rng.integers(8, 44, 900)), 1)
    for motion in range(24):
        cells = drawn_cells[drawn == motion]
        way = bodies.dense_places(motion % 16, (0, 0), (CELL_M, CELL_M), 1 if motion >= 16 else 15)
        places = (cells[:, None] + way[0]).reshape(-1, 2)
        headings = np.tile(way[1], len(cells))
        figures = pose_oracles.worst_figures(dem, CELL_M, ROVER, places, headings)
        broken = figures > pose_oracles.allowances(ROVER)
        passes = ~broken.reshape(len(cells), -1).any(1)
        kept[motion // 8] += passes.sum(), found[motion, *cells[passes].T].sum()
    assert (kept[:, 1] / kept[:, 0] > (0.8, 0.75, 0.93)).all(), kept


def test_what_refuses_a_pose_is_told_with_its_numbers(monkeypatch):
    # the same few poses on many cells: their tables are made once
    make = motions.motions_of
    made = functools.cache(make)
    monkeypatch.setattr(
        motions, "motions_of", lambda *given: made(*given[:2], tuple(map(tuple, given[2])))
    )
    dem = rocks(5, share=0.02)
    dem[30:32, 20:24] = np.nan
    dem[:, 45:] += np.float32(0.5) * np.arange(7)
    vehicle = replace(
        ROVER, max_pitch_deg=12.0, max_roll_deg=9.0, max_tilt_deg=14.0, max_step_m=0.16
    )
    poses = checked(dem, vehicle)
    cells = np.random.default_rng(1).integers(6, (38, 46), (150, 2)).repeat(AXIS_COUNT, 0)
    axes = np.tile(np.arange(AXIS_COUNT), 150)
    angles = np.arctan2(*np.transpose(pose_oracles.AXES)[::-1, axes])
    headings = 180.0 - np.degrees(angles) + 360.0 * (axes % 3)
    true = pose_oracles.worst_figures(dem, CELL_M, vehicle, cells, angles)[:, 1:]
    true[:, 1:4] = np.degrees(true[:, 1:4])
    codes = poses.standing()[axes, *cells.T]
    places = np.column_stack((cells, headings))
    told = set()
    more = []
    for (row, col, heading), code, worst in zip(places.tolist(), codes, true, strict=True):
        cell = (int(row), int(col))
        found = explain(poses, cell, heading)
        assert found.cell == cell and found.heading_deg == pytest.approx(heading % 360.0)
        refused = REFUSALS[code - FAILS] if code >= FAILS else None
        assert (found.ok, found.refused_by) == (code < FAILS, refused)
        assert str(found).count("\n") == 5 and ("stands" in str(found)) == found.ok
        told.add(refused)
        if refused != "unknown":
            limits = [found.step_m, found.pitch_deg, found.roll_deg, found.tilt_deg, found.belly_m]
            assert [each.allowance for each in limits] == [0.16, 12.0, 9.0, 14.0, 0.3]
            more.append([each.value for each in limits] - np.maximum(worst, 0.0))
    assert np.min(more) > -1e-4 and (np.median(more, 0) < (0.02, 0.7, 0.7, 1.0, 0.05)).all(), (
        np.median(more, 0)
    )
    assert told >= {None, "unknown", "tilt", "roll", "step"}


# --- searches


def test_motions_and_plans_are_the_naive_ones_checked_at_once_or_where_a_search_looks(tiny_model):
    for seed in range(12):
        sequences.check_bodies(random.Random(seed), Place(tiny_model.parent))


def test_a_path_pays_for_its_turns_and_makes_none_that_fails(planner):
    made = planner(np.zeros((40, 40)))
    ended = set()
    for seed in range(24):
        scrambled(made, seed)
        priced = bodies.priced(made, OMEGA)
        legs = np.random.default_rng(seed).choice(pose_oracles.DIRECTIONS, 3)
        path = np.cumsum([(20, 20), *legs], axis=0).astype(np.int32)
        wanted = [pose_oracles.path_cost(priced, path[:count].tolist()) for count in range(1, 5)]
        fails = np.isinf(wanted)
        costs = np.zeros(4)
        ended.add(made.state.grid.walk(path, 0, costs))
        assert made.state.grid.walk(path, 0, costs) == (fails.argmax() if fails.any() else -1)
        assert costs[~fails] == pytest.approx(np.array(wanted)[~fails], rel=1e-5)
    assert ended == {-1, 1, 2, 3}


def test_checks_are_made_where_a_search_looks_and_are_kept(planner):
    dem = rocks(1, share=0.001)
    start = (6, 6)
    goal = (37, 44)
    ours = planner(dem)
    first, again = (ours.plan(start, goal, method="astar") for _ in range(2))
    most = len(ours.state.grid.robot.moves.poses.motions.swept) * dem.size
    assert first.ok and 0 < first.checks <= most
    assert again.checks == 0 and again.cost == first.cost
    row, col = first.path[len(first.path) // 2]
    ours.update_elevation(int(row), int(col), dem[row : row + 1, col : col + 1] + np.float32(0.01))
    assert 0 < ours.plan(start, goal, method="astar").checks < first.checks
    assert planner(dem, lazy=False).plan(start, goal, method="astar").checks == 0
    plan = planner(flat(200, 200)).plan((90, 90), (92, 110), method="astar")
    assert (
        plan.ok and plan.checks < 0.1 * most / dem.size * 200 * 200
    )  # a short way checks a small part of the map


@pytest.mark.parametrize(
    ("seed", "start", "goal"),
    [(21, (179, 45), (185, 144)), (23, (147, 34), (129, 22))],
    ids=["far", "near"],
)
def test_a_search_that_checks_on_its_way_is_the_one_over_what_has_been_checked(seed, start, goal):
    """A state's g rises where a motion turns out to be dearer. Its entry on the list must not be
    lost.
    """
    row, col = np.mgrid[:200, :200]
    hills = 0.5 * np.sin(row / 15.0 + seed) + 0.6 * np.cos(col / 17.0)
    made = fresh(with_rocks(hills.astype(np.float32), CELL_M, 0.12, seed), Vehicle(1.5, 1.2, 0.3))
    first, again = (made.plan(start, goal, method="astar") for _ in range(2))
    assert first.status is again.status is Status.NO_PATH  # by turns: all states are looked at


@pytest.mark.parametrize("seed", [24, 104, 170])
def test_a_search_that_reaches_its_limit_of_expansions_calls_no_dearer_path_the_best(seed):
    rng = np.random.default_rng(seed)
    hills = 0.3 * np.cumsum(np.cumsum(rng.normal(0.0, 0.02, (24, 30)), 0), 1)
    heights = (hills + rng.choice([0.0, 0.25], p=[0.93, 0.07], size=(24, 30))).astype(np.float32)
    grid = Planner.of_elevation(heights, 0.5, vehicle=Vehicle(1.4, 1.0, 0.3)).state.grid
    workspace = Workspace(len(grid.weights), grid.robot.moves.states_a_node)

    def search(limit=None):
        return grid.robot.moves.search(grid, Query((4, 4), (19, 25)), workspace, None, limit=limit)

    best = search()
    # on these maps a dearer path is known in this range
    for limit in range(best.expansions - 400, best.expansions, 20):
        found = search(limit)
        assert found.status is not Status.OK or np.array_equal(found.path, best.path)


def test_the_judge_of_motions_can_fail(monkeypatch, planner):
    dem = flat(20, 24)
    made = planner(dem, lazy=False)
    rock = np.where(np.arange(480).reshape(dem.shape) == 250, 0.4, dem)
    assert bodies.problem_with_motions(made, dem) is None
    assert bodies.problem_with_motions(made, rock).kind == "a motion that passes breaks belly"
    made.state.grid.robot.moves.poses.codes[0, 0] = 9
    made.state.grid.robot.moves.poses.codes[300, 3] = 9000
    assert bodies.problem_with_motions(made, dem).kind == "T of a motion is another"
    made.state.grid.robot.moves.poses.codes[300, AXIS_COUNT] = FAILS
    monkeypatch.setattr(bodies, "T_ROUNDED", 1.0)
    assert bodies.problem_with_motions(made, dem).kind == "a code of a motion is another"


SMALL = Vehicle(length_m=1.2, width_m=0.9, clearance_m=0.3, max_tilt_deg=30.0)
LOW = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.05, max_step_m=0.04)
START = (128, 20)
GOAL = (128, 236)


def fresh(dem, vehicle=SMALL, **options):
    return Planner.of_elevation(dem, CELL_M, vehicle=vehicle, warn=False, **options)


@pytest.fixture(scope="module")
def gaps():
    """A wall of rocks that a body cannot see through means: gaps too narrow for it in front, a wide
    one aside.
    """
    dem = flat(256, 256)
    dem[::4, 128] = 0.06  # a post in each block: cheap on average, and no body gets between two
    dem[20:44, 128] = 0.0
    return dem


def test_where_no_pose_passes_the_links_are_closed_and_the_next_region_leads_around(
    gaps, monkeypatch
):
    closed = []
    close = CoarseLevel.close_dead_ends
    monkeypatch.setattr(
        CoarseLevel,
        "close_dead_ends",
        lambda self, *given: closed.append(close(self, *given)) or closed[-1],
    )
    exact = fresh(gaps, LOW).plan(START, GOAL, method="astar")
    planner = fresh(gaps, LOW)
    plan = planner.plan(START, GOAL, method="corridor")
    assert exact.ok and plan.ok and plan.source in (Source.REGION, Source.WIDENED)
    assert any(closed) and plan.cost == pytest.approx(exact.cost, rel=0.01)
    planner.state.grid.tiles.complete()
    links, whole = (
        each.state.pyramid.levels[1].links for each in (planner, fresh(gaps, LOW, lazy=False))
    )
    np.testing.assert_array_equal(links, whole)  # opened again
    moving = DynamicPlanner.of_elevation(gaps, CELL_M, GOAL, method="corridor-dstar", vehicle=LOW)
    moving.move(START)
    assert (
        moving.replan().ok
    )  # what D* Lite reached is not in the memory by which dead ends are found


def test_links_are_closed_by_states_as_by_cells_and_opened_again(gaps):
    state = fresh(gaps, LOW, lazy=False).state
    nodes = len(state.grid.weights)
    finest, above = state.pyramid.levels[:2]
    coarse = CoarseLevel(above, finest)
    everywhere = np.ones((2 * above.grid.rows, 2 * above.grid.cols), np.int32)
    region = Region(everywhere, *finest.quarters, 1)
    links = coarse.level.links.copy()
    closed = []
    for states in (1, 16):
        memory = Workspace(nodes, states)
        stamp = memory.next_stamp()
        of_nodes = memory.meta.reshape(nodes, states, 2)
        of_nodes[: nodes // 2, -1, 1] = stamp << STAMP_SHIFT  # one state of the upper half's cells
        assert coarse.close_dead_ends(region, memory, state.shape)
        closed.append(coarse.level.links.copy())
        coarse.open_dead_ends()
        np.testing.assert_array_equal(coarse.level.links, links)
    np.testing.assert_array_equal(*closed)
    assert (closed[0] != links).any() and not (closed[0] & ~links).any()


def test_to_a_far_goal_a_body_has_a_narrower_corridor(monkeypatch):
    rows, cols = np.mgrid[:160, :500]
    heights = (0.4 * np.sin(rows / 9.0) * np.cos(cols / 13.0)).astype(np.float32)
    plans = []
    for up_to in (150, math.inf):
        monkeypatch.setattr(BodyMoves, "band_up_to", up_to)
        made = Planner.of_elevation(heights, 1.0, vehicle=Vehicle(2.4, 1.2, 0.3))
        plans.append(made.plan((80, 20), (80, 480), method="corridor", keep_regions=True))
    narrow, wide = plans
    assert narrow.region.mask().sum() < 0.9 * wide.region.mask().sum()
    assert narrow.cost == pytest.approx(wide.cost, rel=1e-3)
