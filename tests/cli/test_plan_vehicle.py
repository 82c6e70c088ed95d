"""`nnpp-edge plan`, `run` and `evaluate` with a vehicle: what is written, and what is refused in one line."""

import csv
import json

import cv2
import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Vehicle, pose_costs
from nnpp_edge.terrain.dem import Dem, Georeference, write_raster
from nnpp_edge.viz.picture import BODY, POINT

CELL_M = 0.25
GOOD = "length_m = 1.0\nwidth_m = 0.8\nclearance_m = 0.3\n"
OWN = Vehicle(1.0, 0.8, 0.3)
ENDS = ("--start", "10,10", "--goal", "45,48")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a map of 60 × 60 cells, as arrays and as a raster, a hill on it, a wall, and costs."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    heights = (0.02 * rng.random((60, 60))).astype(np.float32)
    heights[18:30, 20:30] += np.arange(12, dtype=np.float32)[:, None] * np.float32(0.4)
    np.savez("hill.npz", elevation_m=heights, cell_size_m=CELL_M)
    frame = Georeference("EPSG:32615", (CELL_M, 0.0, 0.0, 0.0, -CELL_M, 0.0))
    write_raster("hill.tif", heights, Dem(heights, CELL_M, CELL_M, frame, tmp_path))
    walled = heights.copy()
    walled[:, 30:32] = 5.0
    np.savez("wall.npz", elevation_m=walled, cell_size_m=CELL_M)
    np.savez("cost.npz", cost=np.full((60, 60), 0.2, np.float32), cell_size_m=CELL_M)
    return tmp_path


def test_every_waypoint_has_its_heading_and_how_the_body_stands(nnpp_edge, place):
    (place / "own.toml").write_text(GOOD)
    ended = nnpp_edge("plan", "hill.npz", *ENDS, "--vehicle", "own.toml", "--method", "astar", "-o", "out")
    assert (ended.code, ended.err) == (0, "")
    heights = np.load("hill.npz")["elevation_m"]
    plan = Planner.of_elevation(heights, CELL_M, vehicle=OWN).plan((10, 10), (45, 48), method="astar")
    told = json.loads((place / "out" / "plan.json").read_text())
    assert told["cost"] == pytest.approx(plan.cost, rel=1e-5)
    assert told["waypoints"]["heading_deg"] == plan.headings_deg.tolist()
    with (place / "out" / "path.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["heading_deg"]) for row in rows] == plan.headings_deg.tolist()
    assert all(float(row["tilt_deg"]) <= 25.0 and 0.0 < float(row["clearance_m"]) <= 0.3 for row in rows)
    costs = pose_costs(heights, CELL_M, OWN)
    assert np.isfinite(costs[:, *plan.path.T]).any(0).all()
    assert set(told["waypoints"]) <= set(json.loads((place / "out" / "path.geojson").read_text())["properties"])


def test_the_picture_has_the_body_and_with_a_comparison_a_points_path(nnpp_edge, place):
    pictures = []
    for more in ((), ("--vehicle", "small-rover"), ("--vehicle", "small-rover", "--compare")):
        assert nnpp_edge("plan", "hill.npz", *ENDS, *more, "--method", "astar", "-o", "out").code == 0
        picture = cv2.imread(str(place / "out" / "plan.png"))
        pictures.append([int((picture == colour).all(2).sum()) for colour in (BODY, POINT)])
    (no_body, few), (body, as_few), (as_much, point) = pictures
    assert no_body == 0 and body == as_much > 100
    assert few == as_few < 50 and point > few + 100


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "length_m is missing"),
        (GOOD + "wheels = 6\n", "wheels is unknown: wanted one of length_m"),
        ("[vehicle]\n" + GOOD, "vehicle is unknown"),
        (GOOD.replace("1.0", '"long"'), "length_m: Expected `float`, got `str`"),
        (GOOD.replace("1.0", "true"), "length_m: Expected `float`, got `bool`"),
        (GOOD.replace("1.0", "nan"), "length_m must be a positive number of metres, got nan"),
        (GOOD + "axles = 2.5\n", "axles: Expected `int`, got `float`"),
        (GOOD + "max_pitch_deg = 'steep'\n", "max_pitch_deg: Expected `float | null`, got `str`"),
        (GOOD + "unknown_passes = 1\n", "unknown_passes: Expected `bool`, got `int`"),
        (GOOD.replace("0.3", "-0.3"), "clearance_m must be a positive number of metres, got -0.3"),
        (GOOD + "max_tilt_deg = 90\n", "max_tilt_deg must lie in (0, 90) degrees, got 90"),
        (GOOD + "max_roll_deg = 90.0\n", "max_roll_deg must lie in (0, 90) degrees, got 90"),
        (GOOD + "wheelbase_m = 1.2\n", "the wheels must lie under the body: wheelbase_m"),
        (GOOD + "wheel_width_m = 0.9\n", "the wheels must lie under the body: track_m"),
        (GOOD + "radius_m = 1.0\n", "wanted no other values beside radius_m"),
        (GOOD.replace("1.0", "20.0"), "wanted a map that the vehicle fits on, 20 × 0.8 m, got one of 15 × 15 m"),
        ("length_m =", "wanted a vehicle in TOML"),
        ("\x00", "wanted a vehicle in TOML"),
    ],
)
@pytest.mark.parametrize("command", ["plan", "run", "evaluate"])
def test_a_vehicle_that_is_none_ends_in_one_line(nnpp_edge, place, command, text, words):
    (place / "own.toml").write_text(text)
    before = sorted(place.rglob("*.*"))
    given = {
        "plan": ("hill.npz", *ENDS, "-o", "out"),
        "run": ("--map", "hill.npz", "--ticks", "1", "--log", "log.mcap"),
        "evaluate": ("--terrain", "hill.npz", "--workload", "body", "--sizes", "60", "--queries", "1"),
    }
    nnpp_edge(command, *given[command], "--vehicle", "own.toml").refused(words)
    assert sorted(place.rglob("*.*")) == before


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--vehicle", "none.toml"), "got 'none.toml' (no such file)"),
        (("--vehicle", "."), "(a folder)"),
        (("--vehicle", "small-rover", "--set", "clearance_m=-1"), "small-rover: clearance_m must be a positive"),
        (
            ("--vehicle", "small-rover", "--set", "clearance=1"),
            "clearance is unknown: wanted one of length_m",
        ),
        (("--vehicle", "small-rover", "--set", "max_tilt_deg=90"), "max_tilt_deg must lie in (0, 90)"),
        (("--vehicle", "small-rover", "--set", "track_m=5"), "under the body"),
        (("--vehicle", "small-rover", "--set", "radius_m=1"), "a vehicle with a radius is a disc"),
        (("--set", "clearance_m=0.3"), "length_m is missing"),
        (("--set", "length_m=50", "--set", "width_m=2", "--set", "clearance_m=1"), "a map that the vehicle fits on"),
        (("--set", "radius_m=50"), "the map's edge lies within the vehicle's radius"),
        (("--vehicle", "small-rover", "--method", "nnpp", "--model", "none.onnx"), "none.onnx"),
        (("--rocks", "0.1"), "no such option '--rocks'"),
        (("--vehicle", "small-rover", "--workload", "body"), "is a vehicle's"),
        (("--workload", "body-rocks30"), "0 to 20 percent"),
        (("--vehicle", "small-rover", "--start", "24,25"), "the nearest cell where it does is ("),
        (
            ("--vehicle", "small-rover", "--goal", "24,25"),
            "goal (24, 25) is impassable: the vehicle stands there in no",
        ),
        (
            ("--vehicle", "small-rover", "--start", "0,0"),
            "start (0, 0) is impassable: the vehicle stands there in no",
        ),
        (("--vehicle", "small-rover", "--start", "60,0"), "lies outside the map"),
    ],
)
def test_options_that_make_no_sense_end_in_one_line(nnpp_edge, place, given, words):
    ends = {name: at for name, at in zip(ENDS[::2], ENDS[1::2], strict=True) if name not in given}
    told = [word for end in ends.items() for word in end]
    nnpp_edge("plan", "hill.npz", *told, *given, "-o", "out").refused(words)
    assert not list(place.glob("out/*"))


@pytest.mark.parametrize("given", [("--vehicle", "small-rover"), ("--set", "radius_m=0.5")])
def test_a_vehicle_needs_the_map_in_memory(nnpp_edge, place, given):
    nnpp_edge("plan", "hill.tif", *ENDS, *given, "--memory", "1kB", "-o", "out").refused("in memory alone")
    assert not list(place.glob("out/*"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("plan", "cost.npz", *ENDS, "-o", "out"), "wanted heights, got costs"),
        (("run", "--map", "cost.npz", "--ticks", "1"), "holds costs: a vehicle stands on elevations"),
        (("evaluate", "--dataset", "data", "--workload", "body"), "a data set holds cost maps"),
    ],
)
def test_a_vehicle_stands_on_elevations_alone(nnpp_edge, place, words, told):
    nnpp_edge(*words, "--vehicle", "small-rover").refused(told)
    assert not list(place.glob("out/*"))


def test_nnpp_says_that_no_network_is_asked_for_a_body(nnpp_edge, place):
    ended = nnpp_edge("plan", "hill.npz", *ENDS, "--vehicle", "small-rover", "--method", "nnpp", "--json")
    told = json.loads(ended.out)
    assert (ended.code, ended.err, told["method"]) == (0, "", "nnpp")
    assert "no network is asked for a vehicle's body" in told["choice"]


def test_no_path_for_the_body_is_an_outcome(nnpp_edge, place):
    words = ("plan", "wall.npz", *ENDS, "--vehicle", "small-rover")
    ended = nnpp_edge(*words, "--json")
    told = json.loads(ended.out)
    assert (ended.code, told["status"]) == (1, "NO_PATH")
    reached = told["reached_cells"]
    assert 0 < reached < told["rows"] * told["cols"]
    assert f"reached     {reached} cells of the map, from the start" in nnpp_edge(*words).out


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--rocks", "-0.1"), "--rocks"),
        (("--rocks", "0.3"), "--rocks"),
        (("--workload", "body"), "--workload body needs a vehicle"),
        (("--workload", "body-rocks10"), "--workload body-rocks10 needs a vehicle"),
        (("--vehicle", "small-rover"), "for the workloads body and body-rocksN"),
        (("--vehicle", "small-rover", "--workload", "body-rocks-1"), "0 to 20 percent"),
        (("--set", "radius_m=1", "--workload", "body"), "a disc has no poses"),
    ],
)
def test_evaluate_refuses_a_vehicle_or_rocks_that_make_no_sense(nnpp_edge, place, given, words):
    ended = nnpp_edge(
        "evaluate", "--terrain", "hill.npz", "--sizes", "60", "--queries", "1", *given, "--plot", "a.png"
    )
    ended.refused(words)
    assert not (place / "a.png").exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--profile", "quick", "--vehicle", "small-rover"), "vehicle: wanted none without the workload body"),
        (("--profile", "rover", "--vehicle", "none.toml"), "got 'none.toml' (no such file)"),
        (("--peers", "--vehicle", "small-rover"), "--vehicle does not go with --peers"),
    ],
)
def test_profile_refuses_a_vehicle_that_makes_no_sense(nnpp_edge, place, given, words):
    nnpp_edge("profile", *given, *(() if "--peers" in given else ("-o", "out"))).refused(words)
    assert not list(place.glob("out/*"))
