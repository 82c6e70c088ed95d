"""`nnpp-edge plan`: numbers along the way, places between, ends of all kinds, formats, vehicles,
lines.
"""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio
import pytest
from pyproj import Transformer

from nnpp_edge.cli import planning
from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.arrays import curvatures
from nnpp_edge.runtime.map.along import Numbers
from nnpp_edge.runtime.robots.body.primitives import sharpest_m
from nnpp_edge.terrain.facts import duration, work
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from nnpp_edge.viz.picture import plan_picture
from tests.cli.grounds import BODY, ENDS, GRID, PLACE, with_a_hill, written

PLAN = f"plan hills.tif {ENDS}"
MINE = "length_m = 2.2\nwidth_m = 1.6\nclearance_m = 0.4\nmax_step_m = 0.3\n"


def rows_of(path):
    return list(csv.DictReader(Path(path).read_text().splitlines()))


@pytest.fixture
def hill(run):
    """hill.npz has a hill, wall.npz a wall too."""
    heights = with_a_hill()
    np.savez("hill.npz", elevation_m=heights, cell_size_m=0.25)
    heights[:, 30:32] = 5.0
    np.savez("wall.npz", elevation_m=heights, cell_size_m=0.25)


@pytest.mark.parametrize("body", ["", BODY])
def test_all_outputs_say_the_same_numbers(run, told, hills, body):
    words = f"{PLAN} {body} -o out --gpkg"
    found = told(words)
    made = {}
    if body:
        rover = replace(load_vehicle("large-rover"), max_tilt_deg=40.0, clearance_m=1.5)
        made = {
            "vehicle": rover,
            "mobility": load_mobility("large-rover", gravity_m_s2=9.80665),
        }
    plan = Planner.of_elevation(hills, 2.0, warn=False, **made).plan((5, 5), (70, 80))
    numbers = {name: found[name] for name in Numbers._fields}
    known = [math.nan if value is None else value for value in numbers.values()]
    assert known == pytest.approx(plan.numbers, rel=1e-4, abs=1e-4, nan_ok=True)

    # as JSON, as properties, as fields, as columns
    assert written("out/plan.json") == found
    properties = written("out/path.geojson")["properties"]
    meta, _, _, values = pyogrio.raw.read("out/path.gpkg", layer="path")
    fields = dict(zip(meta["fields"].tolist(), values, strict=True))
    for name in numbers:
        assert properties[name] == fields[name][0] == found[name]
    rows = rows_of("out/path.csv")
    last = {name: float(number) for name, number in rows[-1].items()}
    assert (last["distance_m"], last["ground_m"]) == pytest.approx(
        (found["length_m"], found["ground_length_m"]), abs=1e-5
    )
    lines = dict(line.split(maxsplit=1) for line in run(words).out.splitlines())
    assert f"at most {found['steepest_up_deg']:.1f}° up" in lines["ground"]
    way = lines.get("way", "")
    of_body = [found["energy_j"] is not None, "energy_j" in last, "at the vehicle's speeds" in way]
    assert of_body == [bool(body)] * 3
    if body:
        assert last["time_s"] == pytest.approx(found["time_s"], abs=1e-5)
        assert " at 9.81 m/s²" in way
        assert f"pitched by at most {found['steepest_pitch_deg']:.1f}°" in lines["vehicle"]
        stands = found["waypoints"]
        assert stands["heading_deg"] == pytest.approx(plan.headings_deg, abs=1e-4)
        assert set(stands) <= set(properties) & set(last)
        for name in ("pitch", "roll", "tilt"):
            steepest = found[f"steepest_{name}_deg"]
            assert max(map(abs, stands[f"{name}_deg"])) == steepest <= 40.0
            of_rows = max(abs(float(row[f"{name}_deg"])) for row in rows)
            assert of_rows == pytest.approx(steepest, rel=1e-3)
        assert min(stands["clearance_m"]) == found["least_clearance_m"] >= 0.0
        assert properties["least_margin"] == found["least_margin"]
        assert "a body's legs lead in 16 directions" in run(f"{words} --refine any-angle").err


@pytest.mark.parametrize(
    ("body", "side_m", "words"),
    [
        ("small-rover", 1.4, "; too coarse to check it, take a finer map"),
        ("small-rover", 0.3, "cells of 0.11 m (gdalwarp"),
        ("large-rover", 1.0, "cells of 0.5 m (gdalwarp"),
        ("tracked", 0.9, "cells of 0.17 m (gdalwarp"),
        (
            "mine.toml",
            1.0,
            "; cells of 0.37 m (gdalwarp -r bilinear -tr) let it be checked between",
        ),
    ],
)
def test_a_warning_says_where_cells_are_coarse_for_a_body(run, body, side_m, words):
    Path("mine.toml").write_text(MINE)
    np.savez("flat.npz", elevation_m=np.zeros((60, 60), np.float32), cell_size_m=side_m)
    told = run(f"plan flat.npz --start 12,12 --goal 48,48 --vehicle {body}").err
    assert words in told and "a kerb is taken for a ramp" in told


def test_a_path_leads_by_way_of_places_in_the_order_given_or_in_the_best(run, told, hills):
    words = f"{PLAN} --method astar --via 60,70 --via 12,30 --via 40,50"
    given = told(words)
    assert given["via"]["stops"] == [[5, 5], [60, 70], [12, 30], [40, 50], [70, 80]]
    assert given["via"]["order"] == [1, 2, 3] and given["via"]["given_cost"] is None
    best = told(f"{words} --best-order -o out")
    assert best["via"]["stops"] == [[5, 5], [12, 30], [40, 50], [60, 70], [70, 80]]
    assert best["via"]["order"] == [2, 3, 1]
    assert best["cost"] < given["cost"] == pytest.approx(best["via"]["given_cost"], rel=1e-6)
    for found in (given, best):
        for name in ("cost", "length_m", "climb_m"):
            assert sum(leg[name] for leg in found["via"]["legs"]) == pytest.approx(
                found[name], abs=1e-4
            )
    cells = [(int(row["row"]), int(row["col"])) for row in rows_of("out/path.csv")]
    places = [cells.index(tuple(stop)) for stop in best["via"]["stops"]]
    assert places == sorted(places)
    saved = f"{100.0 * (1.0 - best['cost'] / given['cost']):.3g} % less than in the order given"
    assert f"2 (12, 30), 3 (40, 50), 1 (60, 70): {saved}" in run(f"{words} --best-order").out
    words = f"{PLAN} --via 12,30 --via 40,50 --best-order"
    assert "1 (12, 30), 2 (40, 50): the order given, no cheaper one was found" in run(words).out


def test_rescaled_ground_costs_as_with_other_limits_and_lies_where_it_did(run, told, hills):
    formats = "--gpkg"
    made = []
    for words in ("--rescale 0.5", "--limit roughness_limit_m=2.4 --limit step_limit_m=0.8"):
        found = told(f"{PLAN} --mobility large-rover {words} -o out {formats}")
        line = np.array(written("out/path.geojson")["geometry"]["coordinates"])
        assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(found["length_m"])
        areas = told(f"reach hills.tif --start 5,5 --within-cost 90 {words}")["areas"]
        assert run(f"costmap hills.tif -o cost.tif {words}").code == 0
        same = [Path(name).read_bytes() for name in ("out/path.csv", "cost.tif")]
        made.append([line.tolist(), areas, found["cost"], found["energy_j"], *same])
    assert made[0] == made[1]
    assert made[0][2] < told(PLAN)["cost"]


def test_a_part_around_the_ends_has_the_same_path_in_the_same_place(run, told, hills):
    words = "plan {} --start 20,20 --goal 50,40 --method astar -o out"
    whole = told(words.format("hills.tif"))
    line = written("out/path.geojson")["geometry"]
    ended = run(words.format("hills.tif"), "--crop", "30", "--json")
    shifted = "cut out 61 × 51 cells: cell (row, col) of the file is now (row - 5, col - 5)"
    assert shifted in ended.err
    assert (ended.json["rows"], ended.json["start"]) == (61, [15, 15])
    assert ended.json["cost"] == whole["cost"] and written("out/path.geojson")["geometry"] == line
    assert told(words.format("hills.npz"), "--crop", "30")["cost"] == whole["cost"]
    everything = told(words.format("hills.tif"), "--crop", "1e6")
    assert (everything["rows"], everything["start"]) == (80, [20, 20])


def test_long_times_are_told_in_hours_and_energies_in_kilowatt_hours():
    assert duration(76.9 * 3600) == "76 h 54 min"
    assert (work(5e5), work(7.2e6)) == ("500 kJ", "7.2 MJ (2 kWh)")


def test_without_a_path_it_is_said_how_far_the_search_came(run, told, hills):
    found = told("plan hills.tif --start 20,20 --goal 30,88", code=1)
    assert found["reached_from"] == "start"
    assert (
        found["reached_cells"]
        == told("reach hills.tif --start 20,20 --within-cost 1e6 --levels 1")["areas"][0]["cells"]
    )
    row, col = found["closest_cell"]
    assert row == 30 and 80 <= col < 86


def test_a_leg_that_cannot_be_is_named_and_ends_with_1(run, told, hills):
    ended = run(f"{PLAN} --via 20,20 --via 30,88")
    assert ended.code == 1 and ended.out.startswith("NO_PATH")
    assert "leg 2 of 3, from (20, 20) to (30, 88)" in ended.out
    found = told(f"{PLAN} --via 30,88 --best-order", code=1)
    assert (found["status"], found["cost"], found["climb_m"]) == ("NO_PATH", None, None)


def test_ends_are_places_on_the_map_or_on_the_globe(told, hills):
    cells = [(5, 5), (40, 30), (70, 80)]
    wanted = told(f"{PLAN} --via 40,30")
    move = Transformer.from_crs(GRID, "EPSG:4326", always_xy=True)
    places = [PLACE.map_coordinates(*cell) for cell in cells]
    xy = [f"xy:{x},{y}" for x, y in places]
    lonlat = ["lonlat:{:.9f},{:.9f}".format(*move.transform(x, y)) for x, y in places]
    for start, via, goal in (xy, lonlat):
        found = told(f"plan hills.tif --start {start} --via {via} --goal {goal}")
        assert (found["start"], found["via"]["stops"][1], found["goal"]) == (
            [5, 5],
            [40, 30],
            [70, 80],
        )
        assert found["cost"] == wanted["cost"]


@pytest.fixture
def legend(monkeypatch):
    """Words of the legend of the last picture."""
    words = []

    def draw(*given, **more):
        figure = plan_picture(*given, **more)
        words[:] = [text.get_text() for text in figure.legends[0].get_texts()]
        return figure

    monkeypatch.setattr(planning, "plan_picture", draw)
    return words


def test_without_a_path_a_body_is_told_by_which_limit_and_so_is_the_legend(told, hill, legend):
    words = "plan wall.npz --start 10,10 --goal 45,48 --vehicle small-rover -o out"
    reason = told(words, code=1)["reason"]
    assert (
        "; the search from the goal got to (" in reason
        and " fail by tilt, such as from (" in reason
    )
    assert {"unknown ground, obstacle or edge", "too steep", "leads to the goal"} <= set(legend)
    assert not {"too steep ahead", "path", "vehicle"} & set(legend)


def test_the_picture_has_the_body_and_with_a_comparison_a_points_path(run, hill, legend):
    method = "--method corridor"
    of_body = {"vehicle", "path of a point", "exact optimum"}
    for more, drawn in (
        ("", set()),
        ("--vehicle small-rover", {"vehicle"}),
        ("--vehicle small-rover --compare", of_body),
    ):
        assert run(f"plan hill.npz --start 10,10 --goal 45,48 {more} {method} -o out").code == 0
        assert of_body & set(legend) == drawn and "path" in legend


def test_a_body_asks_no_network(told, hill):
    found = told("plan hill.npz --start 10,10 --goal 45,48 --vehicle small-rover --method nnpp")
    assert (
        found["method"] == "nnpp" and "no network is used for a vehicle's body" in found["choice"]
    )


def test_way_points_are_told_with_their_headings_and_curvatures(run, told, hills):
    words = f"{PLAN} --refine any-angle"
    found = told(f"{words} -o out")
    line = found["line"]
    points = np.array(line["row_col"])
    assert (points[0].tolist(), points[-1].tolist()) == ([5, 5], [70, 80])
    assert len(line["heading_deg"]) == len(points)
    assert line["curvature_per_m"] == pytest.approx(curvatures(2.0 * points), rel=0.05, abs=1e-4)
    sharpest = found["sharpest_curvature_per_m"]
    assert sharpest == pytest.approx(max(line["curvature_per_m"]), abs=1e-5)
    feature = written("out/path.geojson")
    assert feature["properties"]["sharpest_curvature_per_m"] == sharpest
    wanted = [PLACE.map_coordinates(*point) for point in points]
    assert np.array(feature["geometry"]["coordinates"]) == pytest.approx(np.array(wanted), rel=1e-7)
    rows = rows_of("out/path.csv")
    assert len(rows) > len(points) and rows[-1]["row"] == "70"
    assert float(rows[-1]["distance_m"]) == pytest.approx(found["length_m"])
    assert f"{len(points)} way points, line integral" in run(words).out
    assert not {"line", "sharpest_curvature_per_m"} & set(told(PLAN))


def test_a_radius_that_no_arc_between_cells_has_is_warned_of(run, hills):
    words = f"{PLAN} {BODY} --set turning_radius_m={{}}"
    told = run(words.format(6)).err
    assert (
        "cells of 2 m have a radius of at least 8.47 m, not 6 m: cells of 1.5 m (gdalwarp" in told
    )
    assert 6.0 < sharpest_m(6.0, (1.5, 1.5)) < 6.6
    assert "arcs that" not in run(words.format(8)).err
