"""The simulated drive: its survey, sight and obstacles, and that no path was forbidden."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.runtime import (
    Ground,
    MapPatch,
    Origin,
    PathMessage,
    Planner,
    Traversability,
    Vehicle,
)
from nnpp_edge.runtime.cells import slices
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.simulation.drive_picture import drive_picture
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.simulation.part import part_of_map
from nnpp_edge.simulation.scene import Scene, SimulationSettings, walkable
from nnpp_edge.simulation.simulate import random_drive, simulate
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.obstacles import Obstacles
from nnpp_edge.terrain.rocks import with_rocks
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from nnpp_edge.viz.palette import DRIVEN, SEEN, START, rgb
from tests import pose_oracles
from tests.fuzz import bodies
from tests.tables import cases

LIMITS = Traversability(slope_limit_deg=20.0, hard_slope_deg=20.0)
BODY = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.3)
CAR = replace(BODY, turning_radius_m=2.0, reverse_cost=2.0, gear_change_m=1.0)


def survey(seed=3, cells=6, **more):
    """Synthetic ground on cells of 20 m, whose survey is blurred over so many cells."""
    heights = synthetic_terrain(np.random.default_rng(seed), 80, 20.0)
    return SurveyedGround.of(Ground.of_elevation(heights, 20.0, LIMITS, **more), cells)


@pytest.fixture(scope="module")
def grounds():
    """By the robot that drives there."""
    rng = np.random.default_rng(5)
    bare = synthetic_terrain(rng, 72, 0.4)
    bare[30:33, 40:50] = np.nan
    rocks = Ground.of_elevation(with_rocks(bare, 0.4, 0.04, rng), 0.4, vehicle=BODY)
    body = SurveyedGround.of(rocks, 1, bare)
    heights = synthetic_terrain(np.random.default_rng(2), 80, 20.0)
    return {
        "point": survey(),
        "body": body,
        "disc": survey(2, 1, vehicle=Vehicle(radius_m=26.0)),
        "coarse": SurveyedGround.of_known(Ground.of_elevation(heights, 20.0, LIMITS), 8, "slope"),
        "car": SurveyedGround(replace(rocks, vehicle=CAR), body.surveyed),
    }


def flat(shape=(30, 40)):
    cost = np.full(shape, 0.2, np.float32)
    return SurveyedGround(Ground(cost), cost.copy())


def scene_of(ground, start, goal, **settings):
    asked = SimulationSettings(**{"changes": 0} | settings)
    return Scene(ground, start, goal, np.random.default_rng(0), asked)


def polled(scene, cells, goal=None):
    """What comes after an answer with these cells."""
    path = np.array(cells, np.int32)
    found = (1, Status.OK, Origin.FULL, path, cells[0], goal or scene.goal)
    scene.heard(PathMessage(*found))
    return list(scene.poll())


# --- the scene


def test_the_survey_is_the_terrain_blurred():
    ground = survey()
    known = np.isfinite(ground.true) & np.isfinite(ground.surveyed)
    assert known.mean() > 0.5
    assert ground.surveyed[known].mean() < ground.true[known].mean()
    all_known = survey(cells=1)
    np.testing.assert_array_equal(all_known.true, all_known.surveyed)
    heights = ground.heights.copy()
    heights[10:20, 30:40] = np.nan
    holed = SurveyedGround.of(Ground.of_elevation(heights, 20.0, LIMITS), 6)
    assert np.isinf(holed.surveyed[10:20, 30:40]).all()


def test_obstacles_come_move_and_go_and_stay_away_from_robot_and_goal():
    obstacles = Obstacles((40, 50), np.random.default_rng(0))
    base = np.full((40, 50), 0.2, np.float32)
    path = np.array([(5 + n, 5 + n) for n in range(25)], np.int32)
    shown = base.copy()
    kinds = set()
    across = 0
    for _ in range(600):
        before = list(obstacles.blocks)
        for part in obstacles.one_event((5, 5), (30, 40), path):
            shown[slices(part)] = obstacles.cover(base, part)
        if obstacles.blocks != before:
            kinds.add(len(obstacles.blocks) - len(before))
        expected = base.copy()
        for part in obstacles.blocks:
            assert expected[slices(part)].shape == part[2:], "inside the map"
            expected[slices(part)] = 1.0
        np.testing.assert_array_equal(shown, expected)
        for row, col in ((5, 5), (30, 40)):
            assert expected[row - 3 : row + 4, col - 3 : col + 4].max() < 1.0
        across += (expected[*path.T] >= 1.0).any()
    assert kinds == {1, -1, 0}, "one comes, goes or moves"
    assert 60 < across < 600


def test_the_robot_sees_what_is_around_it_and_tells_no_more():
    true = np.full((30, 40), 0.2, np.float32)
    true[:, 20] = 1.0
    true[29, 20] = 0.2
    ground = SurveyedGround(Ground(true), np.full((30, 40), 0.1, np.float32))
    scene = scene_of(ground, (15, 12), (15, 35), sight=4)
    goal, patch, pose = scene.poll()
    assert (goal.cell, pose.cell) == ((15, 35), (15, 12))
    np.testing.assert_array_equal(patch.cost, true[11:20, 8:17])
    assert (scene.told[:, 17:30] == np.float32(0.1)).all(), "the wall is out of sight"
    line = [(15, 12 + n) for n in range(24)]
    for _ in range(20):
        polled(scene, line)
    assert scene.robot == (15, 19), "it stops before what it cannot cross"
    assert (scene.waited, scene.driven) == (13, line[:8])
    assert scene.forbidden == sum(n >= 4 for n in range(20))


def test_a_scene_moves_only_along_its_path():
    scene = scene_of(flat(), (5, 5), (20, 30), speed=3)
    for _ in range(2):
        list(scene.poll())
    assert scene.robot == (5, 5) and scene.waited == 1
    polled(scene, [(9, 9), (10, 10)])
    assert scene.robot == (5, 5), "a path that begins elsewhere"
    assert scene.forbidden == 1, "and does not lead to the goal"
    line = [(5, 5), (5, 6), (5, 7), (6, 8), (6, 9)]
    polled(scene, line, (6, 9))
    assert (scene.robot, scene.driven) == ((6, 8), line[:-1])


WALKS = """
1 1  2 2  3 2           | fits
3 2                     | fits
1 1  2 2                | ends elsewhere
1 1  1 1  2 2  3 2      | repeats a cell
1 0  3 2                | jumps
4 1  4 2  3 2           | is blocked
-1 1  0 1  1 1  2 2  3 2 | begins outside
                        | is empty
"""


@pytest.mark.parametrize(("path", "how"), cases(WALKS))
def test_what_can_be_walked_is_checked_by_the_definition(path, how):
    cost = np.full((5, 5), 0.3, np.float32)
    cost[4, 2] = np.nan
    cost[4, 1] = 1.0
    cells = np.array(path.split(), np.int32).reshape(-1, 2)
    assert walkable(SurveyedGround(Ground(cost), cost), cells, cost, (3, 2)) == (how == "fits")


# --- the drive


@pytest.mark.parametrize(
    ("kind", "method"),
    [
        ("point", "auto"),
        ("point", "astar"),
        ("point", "nnpp-dstar"),
        ("body", "corridor"),
        ("body", "dstar"),
        ("coarse", "auto"),
        ("car", "auto"),
    ],
)
def test_the_robot_reaches_its_goal_and_no_path_was_forbidden(grounds, kind, method, tiny_model):
    ground = grounds[kind]
    seen = []
    start, goal = random_drive(ground, 1)
    settings = SimulationSettings(method, str(tiny_model), ticks=1500, changes=2)
    drive = simulate(ground, start, goal, settings, watch=lambda scene, m: seen.append(m))
    assert drive.reached and drive.forbidden == 0 and drive.counters.errors == {}
    assert len(seen) == drive.counters.ticks and drive.counters.planned > 5
    longest = {"body": 2, "car": 5}.get(kind, 1)
    steps = np.abs(np.diff(drive.driven, axis=0)).max(axis=1)
    assert steps.min() >= 1 and steps.max() <= longest
    assert (tuple(drive.driven[0]), tuple(drive.driven[-1])) == (start, goal)
    if kind == "body":
        planner = Planner.of_elevation(ground.true, 0.4, vehicle=BODY, warn=False)
        priced = bodies.priced(planner, 0.0)
        legs = itertools.pairwise(drive.driven.tolist())
        costs = [pose_oracles.path_cost(priced, leg) for leg in legs]
        assert np.isfinite(costs).all(), "nor over rocks that it saw on its way"
    else:
        assert (ground.costs()[drive.driven[:, 0], drive.driven[:, 1]] < 1.0).all()
    assert {message.known is not None for message in seen if message.ok} == {kind == "coarse"}
    best = Planner(ground.ground).plan(start, goal, method="astar").cost
    assert drive.optimal_cost == pytest.approx(best)
    assert best * (1 - 1e-6) <= drive.driven_cost < math.inf
    assert drive.excess == pytest.approx(drive.driven_cost / best - 1.0)
    json.dumps(drive.summary())
    drawn = {line.get_label(): line for line in drive_picture(ground, drive).axes[0].lines}
    np.testing.assert_array_equal(drawn["driven"].get_xydata()[:, ::-1], drive.driven)
    assert ("vehicle" in drawn) == (kind in ("body", "car"))


@pytest.mark.parametrize(
    ("kind", "method"),
    [
        ("point", "nnpp"),
        ("point", "corridor"),
        ("body", "dstar"),
        ("body", "corridor-dstar"),
        ("disc", "auto"),
        ("coarse", "auto"),
    ],
)
def test_an_endless_drive_goes_from_goal_to_goal_and_keeps_its_word_and_its_memory(
    grounds, kind, method, tiny_model
):
    ground = grounds[kind]
    start, goal = random_drive(ground, 1)
    ticks = 150 if kind == "disc" else 300
    given = {"ticks": ticks, "changes": 2, "speed": 3, "endless": True}
    drive = simulate(ground, start, goal, SimulationSettings(method, str(tiny_model), **given))
    assert (drive.forbidden, drive.counters.errors, drive.counters.ticks) == (0, {}, ticks)
    assert drive.goals >= 2 and drive.counters.planned > 20 and drive.goal != goal
    assert tuple(drive.driven[0]) == drive.start and len(drive.driven) < 250
    assert drive.memory_mb["end"] - drive.memory_mb["tenth"] < 5.0 < drive.memory_mb["start"]


def test_the_same_seed_gives_the_same_drive(grounds):
    ground = grounds["point"]
    ends = random_drive(ground, 1)
    first, again, other = (
        simulate(ground, *ends, SimulationSettings("corridor", ticks=500, changes=3, seed=seed))
        for seed in (4, 4, 5)
    )
    np.testing.assert_array_equal(first.driven, again.driven)
    assert first.driven_cost == again.driven_cost
    assert not np.array_equal(first.driven, other.driven)


SENSELESS = {5: "cannot be reached", 20: "impassable", 40: "outside the map of 30 × 40"}
"""The start's column, and words of the refusal."""


@pytest.mark.parametrize(("col", "words"), SENSELESS.items())
def test_what_makes_no_sense_is_refused(col, words):
    wall = flat()
    wall.true[:, 20] = 1.0
    with pytest.raises(InvalidQueryError, match=words):
        simulate(wall, (5, col), (20, 30))


def test_on_islands_start_and_goal_must_be_given():
    islands = flat((40, 40))
    islands.true[:, 3::4] = islands.true[3::4] = 1.0
    with pytest.raises(InvalidQueryError, match="give start and goal"):
        random_drive(islands, 1)


# --- a body


@pytest.mark.parametrize("step_cost", ["paper", "energy", "tobler"])
def test_a_drive_costs_the_optimum_where_all_is_known_and_nothing_is_met(step_cost):
    known = survey(cells=1, step_cost=step_cost, mobility=load_mobility("large-rover"))
    start, goal = random_drive(known, 1)
    drive = simulate(known, start, goal, SimulationSettings("dstar", ticks=1500, changes=0))
    best = Planner(known.ground).plan(start, goal, method="astar").cost
    assert [drive.driven_cost, drive.optimal_cost] == pytest.approx([best, best], rel=1e-5)
    assert (drive.counters.planned, drive.forbidden, drive.counters.errors) == (1, 0, {})


def test_a_body_stops_before_a_rock_and_is_told_heights():
    level = np.zeros((40, 60), np.float32)
    rocks = level.copy()
    rocks[18:23, 40:43] = 1.0
    ground = SurveyedGround.of(Ground.of_elevation(rocks, 0.25, vehicle=BODY), 1, level)
    scene = scene_of(ground, (20, 10), (20, 55), sight=1)
    told = list(scene.poll())
    assert scene.told[20, 41] == 0.0
    for _ in range(60):
        told += polled(scene, [(20, 10 + n) for n in range(46)])
    reach = ground.reach
    assert 39 - reach <= scene.robot[1] < 40 - 3, "half a body before it"
    assert scene.waited > 20 and scene.told[20, 40] == 1.0
    assert 20 < scene.forbidden < 60, "once it is seen, the path is forbidden"
    patches = [message for message in told if isinstance(message, MapPatch)]
    assert all(patch.cost is None for patch in patches)
    assert patches[0].shape == (2 * reach + 3, 2 * reach + 3)


def test_obstacles_stand_above_the_ground_and_out_of_the_bodys_reach():
    level = Ground.of_elevation(np.zeros((80, 80), np.float32), 0.25, vehicle=BODY)
    ground = SurveyedGround.of(level, 1)
    ends = ((40, 10), (40, 70))
    scene = scene_of(ground, *ends, changes=3)
    for _ in range(100):
        list(scene.poll())
        assert scene.now.max() in (0.0, np.float32(ground.obstacle(ground.true)))
        assert all(ground.stands(scene.now, cell) for cell in ends)
        np.testing.assert_array_equal(scene.now, scene.told)
    blocked = np.isinf(ground.costs_on(scene.now)) & ~np.isinf(ground.costs())
    assert blocked.sum() > (scene.now > 0.0).sum() / 2


# --- the command

WORDS = "simulate --size 48 --vehicle small-rover --rocks 0.02 --method corridor"


def test_the_command_drives_a_body_writes_draws_and_tells(nnpp_edge, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    image = pytest.importorskip("PIL.Image")
    words = WORDS.split()
    log = tmp_path / "new" / "drive.mcap"
    film = tmp_path / "drive.gif"
    still = tmp_path / "drive.png"
    ended = nnpp_edge(*words, "--json", "--log", log, "--picture", film)
    assert ended.code == 0, ended.err
    told = ended.json
    assert told["reached"] and told["forbidden"] == 0
    assert (told["rows"], told["cols"], told["files"]) == (48, 48, [str(log), str(film)])
    with log.open("rb") as file:
        topics = [channel.topic for _, channel, _ in reader.make_reader(file).iter_messages()]
    assert topics.count("/answer") == topics.count("/pose") == told["ticks"]
    with image.open(film) as frames:
        assert 1 < frames.n_frames <= 81
        frames.seek(frames.n_frames - 1)
        last = np.asarray(frames.convert("RGB"))
        assert all((last == rgb(colour)).all(-1).sum() > 50 for colour in (DRIVEN, SEEN, START))
    ended = nnpp_edge(*words, "--ticks", 9, "--rate", 60, "--picture", still)
    assert ended.code == 1
    place = f"48 × 48 cells of moon_highlands.npz, from cell ({told['row']}, {told['col']}) on"
    assert "GOAL NOT REACHED" in ended.out and "9:" in ended.out and place in ended.out
    with image.open(still) as picture:
        assert min(picture.size) > 800


def test_both_ends_lie_well_inside_the_part_that_is_cut_out_and_are_named_as_in_the_file(
    nnpp_edge, tmp_path
):
    heights = np.zeros((120, 130), np.float32)
    heights[60, 70:] = np.nan
    np.savez(tmp_path / "map.npz", elevation_m=heights, cell_size_m=0.16)
    words = ("simulate", "--map", tmp_path / "map.npz", "--vehicle", "small-rover", "--size", 50)
    words += ("--ticks", 1, "--json", "--start", "40,50")
    nnpp_edge(*words, "--goal", "60,72").refused("goal (60, 72) is impassable, on the part")
    nnpp_edge(*words, "--goal", "86,72").refused("--size 50 holds with 4 cells around each")
    told = nnpp_edge(*words, "--goal", "50,60").json
    ends = (told["start"], told["goal"])
    assert ends == ([40, 50], [50, 60])
    whole = Dem(heights, 0.16, 0.16, None, Path("map.npz"))
    rover = load_vehicle("small-rover")
    assert part_of_map(whole, 50, 1, rover, 0, ends) == (20, 30, 50, 50)
    assert part_of_map(whole, 50, 1, rover, 0, ([2, 90], [9, 129])) == (0, 80, 50, 50)
    corners = {part_of_map(whole, 50, 1, rover, seed)[:2] for seed in range(8)}
    assert len(corners) == 8 and all(0 <= row <= 70 and 0 <= col <= 80 for row, col in corners)
