"""`nnpp-edge plan`: what it finds, writes and says, and how it ends when there is nothing
to find.
"""

import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from nnpp_edge.ros.maps import GridMap, MapFrame
from nnpp_edge.runtime import (
    Planner,
    Traversability,
    exercises,
    traversability_cost,
)
from nnpp_edge.runtime.network import loading
from nnpp_edge.runtime.planners import planner
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.terrain import dem as dem_module
from nnpp_edge.terrain.vehicle_files import load_vehicle
from tests.cli.grounds import ENDS, PLACE, rolling, written
from tests.strategies import flat, uniform

EXACT = f"plan hills.npz {ENDS} --method astar"


@pytest.fixture
def split(hills):
    """split.npz is cut in two by a strip of unknown height."""
    hills[:, 45] = np.nan
    np.savez("split.npz", elevation_m=hills, cell_size_m=2.0)


def lines_of(ended):
    """A command's lines by their names."""
    return dict(line.split(maxsplit=1) for line in ended.out.splitlines())


def test_a_path_is_what_the_planner_finds_told_in_a_few_lines_and_in_json(run, told, hills):
    ended = run(EXACT)
    lines = lines_of(ended)
    assert (ended.code, lines["OK"]) == (0, "astar (map)") and "warning" not in ended.err
    assert lines["map"] == "80 × 90 cells of 2 m" and lines["cost"].endswith("the optimum")
    assert {"path", "CC", "expansions", "time"} <= set(lines)
    found = told(EXACT)
    plan = Planner(traversability_cost(hills, 2.0)).plan((5, 5), (70, 80), method="astar")
    assert found["status"] == "OK" and found["loading_included"]
    for name in ("cost", "length", "traverse_cost", "expansions"):
        assert found[name] == pytest.approx(getattr(plan, name))
    assert found["length_m"] == pytest.approx(2.0 * plan.length)
    assert (found["start"], found["goal"]) == ([5, 5], [70, 80])
    assert (found["rows"], found["cols"]) == hills.shape
    found = told(f"{EXACT} --workload limit12 --omega 0.02 --no-corner-cutting")
    cost = traversability_cost(hills, 2.0, Traversability(slope_limit_deg=12, hard_slope_deg=12))
    exact = Planner(cost, corner_cutting=False, omega=0.02)
    plan = exact.plan((5, 5), (70, 80), method="astar")
    assert found["cost"] == pytest.approx(plan.cost)


def test_it_plans_once_unless_asked_to_compare(run, hills, monkeypatch):
    made = []
    monkeypatch.setattr(exercises, "exercise", lambda: None)
    monkeypatch.setattr(planner, "Work", lambda: made.append("a plan") or Work())
    for words, plans, included in (
        ("", 1, True),
        ("--time-limit 9", 1, False),
        ("--compare", 1 + 4 * 2, False),
    ):
        made.clear()
        ended = run(f"{EXACT} -o out {words}")
        assert ended.code == 0 and len(made) == plans
        assert ("loading included" in ended.out) == included
        assert written("out/plan.json")["loading_included"] == included


def test_the_files_hold_the_path_in_map_coordinates(told, hills):
    folder = Path("new/plan")
    found = told("plan hills.tif --start 5,5 --goal 70,80 --method astar -o", folder)
    assert sorted(found["files"]) == sorted(map(str, folder.iterdir()))
    path = Planner(traversability_cost(hills, 2.0)).plan((5, 5), (70, 80), method="astar").path
    feature = written(folder / "path.geojson")
    wanted = [list(PLACE.map_coordinates(*cell)) for cell in path.tolist()]
    assert feature["geometry"] == {"type": "LineString", "coordinates": wanted}
    assert "SVY21" in feature["properties"]["crs"]
    table = np.genfromtxt(folder / "path.csv", delimiter=",", names=True)
    names = "row col x y elevation_m cost distance_m ground_m time_s"
    assert table.dtype.names == tuple(names.split())
    assert np.column_stack((table["row"], table["col"])).tolist() == path.tolist()
    assert np.column_stack((table["x"], table["y"])).tolist() == wanted
    np.testing.assert_allclose(table["elevation_m"], hills[tuple(path.T)], rtol=1e-5)
    assert cv2.imread(str(folder / "plan.png")).shape[0] > 800


def test_steps_that_are_steeper_than_the_limit_of_slope_are_told(run, told):
    for step_m, more in ((0.45, ""), (0.45, "--refine any-angle"), (0.2, "")):
        heights = np.where(np.arange(20) < 10, 0.0, step_m) * np.ones((9, 1))
        np.savez("dem.npz", elevation_m=heights.astype(np.float32), cell_size_m=1.0)
        words = f"plan dem.npz --start 4,16 --goal 4,3 --method astar {more}"
        steep = step_m > 0.4
        steepest = round(math.degrees(math.atan(step_m)), 4) if steep else None
        limited = f"{words} --workload limit20"
        assert told(limited)["steps_above_hard_slope"] == {
            "count": int(steep),
            "steepest_deg": steepest,
        }
        warned = "steps of the path above 20°: 1, the steepest 24.2°. The limit is on the plane"
        err = run(limited).err
        assert (warned in err) == steep and "inf" not in err
        soft = f"{words} --workload soft"
        assert "steps_above_hard_slope" not in told(soft) and "above" not in run(soft).err


def test_what_a_stranger_types_first_says_that_no_path_leads_up_a_cliff(run, told):
    heights = flat(40, 60)
    heights[:, 30:] = 1.5
    np.savez("cliff.npz", elevation_m=heights, cell_size_m=1.0)
    words = "--start 10,5 --goal 10,55"
    ended = run(f"plan cliff.npz {words}")
    assert ended.code == 1 and lines_of(ended)["NO_PATH"]
    assert lines_of(ended)["reached"].endswith("cells steeper than 30° are impassable")
    assert told(f"plan cliff.npz {words} --workload soft")["steepest_up_deg"] > 50.0
    run("plan cliff.npz --start 10,29 --goal 10,3").refused(
        "start (10, 29) is impassable", "slope 36.9°, the hard limit is 30°"
    )


def test_a_single_step_that_is_too_steep_is_named_where_the_plane_is_not(run):
    heights = flat(40, 60)
    heights[:, 30:] = 0.7
    np.savez("kerb.npz", elevation_m=heights, cell_size_m=1.0)
    run("plan kerb.npz --start 10,29 --goal 10,3").refused(
        "start (10, 29) is impassable",
        "steepest single step 35°, the hard limit is 30°; the nearest passable cell",
    )


def test_a_body_that_comes_close_to_a_limit_is_told_so(run):
    heights = flat(60, 60)
    heights += 0.35 * 0.25 * np.arange(60)  # 19.3 degrees
    np.savez("slope.npz", elevation_m=heights, cell_size_m=0.25)
    words = "plan slope.npz --vehicle small-rover --start 30,8 --goal 30,50 --set max_tilt_deg=20"
    ended = run(words)
    assert (
        ended.code == 0 and "warning: the body comes within 3.5 % of one of its limits" in ended.err
    )
    assert "reserve" not in run(f"{words}.1 --set max_tilt_deg=25").err


def test_a_limit_of_the_workload_holds_for_a_body_too(run, told):
    heights = flat(60, 60)
    heights += 0.4 * 0.25 * np.arange(60)  # 21.8 degrees
    np.savez("slope.npz", elevation_m=heights, cell_size_m=0.25)
    words = "plan slope.npz --vehicle small-rover --start 30,8 --goal 30,50"
    assert told(words)["steepest_tilt_deg"] == pytest.approx(21.8, abs=0.1)
    run(f"{words} --workload limit20").refused("max_tilt_deg is 20")


def test_without_a_georeference_coordinates_are_metres_from_the_first_cell(run, told, hills):
    np.savez("dem.npz", elevation_m=rolling(), cell_size_m=2.0, cell_width_m=3.0)
    ended = run(f"plan dem.npz {ENDS} --method astar -o out --json")
    assert "cells of 2 m (north) × 3 m (east): slopes" in ended.err
    feature = written("out/path.geojson")
    line = feature["geometry"]["coordinates"]
    assert (line[0], line[-1], feature["properties"]["crs"]) == ([15.0, 10.0], [240.0, 140.0], None)
    length = sum(math.dist(a, b) for a, b in zip(line, line[1:], strict=False))
    assert ended.json["length_m"] == pytest.approx(length)
    told("plan hills.npz --start 5,5 --goal 5,5 -o out --compare")  # a start that is the goal
    assert written("out/path.geojson")["geometry"] == {
        "type": "Point",
        "coordinates": [10.0, 10.0],
    }


def test_a_blocked_start_says_which_limit_is_passed(run):
    full = "--limit slope_limit_deg=9 --limit roughness_limit_m=0.01 --limit step_limit_m=0.01"
    soft = "--workload soft"
    full += f" {soft}"
    for limits, reason in (
        ("--limit hard_slope_deg=20", "slope 45°, the hard limit is 20°"),
        (full, "all at their limits"),
        (f"{soft} --limit hard_step_m=0.5", "elevation difference"),
        (f"{soft} --limit hard_roughness_m=0.5", "roughness"),
    ):
        heights = flat(50, 50)
        heights[:, 20:] += np.minimum(np.arange(30), 10)
        if "slope 45" not in reason:
            heights[10, 25] += 4.0
        np.savez("dem.npz", elevation_m=heights, cell_size_m=1.0)
        ended = run(f"plan dem.npz --start 10,25 --goal 40,2 --method astar {limits}")
        ended.refused("start (10, 25) is impassable", reason)


def test_a_saved_grid_map_is_planned_on_in_its_metres(told):
    frame = MapFrame(0.5, x=10.0, y=-4.0, rows_along_x=True)
    GridMap({"elevation": flat(40, 30)}, frame).save("map.npz")
    found = told("plan map.npz --start xy:9.6,-4.3 --goal xy:-6.1,-16.2 -o out")
    assert (found["start"], found["goal"]) == ([0, 0], [32, 24])
    line = written("out/path.geojson")["geometry"]["coordinates"]
    assert line[0] == pytest.approx([9.75, -4.25]) and line[-1] == pytest.approx([-6.25, -16.25])


def test_no_path_ends_with_1_in_place_of_the_files_of_an_earlier_plan(run, told, split):
    assert run(f"{EXACT} -o out").code == 0
    ended = run(f"plan split.npz {ENDS} --method astar -o out")
    assert ended.code == 1 and ended.out.startswith("NO_PATH") and ended.err == ""
    found = written("out/plan.json")
    assert (found["status"], found["cost"], found["length_m"]) == ("NO_PATH", None, None)
    assert written("out/path.geojson")["geometry"] is None
    assert Path("out/path.csv").read_text().count("\n") == 1
    found = told(f"plan split.npz {ENDS} --method corridor --compare", code=1)
    assert (found["status"], found["source"]) == ("NO_PATH", "fallback")
    assert [row["gap"] for row in found["compare"]] == [None, None]


def test_a_timeout_ends_with_1_and_gives_the_path_so_far(run, monkeypatch):
    monkeypatch.setattr(exercises, "exercise", lambda: None)  # eight seconds of loading kernels
    heights = uniform(1, (600, 600), 0, 0.4)
    np.savez("large.npz", elevation_m=heights, cell_size_m=1.0)
    ended = run("plan large.npz --start 5,5 --goal 590,590 --method astar --time-limit 1e-9 -o out")
    assert ended.code == 1 and ended.out.startswith("TIMEOUT") and "so far" in ended.out
    feature = written("out/path.geojson")
    assert (
        feature["properties"]["status"] == "TIMEOUT"
        and len(feature["geometry"]["coordinates"]) > 10
    )


def test_comparing_sets_the_methods_beside_the_optimum(run, told, hills, tiny_model):
    unused = run(f"plan hills.npz {ENDS} --model {tiny_model}")
    assert f"warning: --model {tiny_model} was not used, as the path is by corridor: " in unused.err
    words = f"plan hills.npz {ENDS} --method nnpp --model {tiny_model} --compare"
    rows = {row["method"]: row for row in told(f"{words} -o out")["compare"]}
    assert list(rows) == ["nnpp", "astar", "corridor"]
    assert rows["astar"]["gap"] == 0.0 and rows["astar"]["speedup"] == 1.0
    for row in rows.values():
        assert row["gap"] == pytest.approx(row["cost"] / rows["astar"]["cost"] - 1.0, abs=1e-6)
        assert row["speedup"] == pytest.approx(rows["astar"]["time_ms"] / row["time_ms"])
    shown = run(words).out
    assert "speed-up" in shown and "the optimum" in shown and Path("out/plan.png").exists()


def test_auto_says_what_it_picked_and_epsilon_0_is_the_optimum(told, hills):
    found = told("plan hills.npz --start 5,5 --goal 20,20")
    assert found["method"] == "astar" and found["choice"] and not found["reason"]
    found = told(f"plan hills.npz {ENDS} --method corridor --epsilon 0")
    assert (found["method"], found["bound"]) == ("corridor", 1.0)
    assert abs(found["cost"] - told(EXACT)["cost"]) < 1e-4


def test_the_network_is_loaded_where_it_will_be_asked_once_the_ends_are_on_the_map(
    run, hills, monkeypatch
):
    done = []

    def noted(name, function):
        return lambda *words, **more: done.append(name) or function(*words, **more)

    monkeypatch.setattr(loading, "begin_loading", noted("loading begins", loading.begin_loading))
    monkeypatch.setattr(dem_module, "read_dem", noted("the map is read", dem_module.read_dem))
    for method in ("astar", "corridor", "auto", "nnpp"):
        done.clear()
        assert run(f"plan hills.npz {ENDS} --method {method}").code == 0
        assert done == ["the map is read"] + (["loading begins"] if method == "nnpp" else [])
        run(f"plan hills.npz --start 5,5 --goal 5,900 --method {method}").refused(
            "lies outside the map"
        )
        assert done[-1] == "the map is read"


def test_who_gave_a_wrong_place_does_not_wait(run, hills, monkeypatch):
    def never(*_, **__):
        raise AssertionError("not to be called")

    monkeypatch.setattr(exercises, "exercise", never)
    ended = run("plan hills.npz --start 40,86 --goal 70,80 --time-limit 1")
    ended.refused("start (40, 86) is impassable")
    monkeypatch.setattr("nnpp_edge.runtime.map.ground.Ground.costs", never)
    for limit in ("", "--time-limit 1"):
        for start, goal, words in (
            ("5,5", "5,900", "goal (5, 900)"),
            ("-1,5", "70,80", "start (-1, 5)"),
        ):
            ended = run(f"plan hills.npz --start {start} --goal {goal} {limit}")
            ended.refused(f"{words} lies outside the map of 80 × 90 cells")
    monkeypatch.setattr(dem_module, "read_dem", never)
    for words, module in (
        (f"{EXACT} --gpkg", "pyogrio"),
        ("reach hills.npz --start 5,5 --within-cost 9", "rasterio"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        run(f"{words} -o out").refused(f"{module}: pip install")
    assert not Path("out").exists()


def test_without_matplotlib_all_but_the_picture_is_written(run, hills, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for words, picture, beside in (
        (f"{EXACT} -o out", "out/plan.png", "out/plan.json"),
        ("reach hills.tif --start 5,5 --within-cost 9 -o area", "area/reach.png", "area/reach.tif"),
        ("costmap hills.npz -o cost.npy", "cost.png", "cost.npy"),
    ):
        ended = run(words)
        assert ended.code == 0 and Path(beside).exists() and not Path(picture).exists()
        warned = f"warning: no picture is drawn: {Path(picture).name} needs matplotlib: pip install"
        assert warned in ended.err and picture not in ended.out
    run("simulate --picture drive.png").refused("--picture needs matplotlib: pip install")


def test_what_is_likely_is_said_where_more_is_not_proven(run, hills):
    words = f"plan hills.npz {ENDS} --method corridor"
    assert "likely within 2 % of the optimum, proven to be at most" in run(words).out
    proven = run(f"{words} --epsilon 0.01").out
    assert "likely" not in proven and ("proven" in proven or "the optimum" in proven)
    body = Planner.of_elevation(hills, 2.0, vehicle=load_vehicle("large-rover"), warn=False)
    for _ in range(2):  # its poses are checked once
        found = body.plan((5, 5), (70, 80), method="corridor")
        assert "likely within 4 % of the optimum" in str(found)
