"""What a tab of `nnpp-edge view` asks and is answered, without browser and server."""

import json
import math
import warnings
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError, Status
from nnpp_edge.terrain.dem import read_dem
from nnpp_edge.view import layers
from nnpp_edge.view import trial as trials
from nnpp_edge.view.answers import Answerer
from nnpp_edge.view.asked import Asked, changed
from nnpp_edge.view.landscape import Landscape, likely_ends
from nnpp_edge.view.messages import Compare, Layer, Mend, Move, Open, Paint, Undo, decode
from nnpp_edge.view.site import Body, Reading, Site
from nnpp_edge.view.trial import Trial
from nnpp_edge.view.words import command_of, python_of
from tests.view_cases import write_ground

ENDS = {"start": (8, 8), "goal": (86, 110)}
OBSTACLES = ((30, 30, 12, 20), (60, 50, 9, 40), (35, 25, 20, 12))
SETTINGS = {
    "plain": {},
    "limits": {"slope_limit": 25.0, "hard_slope": 7.5, "hard_step": 1.25, "step_limit": 0.5, "omega": 0.02},
    "shortest": {"step_cost": "length", "method": "astar", "corner_cutting": False},
    "any angle": {"refine": True, "method": "corridor"},
    "on foot": {"step_cost": "tobler"},
    "on foot off paths": {"step_cost": "irmischer"},
    "energy of a vehicle": {"step_cost": "energy", "body": "large-rover", "max_tilt": 40.0, "clearance": 1.5},
    "vehicle": {"body": "large-rover", "method": "corridor"},
}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    path = write_ground(tmp_path_factory.mktemp("ground"))
    return Site.of(read_dem(path), Reading(path))


def trial_of(site, name="plain", **values):
    return Trial(site, changed(Asked(**ENDS), SETTINGS[name] | values))


@pytest.mark.parametrize("name", SETTINGS)
def test_the_copied_command_plans_the_same_path(nnpp_edge, site, name):
    trial = trial_of(site, name)
    words = command_of(site, trial.asked).split()
    assert words[:2] == ["nnpp-edge", "plan"]
    told = json.loads(nnpp_edge(*words[1:], "--json").out)
    assert trial.plan.ok
    assert (told["status"], told["method"], told["cost"]) == ("OK", trial.plan.planner, round(trial.plan.cost, 6))
    assert told["length_m"] == pytest.approx(trial.plan.numbers.length_m, abs=1e-5)
    assert told.get("line_cost") == (round(trial.plan.line_cost, 6) if SETTINGS[name].get("refine") else None)


@pytest.mark.parametrize("name", SETTINGS)
def test_the_copied_python_plans_the_same_path_around_obstacles(site, name):
    trial = trial_of(site, name)
    for part in OBSTACLES:
        trial.paint(part)
    made = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(python_of(site, trial.asked), made)
    assert made["plan"].ok and made["plan"].cost == trial.plan.cost


def test_what_the_command_line_describes_is_copied_too(nnpp_edge, site):
    options = ("--vehicle", "large-rover", "--set", "max_step_m=0.6", "--mobility", "tracked")
    vehicle = replace(Body.shipped("large-rover").vehicle, max_step_m=0.6)
    given = Site.of(site.dem, site.reading, Body.given(vehicle, Body.shipped("tracked").mobility, options))
    trial = Trial(given, Asked(**ENDS, body="as given", step_cost="time"))
    told = json.loads(nnpp_edge(*command_of(given, trial.asked).split()[1:], "--json").out)
    made = {}
    exec(python_of(given, trial.asked), made)
    assert trial.plan.ok
    assert told["cost"] == round(trial.plan.cost, 6) and made["plan"].cost == trial.plan.cost


@pytest.mark.parametrize("name", ["plain", "on foot", "vehicle"])
def test_painting_and_undoing_leave_the_map_as_if_made_so(site, name):
    rng = np.random.default_rng(4)
    trial = trial_of(site, name, method="astar")
    for _ in range(12):
        if rng.random() < 0.35:
            trial.undo()
        else:
            row, col = rng.integers(15, 75, 2).tolist()
            trial.paint((row, col, *rng.integers(1, 25, 2).tolist()))
        afresh = Trial(site, trial.asked)
        assert trial.plan.cost == pytest.approx(afresh.plan.cost, rel=1e-6)
        assert np.array_equal(trial.landscape.cost, afresh.landscape.cost)
        for row, col, rows, cols in trial.asked.obstacles:
            inside = (trial.plan.path >= (row, col)) & (trial.plan.path < (row + rows, col + cols))
            assert not inside.all(1).any()
    trial.clear()
    assert trial.plan.cost == pytest.approx(trial_of(site, name, method="astar").plan.cost, rel=1e-6)


@pytest.mark.parametrize("name", ["plain", "on foot", "vehicle"])
def test_a_mended_path_is_as_good_as_one_planned_afresh(site, name):
    trial = trial_of(site, name, method="astar")
    trial.paint(OBSTACLES[0])
    trial.paint(OBSTACLES[1])
    before = trial.mend()
    assert before.mended.cost == pytest.approx(trial.plan.cost, rel=1e-5)
    row, col = trial.plan.path[len(trial.plan.path) // 2].tolist()
    trial.paint((row - 2, col - 2, 5, 5))
    mended = trial.mend()
    assert mended.footing == "blocked"
    assert mended.mended.cost == pytest.approx(trial.plan.cost, rel=1e-5)
    assert mended.afresh.cost == pytest.approx(trial.plan.cost, rel=1e-5)
    trial.clear()
    trial.change({"start": (10, 12)})
    assert trial.mend().mended.cost == pytest.approx(trial.plan.cost, rel=1e-5)


def test_methods_side_by_side_are_measured_against_exact_astar(site):
    trial = trial_of(site, "limits")
    compared = {method: trial.compare(method) for method in ("auto", "astar", "corridor", "nnpp")}
    exact = trial.landscape.plan(trial.asked, "astar").cost
    assert compared["astar"].gap == 0.0 and compared["astar"].plan.region is None
    for found in compared.values():
        assert found.gap == pytest.approx(found.plan.cost / exact - 1.0) and found.gap >= 0.0
    assert compared["corridor"].plan.region is not None
    trial.paint(OBSTACLES[0])
    assert trial.compare("astar").gap == 0.0


def test_what_cannot_be_asked_changes_nothing(site):
    trial = trial_of(site)
    before = trial.asked, trial.plan, trial.landscape
    wrong = {"step_cost": "energy", "body": "hovercraft", "slope_limit": 0.0, "nonsense": 1}
    named = [{name: value} for name, value in wrong.items()]
    for values in (*named, {"omega": "much"}, {"omega": -1.0}, {"body": "tracked", "clearance": 0.0}):
        with pytest.raises(NnppEdgeError):
            trial.change(values)
        assert (trial.asked, trial.plan, trial.landscape) == before


def test_an_answer_tells_what_lies_along_the_path(site):
    trial = trial_of(site)
    answers = Answerer(trial).answer(Move(end="goal", to=(80, 100), number=7))
    (path,) = answers
    assert path["number"] == 7 and path["ok"] and path["goal"] == (80, 100)
    rows, cols = np.array(path["rows"], int), np.array(path["cols"], int)
    assert np.array_equal(np.stack((rows, cols), 1), trial.plan.path)
    assert path["cost"] == pytest.approx(trial.landscape.cost[rows, cols].tolist(), abs=5e-4)
    assert path["height_m"] == pytest.approx(site.dem.elevation[rows, cols].tolist(), abs=6e-3)
    assert path["distance_m"][-1] == pytest.approx(trial.plan.numbers.length_m, abs=0.05)
    json.dumps(answers, allow_nan=False)


def test_every_message_is_answered_and_a_wrong_one_in_a_line(site):
    answerer = Answerer(trial_of(site))
    kinds = {
        Open(pixels=40): ["opening", "path", "layer", bytes, "layer", bytes],
        Layer(name="slope"): ["layer", bytes],
        Compare(method="corridor"): ["compared", "layer", bytes],
        Paint(part=OBSTACLES[0]): ["path", "layer", bytes],
        Mend(): ["mended"],
        Undo(all=True): ["path", "layer", bytes],
        Move(end="start", to=(-5, 900)): ["path"],
        Paint(part=(500, 0, 5, 5)): ["problem"],
        Compare(method="guess"): ["problem"],
    }
    for message, wanted in kinds.items():
        found = answerer.answer(message)
        assert [bytes if isinstance(each, bytes) else each["type"] for each in found] == wanted
        json.dumps([each for each in found if not isinstance(each, bytes)], allow_nan=False)
    assert answerer.trial.plan.status is Status.START_OUTSIDE_MAP
    for text in ("", "{", '{"type": "fly"}', '{"type": "move", "end": "middle", "to": [1, 2]}', "[" * 5000):
        with pytest.raises(InvalidQueryError):
            decode(text)


def test_layers_have_no_more_pixels_than_the_screen(site):
    cost = Trial(site, changed(Asked(**ENDS), {"hard_slope": 7.5})).landscape.cost
    for pixels, shape in ((2000, (96, 120)), (60, (48, 60)), (64, (51, 64))):
        relief, slope, costs = (
            layers.relief(site.dem, pixels),
            layers.slope(site.dem, pixels),
            layers.costs(cost, pixels),
        )
        assert relief.shape == slope.shape == costs.shape == shape
        middle = (shape[0] * 46 // 96, shape[1] * 66 // 120)
        assert relief[middle] == layers.UNKNOWN and costs[middle] == layers.IMPASSABLE
        assert (relief[: shape[0] // 3] != layers.UNKNOWN).all()
    assert np.array_equal(layers.costs(cost, 2000) == layers.IMPASSABLE, cost >= 1.0)


def test_first_ends_are_passable(site):
    landscape = Landscape(site, Asked(**ENDS, hard_slope=10.0))
    ends = likely_ends(landscape.cost)
    trial = Trial(site, Asked(start=ends[0], goal=ends[1], hard_slope=10.0), landscape)
    assert trial.plan.status in (Status.OK, Status.NO_PATH)
    assert math.hypot(*np.subtract(*ends)) > 60.0
    assert likely_ends(np.full((30, 40), np.inf, np.float32)) is None


def test_first_ends_are_where_the_vehicle_stands(tmp_path):
    """A robot's map is known in its middle, and no body stands at the edge of what is known."""
    heights = np.full((60, 60), np.nan, np.float32)
    heights[15:45, 10:50] = 0.0
    np.savez(tmp_path / "window.npz", elevation_m=heights, cell_size_m=0.5)
    site = Site.of(read_dem(tmp_path / "window.npz"), Reading(tmp_path / "window.npz"))
    landscape = Landscape(site, Asked(**ENDS, body="large-rover"))
    ends, bare = likely_ends(landscape.cost, landscape.stands), likely_ends(landscape.cost)
    assert all(map(landscape.stands, ends)) and not any(map(landscape.stands, bare))
    assert likely_ends(landscape.cost, lambda cell: False) == bare


def test_a_plan_shows_itself_and_escapes_what_it_was_told():
    matplotlib.use("agg")
    planner = Planner(np.full((40, 60), 0.2, np.float32))
    plan = planner.plan((3, 4), (30, 50), method="corridor", keep_regions=True)
    shown = replace(plan, reason="<script>alert('1')</script>")._repr_html_()
    assert "<script>" not in shown and "&lt;script&gt;" in shown and "<svg" in shown
    assert f"{plan.cost:.6g}" in shown
    assert "<svg" not in planner.plan((3, 4), (90, 90))._repr_html_()
    axes = plan.plot(background=np.zeros((40, 60)))
    drawn = [line.get_xydata()[:, ::-1] for line in axes.lines]
    assert any(np.array_equal(line, plan.path) for line in drawn)
    assert plan.plot(axes) is axes and planner.plan((3, 4), (90, 90)).plot().yaxis_inverted()
    with pytest.raises(NnppEdgeError, match=r"background must be \(H, W\)"):
        plan.plot(background=np.zeros(5))
    pyplot.close("all")


def test_an_obstacle_is_cut_to_the_map_and_there_are_at_most_so_many(site, monkeypatch):
    monkeypatch.setattr(trials, "MOST_OBSTACLES", 2)
    trial = trial_of(site, "plain")
    height, width = site.dem.shape
    trial.paint((-5, -7, 8, 10))
    trial.paint((height - 2, 30, 50, 4))
    painted = ((0, 0, 3, 3), (height - 2, 30, 2, 4))
    assert trial.asked.obstacles == painted
    with pytest.raises(InvalidQueryError, match="at most 2 obstacles"):
        trial.paint((20, 20, 2, 2))
    trial.undo()
    with pytest.raises(InvalidQueryError, match="must cover cells"):
        trial.paint((0, width, 3, 3))
    assert trial.asked.obstacles == painted[:1]


def test_whatever_the_map_depends_on_is_asked_of_another_map(site):
    others = {"omega": 0.05, "slope_limit": 20.0, "roughness_limit": 0.05, "step_limit": 0.05, "hard_slope": 12.0}
    others |= {"hard_roughness": 0.3, "hard_step": 0.3, "step_cost": "tobler", "corner_cutting": False}
    for name, value in (others | {"body": "large-rover"}).items():
        trial = trial_of(site, method="astar")
        assert trial.change({name: value}), name
        assert trial.plan.cost == trial_of(site, method="astar", **{name: value}).plan.cost, name
        assert not trial.change({"method": "corridor"}), name
