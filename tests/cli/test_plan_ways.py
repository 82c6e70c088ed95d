"""`nnpp-edge plan`: numbers along the way, places between, ends by coordinates and layers, formats, the profile."""

import csv
import json
import math
import sys

import cv2
import numpy as np
import pyogrio
import pytest
from pyproj import Transformer

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.map.along import Along, Numbers
from nnpp_edge.terrain.dem import Dem, read_dem, write_raster
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from tests.cli.grounds import ENDS, GRID, PLACE, layer, rolling


@pytest.fixture
def hills(tmp_path):
    """A GeoTIFF of rolling ground, cells of 2 m, with a wall of unknown height across its last columns."""
    heights = rolling()
    heights[:, 86] = np.nan
    write_raster(tmp_path / "hills.tif", heights, Dem(heights, 2.0, 2.0, PLACE, tmp_path))
    return tmp_path / "hills.tif"


@pytest.mark.parametrize(
    "body", [(), ("--vehicle", "large-rover", "--set", "max_tilt_deg=40", "--set", "clearance_m=1.5")]
)
def test_all_outputs_say_the_same_numbers(nnpp_edge, hills, tmp_path, body):
    words = ("plan", hills, *ENDS, *body, "-o", tmp_path / "out", "--format", "gpkg")
    told = json.loads(nnpp_edge(*words, "--json").out)
    ground = read_dem(hills)
    vehicle = load_vehicle("large-rover") if body else None
    mobility = load_mobility("large-rover", gravity_m_s2=9.80665) if body else None
    made = {
        "vehicle": vehicle and type(vehicle)(**{**vars(vehicle), "max_tilt_deg": 40.0, "clearance_m": 1.5}),
        "mobility": mobility,
    }
    plan = Planner.of_elevation(ground.elevation, 2.0, warn=False, **made).plan((5, 5), (70, 80))
    numbers = {name: told[name] for name in Numbers._fields}
    assert {name: value for name, value in numbers.items() if value is not None} == pytest.approx(
        {name: value for name, value in plan.numbers._asdict().items() if math.isfinite(value)}, rel=1e-4, abs=1e-4
    )
    assert (numbers["energy_j"] is not None) == bool(body)
    assert json.loads((tmp_path / "out" / "plan.json").read_text()) == told
    properties = json.loads((tmp_path / "out" / "path.geojson").read_text())["properties"]
    worst = [name for name in told if name.startswith(("steepest_", "least_")) and name not in Numbers._fields]
    assert len(worst) == (4 if body else 0)
    for name in (*Numbers._fields, *worst, "cost"):
        assert properties[name] == told[name]
    meta, _, _, values = pyogrio.raw.read(tmp_path / "out" / "path.gpkg")
    fields = dict(zip(meta["fields"].tolist(), values, strict=True))
    assert {name: told[name] for name in numbers if told[name] is not None} == {
        name: fields[name][0] for name in numbers if name in fields
    }
    rows = list(csv.DictReader((tmp_path / "out" / "path.csv").read_text().splitlines()))
    assert float(rows[-1]["distance_m"]) == pytest.approx(told["length_m"], abs=1e-5)
    assert float(rows[-1]["ground_m"]) == pytest.approx(told["ground_length_m"], abs=1e-5)
    assert float(rows[-1]["time_s"]) == pytest.approx(told["time_s"], abs=1e-5)
    assert ("energy_j" in rows[0]) == bool(body)
    lines = dict(line.split(maxsplit=1) for line in nnpp_edge(*words).out.splitlines())
    assert f"at most {told['steepest_up_deg']:.1f}° up" in lines["ground"]
    assert ("kJ" in lines["way"], "at the vehicle's speeds" in lines["way"]) == (bool(body), bool(body))
    if body:
        assert f"pitched by at most {told['steepest_pitch_deg']:.1f}°" in lines["vehicle"]
        stands = told["waypoints"]
        assert max(map(abs, stands["roll_deg"])) == told["steepest_roll_deg"]
        assert min(stands["clearance_m"]) == told["least_clearance_m"]


def test_a_path_leads_by_way_of_places_in_the_order_given_or_in_the_best(nnpp_edge, hills, tmp_path):
    via = ("--via", "60,70", "--via", "12,30", "--via", "40,50")
    words = ("plan", hills, *ENDS, "--method", "astar", *via)
    told = json.loads(nnpp_edge(*words, "--json").out)
    assert told["via"]["stops"] == [[5, 5], [60, 70], [12, 30], [40, 50], [70, 80]]
    assert told["via"]["order"] == [1, 2, 3] and told["via"]["given_cost"] is None
    best = json.loads(nnpp_edge(*words, "--best-order", "--json", "-o", tmp_path / "out", "--format", "gpx").out)
    assert best["via"]["stops"] == [[5, 5], [12, 30], [40, 50], [60, 70], [70, 80]]
    assert best["via"]["order"] == [2, 3, 1] and best["cost"] < told["cost"] == pytest.approx(
        best["via"]["given_cost"], rel=1e-6
    )
    for found in (told, best):
        for name in ("cost", "length_m", "climb_m", "time_s"):
            assert sum(leg[name] for leg in found["via"]["legs"]) == pytest.approx(found[name], abs=1e-4)
    rows = csv.DictReader((tmp_path / "out" / "path.csv").read_text().splitlines())
    cells = [(int(row["row"]), int(row["col"])) for row in rows]
    places = [cells.index(tuple(stop)) for stop in best["via"]["stops"]]
    assert places == sorted(places)
    names = pyogrio.raw.read(tmp_path / "out" / "path.gpx", layer="waypoints", columns=["name"])[3][0]
    assert names.tolist() == ["start", "via 1", "via 2", "via 3", "goal"]
    shown = nnpp_edge(*words, "--best-order").out
    saved = 100.0 * (1.0 - best["cost"] / told["cost"])
    assert f"2 (12, 30), 3 (40, 50), 1 (60, 70): {saved:.1f} % less than in the order given" in shown


def test_a_leg_that_cannot_be_is_named_and_ends_with_1(nnpp_edge, hills):
    ended = nnpp_edge("plan", hills, *ENDS, "--via", "20,20", "--via", "30,88")
    assert (
        ended.code == 1 and "leg 2 of 3, from (20, 20) to (30, 88)" in ended.out and ended.out.startswith("NO_PATH")
    )
    told = json.loads(nnpp_edge("plan", hills, *ENDS, "--via", "30,88", "--best-order", "--json").out)
    assert told["status"] == "NO_PATH" and told["cost"] is None and told["climb_m"] is None


def test_ends_are_places_on_the_map_or_on_the_globe_or_points_of_a_layer(nnpp_edge, hills, tmp_path):
    cells = [(5, 5), (40, 30), (70, 80)]
    wanted = json.loads(nnpp_edge("plan", hills, *ENDS, "--via", "40,30", "--json").out)
    move = Transformer.from_crs(GRID, "EPSG:4326", always_xy=True)
    places = [PLACE.map_coordinates(*cell) for cell in cells]
    xy = [f"xy:{x},{y}" for x, y in places]
    lonlat = ["lonlat:{:.9f},{:.9f}".format(*move.transform(x, y)) for x, y in places]
    layers = [f"{layer(tmp_path / f'{at}.gpkg', [cell])}:stops" for at, cell in enumerate(cells)]
    for start, via, goal in (xy, lonlat, layers):
        told = json.loads(nnpp_edge("plan", hills, "--start", start, "--via", via, "--goal", goal, "--json").out)
        assert (told["start"], told["via"]["stops"][1], told["goal"]) == ([5, 5], [40, 30], [70, 80])
        assert told["cost"] == wanted["cost"]


def test_a_layer_in_another_system_is_reprojected_and_its_points_are_visited_in_order(nnpp_edge, hills, tmp_path):
    path = layer(tmp_path / "stops.gpkg", [(60, 70), (12, 30)], crs="EPSG:4326")
    ended = nnpp_edge("plan", hills, *ENDS, "--via", path, "--json")
    assert ended.err == f"{path}: reprojected from WGS 84 to SVY21 / Singapore TM\n"
    assert json.loads(ended.out)["via"]["stops"] == [[5, 5], [60, 70], [12, 30], [70, 80]]
    goals = json.loads(nnpp_edge("plan", hills, "--start", "5,5", "--goal", path, "--json").out)
    assert goals["goal"] == [12, 30] and len(goals["goals"]) == 2


def test_the_profile_is_drawn_where_it_is_wanted(nnpp_edge, hills, tmp_path):
    out, alone = tmp_path / "out", tmp_path / "profile.svg"
    told = json.loads(nnpp_edge("plan", hills, *ENDS, "-o", out, "--profile-plot", "--json").out)
    assert str(out / "profile.png") in told["files"]
    picture = cv2.imread(str(out / "profile.png"))
    assert min(picture.shape[:2]) > 400 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    told = json.loads(nnpp_edge("plan", hills, *ENDS, "--profile-plot", alone, "--via", "40,40", "--json").out)
    assert told["files"] == [str(alone)] and alone.read_text().startswith("<?xml")
    ended = nnpp_edge("plan", hills, "--start", "5,5", "--goal", "70,88", "-o", out, "--profile-plot")
    assert ended.code == 1 and (out / "profile.png").exists()


def test_without_matplotlib_the_profile_is_refused_in_one_line(nnpp_edge, hills, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ended = nnpp_edge("plan", hills, *ENDS, "--profile-plot", tmp_path / "a.png")
    ended.refused("--profile-plot needs matplotlib", "nnpp-edge[viz]")


def test_gpx_needs_a_map_on_the_earth_and_nothing_is_written_without(nnpp_edge, tmp_path):
    np.savez(tmp_path / "hills.npz", elevation_m=rolling(), cell_size_m=2.0)
    ended = nnpp_edge("plan", tmp_path / "hills.npz", *ENDS, "-o", tmp_path / "out", "--format", "gpx")
    ended.refused("wanted a map with a coordinate system")
    assert list((tmp_path / "out").iterdir()) == []
    assert nnpp_edge("plan", tmp_path / "hills.npz", *ENDS, "-o", tmp_path / "out", "--format", "gpkg").code == 0


def test_a_map_read_by_windows_has_the_same_numbers_and_tours(nnpp_edge, hills):
    words = (
        "plan",
        hills,
        *ENDS,
        *["--method", "corridor", "--via", "60,20", "--via", "20,60", "--best-order", "--json"],
    )
    whole, windows = (json.loads(nnpp_edge(*words, *more).out) for more in ((), ("--memory", "1kB")))
    assert windows["windows"] and whole["via"] == windows["via"]
    for name in (*Numbers._fields, "cost"):
        assert whole[name] == windows[name]


def test_along_way_points_the_route_is_theirs(hills):
    from nnpp_edge.terrain.route import Route

    ground = read_dem(hills)
    line = np.array([(5.0, 5.0), (30.5, 20.25), (70.0, 80.0)])
    along = Along.of(line, ground.elevation, (2.0, 2.0))
    route = Route.of(line, along, np.full(ground.shape, 0.25, np.float32), ground)
    feature = json.loads(route.geojson({}))
    assert feature["geometry"]["coordinates"] == [list(PLACE.map_coordinates(*point)) for point in line.tolist()]
    rows = list(csv.DictReader(route.csv().decode().splitlines()))
    assert len(rows) == len(along.points) > 100 and rows[-1]["row"] == "70"
    assert float(rows[-1]["distance_m"]) == pytest.approx(route.length_m)
    assert route.length_m == pytest.approx(2.0 * (math.dist(*line[:2]) + math.dist(*line[1:])))
