"""Answers to the questions of `nnpp-edge view`'s page, without browser and server."""

import json
import math
import re
from dataclasses import replace

import matplotlib
import msgspec
import numpy as np
import pytest
from matplotlib import pyplot
from msgspec.structs import replace as with_values

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.terrain.traversability import Traversability, terrain_terms
from nnpp_edge.terrain.dem import read_dem
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.view import answers
from nnpp_edge.view.answers import Answerer
from nnpp_edge.view.asked import Asked, Body, Site, command_of
from nnpp_edge.view.landscape import Landscape, likely_ends
from tests.strategies import flat
from tests.view_cases import write_ground

PLAIN = Asked(start=(8, 8), goal=(86, 110))
EXACT = with_values(PLAIN, method="astar")
OBSTACLES = ((30, 30, 12, 20), (60, 50, 9, 40), (35, 25, 20, 12))
LIMITS = Traversability(25.0, step_limit_m=0.5, hard_slope_deg=7.5, hard_step_m=1.25)
SETTINGS = {
    "plain": {},
    "limits": {"limits": LIMITS, "omega": 0.02},
    "shortest": {"omega": 0.0, "method": "astar", "corner_cutting": False},
    "any angle": {"refine": True, "method": "corridor"},
    "on foot": {"step_cost": "tobler"},
    "energy of a vehicle": {
        "step_cost": "energy",
        "body": "large-rover",
        "max_tilt_deg": 40.0,
        "clearance_m": 1.5,
        "method": "auto",
    },
    "vehicle": {"body": "large-rover", "method": "corridor"},
    "by way of places": {"via": ((70, 20), (20, 90)), "refine": True, "method": "corridor"},
    "arcs": {
        "body": "car",
        "via": ((60, 20),),
        "method": "corridor",
        "start_heading_deg": 270.0,
        "goal_heading_deg": 12.5,
    },
}
CAR = {"turning_radius_m": 8.0, "reverse_cost": 2.0}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    path = write_ground(tmp_path_factory.mktemp("ground"))
    site = Site.of(read_dem(path), path, {})
    words = [f"--set={name}={value}" for name, value in CAR.items()]
    words = ("--vehicle", "large-rover", *words)
    car = Body(
        replace(site.bodies["large-rover"].vehicle, **CAR), site.bodies["none"].mobility, words
    )
    return replace(site, bodies={**site.bodies, "car": car})


def ask(answerer, want, asked, **more):
    """The answer, and the layer or the file that comes with it."""
    if isinstance(asked, Asked):
        asked = in_json(asked)
    question = msgspec.json.encode({"want": want, "asked": asked, **more})
    line, _, content = answerer.answer(question).partition(b"\n")
    answer = json.loads(line)
    if "layer" in answer:
        content = np.frombuffer(content, np.uint8).reshape(answer["layer"])
    return answer, content


def in_json(asked):
    """As the page sends it: without what is off."""
    found = json.loads(msgspec.json.encode(asked))
    found["limits"] = {name: value for name, value in found["limits"].items() if value is not None}
    return {name: value for name, value in found.items() if value is not None}


def planned(site, asked):
    return Landscape(site, asked).plan(asked, asked.method)


@pytest.fixture(scope="module")
def answerer(site):
    return Answerer(site, PLAIN)


@pytest.mark.parametrize("name", SETTINGS)
def test_what_is_copied_plans_the_same_path(nnpp_edge, site, name):
    asked = with_values(PLAIN, **SETTINGS[name])
    plan = planned(site, asked)
    words = command_of(site, asked).split()
    assert plan.ok and words[:2] == ["nnpp-edge", "plan"]
    told = nnpp_edge(*words[1:], "--json").json
    assert (told["status"], told["method"], told["cost"]) == (
        "OK",
        plan.planner,
        round(plan.cost, 6),
    )
    assert told.get("line_cost") == (round(plan.line_cost, 6) if asked.refine else None)


def test_what_the_command_line_describes_is_copied_too(nnpp_edge, site):
    options = ("--vehicle", "large-rover", "--set", "max_step_m=0.6", "--mobility", "tracked")
    vehicle = replace(site.bodies["large-rover"].vehicle, max_step_m=0.6)
    reading = {"cell_size": 1.5}
    dem = read_dem(site.path, 1.5)
    given = Site.of(
        dem,
        site.path,
        reading,
        Body(vehicle, site.bodies["tracked"].mobility, options),
        model="edge-fp32",
    )
    asked = with_values(PLAIN, body="as given", step_cost="time")
    plan = planned(given, asked)
    assert "--model edge-fp32" in command_of(given, asked)
    told = nnpp_edge(*command_of(given, asked).split()[1:], "--json").out
    assert plan.ok and json.loads(told)["cost"] == round(plan.cost, 6)


@pytest.mark.parametrize("name", ["plain", "on foot", "vehicle"])
def test_obstacles_that_come_and_go_leave_the_map_as_if_made_so(site, name):
    asked = with_values(PLAIN, **SETTINGS[name] | {"method": "astar"})
    answerer = Answerer(site, asked)

    def plan(obstacles):
        return answerer.landscape(with_values(asked, obstacles=obstacles)).plan(asked, "astar")

    for obstacles in (OBSTACLES[:1], OBSTACLES, OBSTACLES[1:]):
        found = plan(obstacles)
        anew = Answerer(site, asked).landscape(with_values(asked, obstacles=obstacles))
        assert found.cost == pytest.approx(anew.plan(asked, "astar").cost, rel=1e-6)
        for row, col, rows, cols in obstacles:
            inside = (found.path >= (row, col)) & (found.path < (row + rows, col + cols))
            assert not inside.all(1).any()
    assert plan(()).cost == pytest.approx(planned(site, asked).cost, rel=1e-6)


def test_a_method_beside_others_is_told_with_its_region(answerer):
    asked = with_values(PLAIN, **SETTINGS["limits"])
    exact, none = ask(answerer, "compare", asked, method="astar")
    corridor, region = ask(answerer, "compare", asked, method="corridor", pixels=64)
    assert not none and exact["share"] is None and exact["method"] == "astar"
    assert corridor["cost"] >= exact["cost"] * (1 - 1e-6) and corridor["time_ms"] > 0.0
    assert region.shape == (51, 64) and 0.0 < corridor["share"] < 1.0
    assert corridor["share"] == pytest.approx(region.mean() / 255.0, abs=0.02)
    assert corridor["line"][0] == [8, 8] and corridor["line"][-1] == [86, 110]


def test_the_time_of_a_method_is_the_median_of_three_after_a_first(site):
    landscape = Landscape(site, PLAIN)
    taken = iter((99.0, 5.0, 3.0, 4.0, 101.0))
    plan = landscape.plan(PLAIN, "astar")
    landscape.plan = lambda *_, **__: replace(plan, timings_ms={"total": next(taken)})
    assert [landscape.compare(PLAIN, "astar")[1] for _ in range(2)] == [4.0, 101.0]


WRONG = """
{"step_cost": "energy"}
{"body": "hovercraft"}
{"nonsense": 1}
{"omega": "much"}
{"omega": -1.0}
{"limits": {"slope_limit_deg": 0.0}}
{"body": "tracked", "clearance_m": 0.0}
{"start": [1]}
{"obstacles": [[0, 0, 0, 0]]}
{"obstacles": [[-1, 5, 3, 3]]}
{"obstacles": [[90, 0, 7, 3]]}
{"obstacles": [[0, 118, 3, 3]]}
{"start_heading_deg": -1.0}
{"goal_heading_deg": "up"}
{"via": [[45, 66]]}
{"via": [[-1, 0]]}
"""


def test_what_cannot_be_asked_is_answered_in_a_line(answerer):
    plain = in_json(PLAIN)
    wrong = [json.loads(line) for line in WRONG.strip().splitlines()]
    wrong += [{"obstacles": [[0, 0, 1, 1]] * 201}, {"via": [[9, 9]] * 51}]
    for values in wrong:
        told, _ = ask(answerer, "path", plain | values)
        assert set(told) == {"problem"} and "\n" not in told["problem"], values
    for text in (b"", b"{", b'{"want": "fly"}', b"\xff", b"[" * 5000):
        assert b'{"problem":"a question cannot be read (' in answerer.answer(text)
    assert ask(answerer, "path", plain)[0]["ok"]
    outside, _ = ask(answerer, "path", plain | {"start": [-5, 900]})
    assert outside["figures"]["status"] == "START_OUTSIDE_MAP"
    assert not (outside["ok"] or outside["rows"])


def test_an_answer_tells_what_lies_along_the_path(answerer, site):
    asked = with_values(PLAIN, goal=(80, 100), obstacles=OBSTACLES)
    path, _ = ask(answerer, "path", asked)
    landscape = answerer.landscape(asked)
    plan = landscape.plan(asked, asked.method)
    rows = np.array(path["rows"], int)
    cols = np.array(path["cols"], int)
    assert path["ok"] and np.array_equal(np.stack((rows, cols), 1), plan.path)
    assert path["cost"] == pytest.approx(landscape.cost[rows, cols].tolist(), abs=5e-4)
    assert path["height_m"] == pytest.approx(site.dem.elevation[rows, cols].tolist(), abs=6e-3)
    assert path["distance_m"][-1] == pytest.approx(plan.numbers.length_m, abs=0.05)
    assert path["figures"]["cost"] == round(plan.cost, 6) and path["unit"] == ""
    facts = dict(path["facts"])
    assert facts["cost"].startswith(f"{plan.cost:.6g}, ") and "way" not in facts


def test_the_page_opens_with_vehicles_and_the_first_question(answerer):
    opening = json.loads(answerer.opening())
    bodies = opening["bodies"]
    assert bodies["none"]["clearance_m"] is None and bodies["large-rover"]["clearance_m"] > 0.0
    assert bodies["small-rover"]["outline"]["length_m"] > 0.0
    assert [name for name, body in bodies.items() if body["arcs"]] == ["car"]
    assert opening["asked"]["start"] == [8, 8]
    assert opening["asked"]["limits"]["hard_slope_deg"] == 30.0


def test_a_place_is_told_in_all_coordinates(site):
    pyproj = pytest.importorskip("pyproj")
    moon = pyproj.CRS.from_user_input("+proj=eqc +R=1737400 +units=m").to_wkt()
    degree = 1737400.0 * math.pi / 180.0
    place = Georeference(moon, (2.0, 0.0, -3.0 * degree, 0.0, -2.0, 5.0 * degree))
    located = replace(site, dem=replace(site.dem, georeference=place))
    told, _ = ask(Answerer(located, PLAIN), "place", PLAIN, at=[0, 0])
    cell, xy, lon_lat, _ = told["words"]
    assert (cell, xy) == ("row 0, column 0", f"x {1 - 3 * degree:.9g}, y {5 * degree - 1:.9g}")
    lon, lat = map(float, re.fullmatch(r"([\d.]+)° W, ([\d.]+)° N", lon_lat).groups())
    assert (lon, lat) == pytest.approx((3.0 - 1.0 / degree, 5.0 - 1.0 / degree), abs=1e-6)


def test_of_a_place_the_ground_is_told_and_by_what_it_is_impassable(answerer, site):
    def words(asked, *at):
        return ask(answerer, "place", asked, at=at)[0]["words"]

    terms = terrain_terms(site.dem.elevation, 2.0)
    for at in ((0, 31), (31, 0), (31, 31), (95, 119)):
        slope, roughness, step, *_ = terms[:, *at]
        told = f"slope {np.degrees(slope):.1f}°, roughness {roughness:.2g} m"
        assert f"{told}, elevation difference {step:.2g} m" in words(PLAIN, *at)[2]
    _, xy, _ = words(PLAIN, 95, 119)  # no coordinate system, and passable
    assert xy == "x 238, y 190"
    assert words(PLAIN, 45, 66)[2:] == ["its height is unknown", "impassable"]
    *_, refused = words(with_values(PLAIN, body="large-rover", max_tilt_deg=5.0), 62, 75)
    assert "it cannot stand: " in refused and "max_tilt_deg is 5" in refused
    outside, _ = ask(answerer, "place", PLAIN, at=[96, 0])
    assert "must lie on the map" in outside["problem"]


@pytest.mark.parametrize(
    ("values", "within", "steps"),
    [
        (
            {"limits": LIMITS},
            math.inf,
            {f"{n}e{power}" for n in (1, 2, 5) for power in range(-2, 4)},
        ),
        ({"step_cost": "tobler"}, 1e9, {1, 5, 15, 60, 300}),
        ({"step_cost": "tobler"}, 40.0, {1, 5, 15, 60, 300}),
    ],
)
def test_what_can_be_reached_is_told_in_bands_of_a_round_cost_or_time(
    answerer, values, within, steps
):
    asked = with_values(PLAIN, **values)
    limit = {} if math.isinf(within) else {"within": within}
    told, bands = ask(answerer, "reach", asked, pixels=2048, **limit)
    field = answerer.landscape(asked).planner.reach(asked.start, within)
    reached = np.isfinite(field)
    assert told["cells"] == reached.sum() and np.array_equal(bands > 0, reached)
    assert np.array_equal(bands[reached], 1 + np.floor(field[reached] / told["step"]).astype(int))
    assert told["bands"] == bands.max() in range(3, 9) and told["step"] in map(float, steps)
    shut, _ = ask(answerer, "reach", with_values(asked, start=(45, 66)))
    assert "is impassable" in shut["problem"]


def test_how_a_body_stands_is_told_along_its_path(answerer):
    told, _ = ask(answerer, "path", with_values(PLAIN, body="small-rover", max_tilt_deg=40.0))
    for name in ("tilt_deg", "clearance_m", "heading_deg"):
        assert len(told[name]) == len(told["rows"])
    assert 0.0 < max(told["tilt_deg"]) <= 40.0 and told["ok"]


def test_the_path_is_saved_as_it_is_drawn(answerer, site):
    asked = with_values(PLAIN, via=((70, 20),), refine=True)
    told, content = ask(answerer, "file", asked, format="geojson")
    feature = json.loads(content)
    assert told["file"] == "ground-path.geojson" and feature["properties"]["status"] == "OK"
    line = 2.0 * planned(site, asked).line[:, ::-1]
    assert feature["geometry"]["coordinates"] == pytest.approx(line)
    pytest.importorskip("pyogrio")
    assert ask(answerer, "file", asked, format="gpkg")[1].startswith(b"SQLite format 3")
    none, _ = ask(answerer, "file", with_values(asked, goal=(45, 66)), format="geojson")
    assert none == {"problem": "there is no path to save"}


@pytest.mark.parametrize("end", ["start", "goal"])
def test_why_an_end_is_impassable_to_a_point_is_told(answerer, site, end):
    slopes = np.degrees(terrain_terms(site.dem.elevation, 2.0)[0])
    row, col = divmod(int(np.nanargmax(slopes)), slopes.shape[1])
    limits = Traversability(hard_slope_deg=10.0)
    told, _ = ask(answerer, "path", with_values(PLAIN, limits=limits, **{end: (row, col)}))
    why = told["figures"]["reason"]
    assert f"{end} ({row}, {col}) is impassable: height " in why
    assert f"slope {slopes[row, col]:.1f}°" in why


def test_arcs_are_answered_as_they_are_driven_with_the_headings_that_are_asked_for(answerer, site):
    asked = with_values(PLAIN, **SETTINGS["arcs"])
    path, _ = ask(answerer, "path", asked)
    plan = planned(site, asked)
    assert path["gears"] == plan.drive.gears.tolist() and {-1, 1} <= set(path["gears"])
    assert np.stack((path["rows"], path["cols"]), 1) == pytest.approx(plan.line, abs=6e-3)
    nearest_of_sixteen = [270.0, 0.0]
    assert plan.poses[[0, -1], 2] == pytest.approx(nearest_of_sixteen, abs=1e-9)
    assert planned(site, with_values(asked, goal_heading_deg=None)).cost < plan.cost
    assert planned(site, with_values(asked, body="none")).ok, "of a point they count for nothing"


@pytest.mark.parametrize(("pixels", "shape"), [(2000, (96, 120)), (64, (51, 64))])
def test_layers_have_no_more_pixels_than_the_screen(answerer, site, pixels, shape):
    asked = with_values(PLAIN, limits=LIMITS)
    relief, slope, costs = (
        ask(answerer, want, asked, pixels=pixels)[1] for want in ("relief", "slope", "cost")
    )
    assert relief.shape == slope.shape == costs.shape == shape
    middle = (shape[0] * 46 // 96, shape[1] * 66 // 120)
    assert relief[middle] == costs[middle] == answers.UNKNOWN and slope[middle] == 0
    assert (relief[: shape[0] // 3] != answers.UNKNOWN).all() and slope.max() > 20
    cost = Landscape(site, asked).cost
    assert np.array_equal(answers.costs(cost, 2000) == answers.IMPASSABLE, cost >= 1.0)


def test_the_cost_of_ground_where_the_body_stands_in_no_heading_says_the_limit(answerer, site):
    asked = with_values(PLAIN, body="small-rover")
    told, layer = ask(answerer, "cost", asked, pixels=2048)
    refused = answers.refused_on(answerer.landscape(asked).planner)

    def limits_of(layer):
        return (layer >= answers.FIRST_REFUSED) & (layer < answers.IMPASSABLE)

    known = np.isfinite(site.dem.elevation)
    shown = limits_of(layer)
    wanted = (refused > 0) & (layer != answers.IMPASSABLE) & known
    assert np.array_equal(shown, wanted) and shown.any()
    assert (layer[~known] == answers.UNKNOWN).all()
    assert np.array_equal(layer[shown], answers.FIRST_REFUSED - 1 + refused[shown])
    assert told["refused"] == np.unique(refused[refused > 0]).tolist()
    of_point, layer = ask(answerer, "cost", PLAIN, pixels=2048)
    assert of_point["refused"] == [] and not limits_of(layer).any()
    few = answers.costs(flat(4, 4), 2, np.array([[2, 2, 0, 0], [2, 6, 0, 6]] * 2, np.uint8))
    assert few.tolist() == [[answers.FIRST_REFUSED + 1, 0]] * 2
    _, layer = ask(answerer, "cost", with_values(asked, obstacles=((2, 3, 4, 5),)), pixels=2000)
    assert (layer[2:6, 3:8] == answers.IMPASSABLE).all() and layer[1, 2] != answers.IMPASSABLE


def test_first_ends_are_passable_and_where_the_vehicle_stands(site, tmp_path):
    asked = with_values(PLAIN, limits=Traversability(hard_slope_deg=10.0))
    landscape = Landscape(site, asked)
    ends = likely_ends(landscape.cost)
    assert all(map(landscape.planner.is_passable, ends)) and math.hypot(*np.subtract(*ends)) > 60.0
    assert likely_ends(flat(30, 40, np.inf)) is None
    heights = flat(60, 60, np.nan)  # known in the middle; no body stands at the edge of that
    heights[15:45, 10:50] = 0.0
    np.savez(tmp_path / "window.npz", elevation_m=heights, cell_size_m=0.5)
    site = Site.of(read_dem(tmp_path / "window.npz"), tmp_path / "window.npz", {})
    landscape = Landscape(site, with_values(PLAIN, body="large-rover"))
    stands = landscape.planner.is_passable
    ends = likely_ends(landscape.cost, stands)
    bare = likely_ends(landscape.cost)
    assert all(map(stands, ends)) and not any(map(stands, bare))
    assert likely_ends(landscape.cost, lambda cell: False) == bare


def test_whatever_the_map_depends_on_is_asked_of_another_map_and_two_maps_are_kept(site):
    answerer = Answerer(site, PLAIN)
    first = answerer.landscape(EXACT)
    for values in (
        {"omega": 0.05},
        {"step_cost": "tobler"},
        {"corner_cutting": False},
        {"limits": LIMITS},
        {"body": "large-rover"},
    ):
        asked = with_values(EXACT, **values)
        found = answerer.landscape(asked)
        assert found.plan(asked, "astar").cost == planned(site, asked).cost, values
        ends = {"start": (3, 3), "start_heading_deg": 30.0, "goal_heading_deg": 60.0}
        assert answerer.landscape(with_values(asked, **ends, refine=True, method="auto")) is found
        assert answerer.landscape(EXACT) is first
    for omega in (0.04, 0.03):
        answerer.landscape(with_values(EXACT, omega=omega))
    assert answerer.landscape(EXACT) is not first


def test_a_map_too_large_for_memory_is_a_problem(site, monkeypatch):
    def none_left(*words, **more):
        raise MemoryError

    monkeypatch.setattr(answers, "Landscape", none_left)
    Answerer.notice = "compiling"
    told, _ = ask(Answerer(site, PLAIN), "path", PLAIN)
    assert told == {"problem": "not enough memory"}
    assert not Answerer.notice, "nothing is waited for any more"


def test_a_plan_is_drawn():
    matplotlib.use("agg")
    planner = Planner(flat(40, 60, 0.2))
    plan = planner.plan((3, 4), (30, 50), method="corridor", keep_regions=True)
    axes = plan.plot()
    np.testing.assert_array_equal(axes.lines[0].get_xydata()[:, ::-1], plan.path)
    assert plan.plot(axes) is axes and axes.yaxis_inverted()
    assert axes.get_xlabel() == "column", "where no metres are known"
    level = Planner.of_elevation(flat(40, 60, 0.2), 2.0).plan((3, 4), (30, 50)).plot()
    assert level.get_xlabel() == "along a row, m"
    assert level.xaxis.get_major_formatter()(10.0, 0) == "20"
    pyplot.close("all")
