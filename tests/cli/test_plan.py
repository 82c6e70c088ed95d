"""`nnpp-edge plan`: what it finds, writes and says, and how it ends when there is nothing to find."""

import csv
import json
import math
import shutil

import cv2
import numpy as np
import pytest

from nnpp_edge.ros.maps import GridMap, MapFrame
from nnpp_edge.runtime import plan_path, traversability_cost
from nnpp_edge.runtime.network import loading
from nnpp_edge.terrain import dem as dem_module
from nnpp_edge.terrain.dem import Dem, Georeference, write_raster
from tests.cli.grounds import ENDS, rolling

PLACE = Georeference("EPSG:32615", (2.0, 0.0, 400_000.0, 0.0, -2.0, 5_000_000.0))


@pytest.fixture
def hills(tmp_path):
    """Rolling ground without a georeference; cells of 2 m, and one unknown."""
    heights = rolling()
    heights[40, 40] = np.nan
    np.savez(tmp_path / "hills.npz", elevation_m=heights, cell_size_m=2.0)
    return tmp_path / "hills.npz"


@pytest.fixture
def split(tmp_path):
    """Ground cut in two by a strip of unknown height."""
    heights = rolling()
    heights[:, 45] = np.nan
    np.savez(tmp_path / "split.npz", elevation_m=heights, cell_size_m=2.0)
    return tmp_path / "split.npz"


EXACT = (*ENDS, "--method", "astar")


def test_a_path_is_found_and_told_in_a_few_lines(nnpp_edge, hills):
    ended = nnpp_edge("plan", hills, *EXACT)
    assert (ended.code, ended.err) == (0, "")
    lines = dict(line.split(maxsplit=1) for line in ended.out.splitlines())
    assert lines["OK"] == "astar (map)"
    assert lines["map"] == "80 × 90 cells of 2 m"
    assert lines["cost"].endswith("the optimum")
    assert {"path", "CC", "expansions", "time"} <= set(lines)


def test_json_holds_what_the_planner_answers(nnpp_edge, hills):
    told = json.loads(nnpp_edge("plan", hills, *EXACT, "--json").out)
    heights = np.load(hills)["elevation_m"]
    plan = plan_path(traversability_cost(heights, 2.0), (5, 5), (70, 80), method="astar")
    assert told["status"] == "OK"
    for name in ("cost", "length", "traverse_cost", "expansions"):
        assert told[name] == pytest.approx(getattr(plan, name))
    assert told["length_m"] == pytest.approx(2.0 * plan.length)
    assert (told["start"], told["goal"], told["rows"], told["cols"]) == ([5, 5], [70, 80], 80, 90)
    assert told["loading_included"]


@pytest.mark.parametrize(
    ("words", "plans", "loading"),
    [((), 1, True), (("--time-limit", "9"), 1, False), (("--compare",), 1 + 4 * 2, False)],
)
def test_it_plans_once_unless_asked_to_compare(nnpp_edge, hills, tmp_path, monkeypatch, words, plans, loading):
    from nnpp_edge.runtime import exercises
    from nnpp_edge.runtime.planners import planner
    from nnpp_edge.runtime.planners.query import Work

    made = []
    monkeypatch.setattr(exercises, "exercise", lambda: None)
    monkeypatch.setattr(planner, "Work", lambda: made.append("a plan") or Work())
    ended = nnpp_edge("plan", hills, *EXACT, *words, "-o", tmp_path / "out")
    assert ended.code == 0 and len(made) == plans
    assert ("loading included" in ended.out) == loading
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["loading_included"] == loading


def test_options_reach_the_planner(nnpp_edge, hills):
    limits = ("--workload", "limit12", "--omega", "0.02", "--no-corner-cutting")
    told = json.loads(nnpp_edge("plan", hills, *EXACT, *limits, "--json").out)
    from nnpp_edge.runtime import Traversability

    heights = np.load(hills)["elevation_m"]
    cost = traversability_cost(heights, 2.0, Traversability(slope_limit_deg=12, hard_slope_deg=12))
    plan = plan_path(cost, (5, 5), (70, 80), method="astar", corner_cutting=False, omega=0.02)
    assert told["cost"] == pytest.approx(plan.cost)


def test_the_files_hold_the_path_in_map_coordinates(nnpp_edge, tmp_path):
    heights = rolling()
    write_raster(tmp_path / "dem.tif", heights, Dem(heights, 2.0, 2.0, PLACE, tmp_path))
    folder = tmp_path / "new" / "plan"
    ended = nnpp_edge("plan", tmp_path / "dem.tif", *EXACT, "-o", folder, "--json", "--hillshade")
    assert ended.code == 0
    told = json.loads(ended.out)
    assert told == json.loads((folder / "plan.json").read_text())
    assert sorted(told["files"]) == sorted(map(str, folder.iterdir()))
    cost = traversability_cost(heights, 2.0)
    path = plan_path(cost, (5, 5), (70, 80), method="astar").path
    feature = json.loads((folder / "path.geojson").read_text())
    wanted = [[400_000 + 2 * (col + 0.5), 5_000_000 - 2 * (row + 0.5)] for row, col in path.tolist()]
    assert feature["geometry"] == {"type": "LineString", "coordinates": wanted}
    assert "UTM" in feature["properties"]["crs"]
    assert feature["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::32615"
    rows = list(csv.DictReader((folder / "path.csv").read_text().splitlines()))
    names = ["row", "col", "x", "y", "elevation_m", "cost", "distance_m", "ground_m", "time_s"]
    assert list(rows[0]) == names
    assert [[int(row["row"]), int(row["col"])] for row in rows] == path.tolist()
    assert [[float(row["x"]), float(row["y"])] for row in rows] == wanted
    assert [float(row["elevation_m"]) for row in rows] == pytest.approx(heights[tuple(path.T)].tolist(), rel=1e-5)
    assert float(rows[0]["distance_m"]) == 0.0
    assert float(rows[-1]["distance_m"]) == pytest.approx(told["length_m"])
    assert cv2.imread(str(folder / "plan.png")).shape[0] > 800


@pytest.mark.parametrize(
    ("step_m", "more", "told"),
    [
        (0.45, (), {"count": 1, "steepest_deg": round(math.degrees(math.atan(0.45)), 4)}),
        (0.45, ("--refine", "any-angle"), {"count": 1, "steepest_deg": round(math.degrees(math.atan(0.45)), 4)}),
        (0.2, (), {"count": 0, "steepest_deg": None}),
    ],
)
def test_steps_that_are_steeper_than_the_limit_of_slope_are_told(nnpp_edge, tmp_path, step_m, more, told):
    heights = np.where(np.arange(20) < 10, 0.0, step_m) * np.ones((9, 1))
    np.savez(tmp_path / "dem.npz", elevation_m=heights.astype(np.float32), cell_size_m=1.0)
    words = ("plan", tmp_path / "dem.npz", "--start", "4,16", "--goal", "4,3", "--method", "astar", "--json", *more)
    ended = nnpp_edge(*words, "--workload", "limit20")
    assert json.loads(ended.out)["steps_above_hard_slope"] == told
    warned = "steps of the path above 20°: 1, the steepest 24.2°. The limit is on the plane"
    assert (warned in ended.err) == bool(told["count"]) and "inf" not in ended.err
    unlimited = nnpp_edge(*words)
    assert "steps_above_hard_slope" not in json.loads(unlimited.out) and "above" not in unlimited.err


def test_without_a_georeference_coordinates_are_metres_from_the_first_cell(nnpp_edge, tmp_path):
    np.savez(tmp_path / "dem.npz", elevation_m=rolling(), cell_size_m=2.0, cell_width_m=3.0)
    ended = nnpp_edge("plan", tmp_path / "dem.npz", *EXACT, "-o", tmp_path / "out", "--json")
    assert ended.err.startswith("warning: cells are 2 m from north to south and 3 m")
    feature = json.loads((tmp_path / "out" / "path.geojson").read_text())
    line = feature["geometry"]["coordinates"]
    assert (line[0], line[-1]) == ([15.0, 10.0], [240.0, 140.0])
    assert feature["properties"]["crs"] is None
    length = sum(math.dist(a, b) for a, b in zip(line, line[1:], strict=False))
    assert json.loads(ended.out)["length_m"] == pytest.approx(length)


def test_a_blocked_start_says_which_limit_is_passed(nnpp_edge, tmp_path):
    full = ("slope_limit_deg=9", "roughness_limit_m=0.01", "step_limit_m=0.01")
    for limits, reason in (
        (("hard_slope_deg=20",), "slope 45°, the hard limit is 20°"),
        (full, "all at their limits"),
        (("hard_step_m=0.5",), "elevation difference"),
        (("hard_roughness_m=0.5",), "roughness"),
    ):
        heights = np.zeros((50, 50), np.float32)
        heights[:, 20:] += np.minimum(np.arange(30), 10)
        if "slope 45" not in reason:
            heights[10, 25] += 4.0
        np.savez(tmp_path / "dem.npz", elevation_m=heights, cell_size_m=1.0)
        words = ["--start", "10,25", "--goal", "40,2", "--method", "astar"]
        words += [word for limit in limits for word in ("--limit", limit)]
        nnpp_edge("plan", tmp_path / "dem.npz", *words).refused("start (10, 25) is impassable", reason)


def test_a_saved_grid_map_is_planned_on_in_its_metres(nnpp_edge, tmp_path):
    frame = MapFrame(0.5, x=10.0, y=-4.0, rows_along_x=True)
    GridMap({"elevation": np.zeros((40, 30), np.float32)}, frame).save(tmp_path / "map.npz")
    words = ("--start", "xy:9.6,-4.3", "--goal", "xy:-6.1,-16.2", "-o", tmp_path / "out")
    assert nnpp_edge("plan", tmp_path / "map.npz", *words).code == 0
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert (told["start"], told["goal"]) == ([0, 0], [32, 24])
    line = json.loads((tmp_path / "out" / "path.geojson").read_text())["geometry"]["coordinates"]
    assert line[0] == pytest.approx([9.75, -4.25]) and line[-1] == pytest.approx([-6.25, -16.25])


def test_no_path_ends_with_1_and_leaves_no_old_path_behind(nnpp_edge, hills, split, tmp_path):
    assert nnpp_edge("plan", hills, *EXACT, "-o", tmp_path / "out").code == 0
    ended = nnpp_edge("plan", split, *EXACT, "-o", tmp_path / "out")
    assert ended.code == 1 and ended.out.startswith("NO_PATH") and ended.err == ""
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert (told["status"], told["cost"], told["length_m"]) == ("NO_PATH", None, None)
    assert json.loads((tmp_path / "out" / "path.geojson").read_text())["geometry"] is None
    assert (tmp_path / "out" / "path.csv").read_text().count("\n") == 1
    ended = nnpp_edge("plan", split, *ENDS, "--method", "corridor", "--json", "--compare")
    assert ended.code == 1
    told = json.loads(ended.out)
    assert told["status"] == "NO_PATH" and told["source"] == "fallback"
    assert [row["gap"] for row in told["compare"]] == [None, None]


def test_a_timeout_ends_with_1_and_gives_the_path_so_far(nnpp_edge, tmp_path, monkeypatch):
    from nnpp_edge.runtime import exercises

    monkeypatch.setattr(exercises, "exercise", lambda: None)  # eight seconds of loading kernels
    heights = np.random.default_rng(1).uniform(0, 0.4, (600, 600)).astype(np.float32)
    np.savez(tmp_path / "large.npz", elevation_m=heights, cell_size_m=1.0)
    words = ("--start", "5,5", "--goal", "590,590", "--method", "astar", "--time-limit", "1e-9")
    ended = nnpp_edge("plan", tmp_path / "large.npz", *words, "-o", tmp_path / "out")
    assert ended.code == 1 and ended.out.startswith("TIMEOUT") and "so far" in ended.out
    feature = json.loads((tmp_path / "out" / "path.geojson").read_text())
    assert feature["properties"]["status"] == "TIMEOUT" and len(feature["geometry"]["coordinates"]) > 10


def test_a_start_that_is_the_goal_is_a_path_of_one_cell(nnpp_edge, hills, tmp_path):
    ended = nnpp_edge("plan", hills, "--start", "5,5", "--goal", "5,5", "-o", tmp_path / "out", "--compare")
    assert ended.code == 0
    feature = json.loads((tmp_path / "out" / "path.geojson").read_text())
    assert feature["geometry"] == {"type": "Point", "coordinates": [10.0, 10.0]}


def test_comparing_sets_the_methods_beside_the_optimum(nnpp_edge, hills, tiny_model, tmp_path):
    words = ("plan", hills, *ENDS, "--method", "nnpp", "--model", tiny_model, "--compare")
    told = json.loads(nnpp_edge(*words, "--json", "-o", tmp_path / "out").out)
    rows = {row["method"]: row for row in told["compare"]}
    assert list(rows) == ["nnpp", "astar", "corridor"]
    assert rows["astar"]["gap"] == 0.0 and rows["astar"]["speedup"] == 1.0
    for row in rows.values():
        assert row["gap"] == pytest.approx(row["cost"] / rows["astar"]["cost"] - 1.0, abs=1e-6)
        assert row["speedup"] == pytest.approx(rows["astar"]["time_ms"] / row["time_ms"])
    shown = nnpp_edge(*words).out
    assert "speed-up" in shown and "the optimum" in shown
    assert (tmp_path / "out" / "plan.png").exists()


def test_auto_says_what_it_picked(nnpp_edge, hills):
    told = json.loads(nnpp_edge("plan", hills, "--start", "5,5", "--goal", "20,20", "--json").out)
    assert told["method"] == "astar" and told["choice"] and not told["reason"]


def test_a_bad_elevation_map_is_one_line(nnpp_edge, bad_dem):
    path, word = bad_dem
    ended = nnpp_edge("plan", path, *EXACT)
    ended.refused(word)
    assert ended.out == ""


def test_a_model_that_cannot_be_used_is_one_line(nnpp_edge, hills, tiny_model, make_tiny_model, tmp_path):
    words = ("plan", hills, *ENDS, "--method", "nnpp", "--model")
    whole = tiny_model.read_bytes()
    for content in (whole[:-200], whole[:-40], b""):
        (tmp_path / "cut.onnx").write_bytes(content)
        nnpp_edge(*words, tmp_path / "cut.onnx").refused("cut.onnx")
    for changes in ({"input_size": 128}, {"blocks": 16}, {"encoding": "ends"}, {"format": "2"}, {"sigma": -1.0}):
        nnpp_edge(*words, make_tiny_model(**changes)).refused("changed.onnx: ", "wanted")


def test_with_epsilon_0_the_corridor_finds_the_optimum(nnpp_edge, hills):
    exact = json.loads(nnpp_edge("plan", hills, *EXACT, "--json").out)
    words = [word if word != "astar" else "corridor" for word in EXACT]
    told = json.loads(nnpp_edge("plan", hills, *words, "--epsilon", "0", "--json").out)
    assert told["method"] == "corridor"
    assert told["bound"] == 1.0
    assert abs(told["cost"] - exact["cost"]) < 1e-4


def test_of_several_goals_the_nearest_is_gone_to(nnpp_edge, hills, split):
    goals = ("--goal", "70,80", "--goal", "20,20", "--goal", "10,60")
    told = json.loads(nnpp_edge("plan", hills, "--start", "5,5", *goals, "--method", "astar", "--json").out)
    assert told["goal"] == [20, 20]
    assert [row["goal"] for row in told["goals"]] == [[20, 20], [10, 60], [70, 80]]
    assert told["goals"][0]["cost"] == pytest.approx(told["cost"])
    ended = nnpp_edge("plan", split, "--start", "5,5", "--goal", "70,80", "--goal", "20,20", "--method", "astar")
    assert ended.code == 0
    assert "goals       (20, 20) " in ended.out
    assert "(70, 80) NO_PATH" in ended.out


def test_the_network_is_loaded_where_it_will_be_asked_once_the_ends_are_on_the_map(nnpp_edge, hills, monkeypatch):
    done = []

    def noted(name, function):
        return lambda *words, **more: done.append(name) or function(*words, **more)

    monkeypatch.setattr(loading, "begin_loading", noted("loading begins", loading.begin_loading))
    monkeypatch.setattr(dem_module, "read_dem", noted("the map is read", dem_module.read_dem))
    for method in ("astar", "corridor", "auto", "nnpp"):
        done.clear()
        assert nnpp_edge("plan", hills, *ENDS, "--method", method).code == 0
        assert done == ["the map is read"] + (["loading begins"] if method == "nnpp" else [])
        outside = ("--start", "5,5", "--goal", "5,900", "--method", method)
        nnpp_edge("plan", hills, *outside).refused("lies outside the map")
        assert done[-1] == "the map is read"


def test_the_time_shown_tells_waiting_for_the_network_apart(nnpp_edge, hills, tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(loading, "begin_loading", lambda model: None)
    words = "plan", hills, *ENDS, "--method", "nnpp", "--model", shutil.copy(tiny_model, tmp_path / "slow.onnx")
    times = [json.loads(nnpp_edge(*words, "--json").out)["timings_ms"] for _ in range(2)]
    assert 0.0 < times[0]["load"] < times[0]["total"]
    assert "load" not in times[1]
