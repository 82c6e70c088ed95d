"""`nnpp-edge reach`: what it finds, writes and refuses."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pyogrio
import pytest

from nnpp_edge.runtime import Planner, Vehicle, traversability_cost
from nnpp_edge.terrain.dem import Dem, read_dem, write_raster
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from tests.cli.grounds import BODY, PLACE, layer, rolling


@pytest.fixture
def hills(tmp_path):
    """A GeoTIFF of rolling ground, cells of 2 m."""
    heights = rolling()
    heights[30:50, 40] = np.nan
    write_raster(tmp_path / "hills.tif", heights, Dem(heights, 2.0, 2.0, PLACE, tmp_path))
    return tmp_path / "hills.tif"


def test_areas_are_what_the_planner_reaches(nnpp_edge, hills, tmp_path):
    out = tmp_path / "out"
    words = (
        "reach",
        hills,
        *["--start", "40,30", "--within-cost", "60", "--levels", "3", "--format", "gpkg", "-o"],
        out,
    )
    told = json.loads(nnpp_edge(*words, "--json").out)
    ground = read_dem(hills)
    wanted = Planner(traversability_cost(ground.elevation, 2.0)).reach((40, 30), 60.0)
    assert [area["within"] for area in told["areas"]] == [20.0, 40.0, 60.0]
    assert [area["cells"] for area in told["areas"]] == [int((wanted <= each).sum()) for each in (20, 40, 60)]
    assert [area["area_m2"] for area in told["areas"]] == [4.0 * area["cells"] for area in told["areas"]]
    raster = read_dem(out / "reach.tif")
    assert np.array_equal(np.isfinite(raster.elevation), np.isfinite(wanted))
    assert raster.elevation[np.isfinite(wanted)] == pytest.approx(wanted[np.isfinite(wanted)])
    assert raster.georeference.transform == PLACE.transform
    assert json.loads((out / "reach.json").read_text()) == told
    assert sorted(told["files"]) == sorted(map(str, out.iterdir()))
    collection = json.loads((out / "reach.geojson").read_text())
    assert [each["properties"]["cells"] for each in collection["features"]] == [
        area["cells"] for area in reversed(told["areas"])
    ]
    assert len(pyogrio.raw.read(out / "reach.gpkg")[2]) == 3
    assert min(cv2.imread(str(out / "reach.png")).shape[:2]) > 800
    text = nnpp_edge(*words, "--hillshade").out
    assert "within a cost of 20" in text and "% of the map" in text


def test_limits_and_vehicles_bound_what_is_reached(nnpp_edge, hills):
    words = ("reach", hills, "--start", "40,30", "--within-cost", "60", "--levels", "1", "--json")
    every = json.loads(nnpp_edge(*words).out)["areas"][0]["cells"]
    limited = json.loads(nnpp_edge(*words, "--workload", "limit12").out)["areas"][0]["cells"]
    body = json.loads(nnpp_edge(*words, *BODY).out)["areas"][0]["cells"]
    disc = json.loads(nnpp_edge(*words, "--set", "radius_m=3").out)["areas"][0]["cells"]
    ground = read_dem(hills).elevation
    vehicle = Vehicle(radius_m=3.0)
    wanted = Planner.of_elevation(ground, 2.0, vehicle=vehicle, warn=False).reach((40, 30), 60.0)
    assert disc == np.isfinite(wanted).sum() and 0 < body < every and 0 < limited < every > disc


def test_the_start_is_any_place_that_plan_takes(nnpp_edge, hills, tmp_path):
    words = ("reach", hills, "--within-cost", "20", "--json", "--start")
    wanted = json.loads(nnpp_edge(*words, "40,30").out)
    x, y = PLACE.map_coordinates(40, 30)
    for place in (f"xy:{x},{y}", layer(tmp_path / "a.gpkg", [(40, 30)])):
        assert json.loads(nnpp_edge(*words, place).out) == wanted


def test_within_a_time_on_foot_or_of_a_vehicle_and_within_its_energy(nnpp_edge, hills):
    ground, mobility = read_dem(hills).elevation, load_mobility("large-rover", gravity_m_s2=9.80665)
    vehicle = replace(load_vehicle("large-rover"), max_tilt_deg=40.0, clearance_m=1.5)
    for words, most, made in (
        (("--within-time", "1min"), 60.0, {"step_cost": "tobler"}),
        (("--within-time", "1min", "--step-cost", "irmischer"), 60.0, {"step_cost": "irmischer"}),
        (
            ("--within-time", "1min", "--step-cost", "tobler", *BODY),
            60.0,
            {"step_cost": "tobler", "vehicle": vehicle},
        ),
        (("--within-time", "1h", *BODY), 3600.0, {"step_cost": "time", "mobility": mobility, "vehicle": vehicle}),
        (("--within-energy", "3e4", *BODY), 3e4, {"step_cost": "energy", "mobility": mobility, "vehicle": vehicle}),
    ):
        told = json.loads(nnpp_edge("reach", hills, "--start", "40,30", *words, "--levels", "2", "--json").out)
        wanted = Planner.of_elevation(ground, 2.0, warn=False, **made).reach((40, 30), most)
        cells = [int((wanted <= level).sum()) for level in (most / 2, most)]
        assert [area["cells"] for area in told["areas"]] == cells
        assert 1 < cells[0] < cells[1] and told["areas"][1]["within"] == most
    nnpp_edge("reach", hills, "--start", "40,30", "--within-energy", "9e3").refused("[mobility.energy]")


def test_within_a_cost_of_any_step_cost_in_its_own_unit(nnpp_edge, hills):
    ground, mobility = read_dem(hills).elevation, load_mobility("large-rover", gravity_m_s2=9.80665)
    units = {"linear": "", "tobler": " s", "irmischer": " s", "time": " s", "energy": " J"}
    for step_cost, unit in units.items():
        planner = Planner.of_elevation(ground, 2.0, warn=False, step_cost=step_cost, mobility=mobility)
        field = planner.reach((40, 30))
        most = round(float(np.median(field[np.isfinite(field)])), 3)
        given = ("--step-cost", step_cost, "--mobility", "large-rover", "--levels", "1")
        words = ("reach", hills, "--start", "40,30", "--within-cost", most, *given)
        told = json.loads(nnpp_edge(*words, "--json").out)
        assert told["areas"][0]["cells"] == int((field <= most).sum()) and told["unit"] == unit.strip()
        assert f"within a cost of {most:.6g}{unit}  " in nnpp_edge(*words).out
