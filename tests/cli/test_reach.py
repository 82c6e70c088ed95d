"""`nnpp-edge reach`: what it finds, writes and refuses."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Vehicle
from nnpp_edge.terrain.dem import read_dem
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from tests.cli.grounds import BODY, PLACE, written

REACH = "reach hills.tif --start 40,30"


@pytest.fixture
def reached(hills):
    """The field of a planner of heights, made with its own options."""
    return lambda most=np.inf, **made: Planner.of_elevation(hills, 2.0, warn=False, **made).reach(
        (40, 30), most
    )


def test_areas_are_what_the_planner_reaches(run, told, reached):
    words = f"{REACH} --within-cost 60 --levels 3 -o out"
    found = told(words)
    wanted = reached(60.0)
    out = Path("out")
    assert [area["within"] for area in found["areas"]] == [20.0, 40.0, 60.0]
    counts = [int((wanted <= each).sum()) for each in (20, 40, 60)]
    assert [area["cells"] for area in found["areas"]] == counts
    assert [area["area_m2"] for area in found["areas"]] == [4.0 * count for count in counts]
    raster = read_dem(out / "reach.tif")
    assert np.array_equal(np.isfinite(raster.elevation), np.isfinite(wanted))
    assert raster.elevation[np.isfinite(wanted)] == pytest.approx(wanted[np.isfinite(wanted)])
    assert raster.georeference.transform == PLACE.transform
    assert written(out / "reach.json") == found
    assert sorted(found["files"]) == sorted(map(str, out.iterdir()))
    collection = written(out / "reach.geojson")
    assert [each["properties"]["cells"] for each in collection["features"]] == counts[::-1]
    assert min(cv2.imread(str(out / "reach.png")).shape[:2]) > 800
    text = run(words).out
    assert "within a cost of 20" in text and "% of the map" in text


def test_an_area_counts_both_sides_of_a_cell(told):
    wide = {"cell_size_m": 2.0, "cell_width_m": 3.0}
    np.savez("wide.npz", elevation_m=np.zeros((20, 20), np.float32), **wide)
    (area,) = told("reach wide.npz --start 9,9 --within-cost 5 --levels 1")["areas"]
    assert area["area_m2"] == 6.0 * area["cells"] > 100.0


def test_limits_and_vehicles_bound_what_is_reached(told, reached):
    words = f"{REACH} --within-cost 60 --levels 1"
    every, limited, body, disc = (
        told(f"{words} {more}")["areas"][0]["cells"]
        for more in ("", "--workload limit12", BODY, "--set radius_m=3")
    )
    rover = replace(load_vehicle("large-rover"), max_tilt_deg=40.0, clearance_m=1.5)
    for cells, vehicle in ((disc, Vehicle(radius_m=3.0)), (body, rover)):
        assert cells == np.isfinite(reached(60.0, vehicle=vehicle)).sum() > 0
    assert 0 < limited < every > disc


def test_a_time_an_energy_or_any_cost_is_reached_as_the_planner_reaches_it(run, told, reached):
    speeds = {"mobility": load_mobility("large-rover", gravity_m_s2=9.80665)}
    body = {"vehicle": replace(load_vehicle("large-rover"), max_tilt_deg=40.0, clearance_m=1.5)}
    for words, most, unit, step_cost, made in (
        ("--within-time 1min --step-cost tobler", 60.0, "s", "tobler", {}),
        (f"--within-time 1min --step-cost tobler {BODY}", 60.0, "s", "tobler", body),
        (f"--within-time 1h {BODY}", 3600.0, "s", "time", speeds | body),
        (f"--within-energy 30kJ {BODY}", 3e4, "J", "energy", speeds | body),
        ("--within-cost 60 --step-cost linear", 60.0, "", "linear", {}),
        ("--within-cost 900 --step-cost time --mobility large-rover", 900.0, "s", "time", speeds),
    ):
        found = told(f"{REACH} {words} --levels 2")
        wanted = reached(most, step_cost=step_cost, **made)
        cells = [int((wanted <= level).sum()) for level in (most / 2, most)]
        assert [area["cells"] for area in found["areas"]] == cells, words
        assert 1 < cells[0] < cells[1] and found["areas"][1]["within"] == most
        assert found["unit"] == unit
    run(f"{REACH} --within-energy 9e3").refused("[mobility.energy]")
    run(f"{REACH} --within-time 5min").refused("--step-cost tobler")
    asked = run(f"{REACH} --within-time 5min --step-cost tobler")
    assert "speeds" in asked.out and "of a walker, by Tobler's function" in asked.out
    seconds = run(f"{REACH} --within-cost 60 --step-cost tobler --levels 1").out
    assert "within a cost of 60 s  " in seconds
