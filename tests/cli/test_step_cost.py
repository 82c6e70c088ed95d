"""`--step-cost`, `--mobility` and `--vehicle` with `--set`: what is made of them, and what they do
to a plan.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import VehicleOptions
from nnpp_edge.runtime import NnppEdgeError, Vehicle
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle
from tests.terrain.test_dem import geotiff

ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"
PLAN = "plan hill.npz --start 5,5 --goal 35,50 --method astar"


@pytest.fixture
def hill(run):
    """A ramp: down from start to goal."""
    row, col = np.mgrid[0:40, 0:60]
    heights = (-0.12 * col + 0.3 * np.sin(row / 5.0)).astype(np.float32)
    np.savez("hill.npz", elevation_m=heights, cell_size_m=2.0)
    Path("mine.toml").write_text(ENERGY)
    return heights


def given(*words):
    """The options that a command makes of words on its command line."""
    made = []

    @options.command("drive")
    def drive(robot: VehicleOptions, seed: options.Seed = 1):
        made.append(robot)

    ended = CliRunner().invoke(drive, [str(word) for word in words], standalone_mode=False)
    if ended.exception is not None:
        raise ended.exception
    return made[0]


def test_a_walkers_time_is_told_by_the_function_that_the_steps_cost(run, told, hill):
    for more, words, agree in (
        ("--step-cost tobler", "on foot, by Tobler's function", True),
        ("--step-cost tobler --mobility large-rover", "at the vehicle's speeds", False),
    ):
        found = told(f"{PLAN} {more}")
        assert (found["time_s"] == pytest.approx(found["cost"], rel=1e-5)) == agree, more
        out = run(f"{PLAN} {more}").out
        assert words in out and (" s, the optimum" in out) == ("step_cost" in found) == bool(more)
    named = told(f"{PLAN} --step-cost paper")
    assert (found["step_cost"], named["cost"]) == ("tobler", told(PLAN)["cost"])


def test_energy_is_in_joules_by_the_vehicles_own_table_or_another_file(run, told, hill):
    costs = set()
    for more in ("--vehicle large-rover", "--mobility mine.toml", "--mobility small-rover"):
        found = told(f"{PLAN} --step-cost energy {more}")
        assert found["status"] == "OK" and found["bound"] == 1.0
        costs.add(found["cost"])
    assert len(costs) == 3
    assert " J, the optimum" in run(f"{PLAN} --step-cost energy --mobility mine.toml").out


def test_energy_goes_by_the_gravity_of_the_maps_body_which_the_answer_names(run, hill):
    place = {"transform": rasterio.Affine(2, 0, 5e5, 0, -2, 0), "tiled": True}
    for crs, own, gravity in (
        ("IAU_2015:30110", None, 1.62),
        ("IAU_2015:49910", None, 3.71),
        ("IAU_2015:30110", 2.5, 2.5),
        ("EPSG:32615", None, 9.80665),
        (None, None, 3.71),  # its file's
        (None, 1.62, 1.62),
    ):
        geotiff("hill.tif", hill, crs=crs, **place)
        more = f"--set mobility.energy.gravity_m_s2={own}" if own else ""
        for memory in ("", "--memory 1kB"):
            words = f"plan hill.tif --start 5,5 --goal 35,50 --mobility large-rover {more} {memory}"
            found = run(words, "--json").json
            assert found["gravity_m_s2"] == gravity
            idle_j = 45.0 * found["ground_length_m"] / 0.042
            up_and_along = (
                0.2 * found["length_m"] + found["climb_m"] - found["descent_m"]
            )  # all steps roll
            assert found["energy_j"] == pytest.approx(
                899.0 * gravity * up_and_along / 0.4 + idle_j, rel=1e-3
            )
            text = run(words)
            assert f"kJ at {gravity:.3g} m/s²" in text.out and "gravity" not in text.err


def test_energy_got_back_downhill_is_a_cost_below_zero(run, told, hill):
    Path("mine.toml").write_text(ENERGY.replace("0.1", "0.01") + "recovery = 0.9\n")
    for method in ("astar", "corridor"):
        words = f"{PLAN[:-6]} {method} --step-cost energy --mobility mine.toml"
        found = told(f"{words} --compare")
        assert found["cost"] < 0.0 and all(row["gap"] >= -1e-6 for row in found["compare"])
        assert found["source"] in ("map", "region")
        text = run(words).out
        assert "the optimum" in text or "no path costs less than -" in text


def test_evaluate_judges_by_the_directed_optimum(told, hill):
    words = "evaluate --terrain hill.npz --sizes 36 --queries 4 --repeats 1 --methods corridor"
    exact, corridor = told(f"{words} --step-cost energy --mobility mine.toml")
    assert (exact["method"], exact["n"], exact["gap_max"]) == ("astar", 4, 0.0)
    assert corridor["success"] == 1.0 and corridor["gap_max"] >= -1e-6


def test_values_are_set_in_place_of_the_vehicles_own_or_of_none(tmp_path):
    own = load_vehicle("large-rover")
    assert given().body() is None and given("--seed", 3).body() is None
    assert given("--vehicle", "large-rover").body() == own
    assert given("--set", "radius_m=0.5").body() == Vehicle(radius_m=0.5)
    words = ("--vehicle", "large-rover", "--set", "turning_radius_m=3", "--set", "axles=4")
    made = given(*words, "--set", "turns_on_spot=true").body()
    assert made == replace(own, turning_radius_m=3.0, axles=4, turns_on_spot=True)
    keys = ("length_m=1.5", "width_m=1.2", "clearance_m=0.3", "max_tilt_deg=20")
    alone = given(*(word for key in keys for word in ("--set", key)))
    assert alone.body() == Vehicle(1.5, 1.2, 0.3, max_tilt_deg=20.0)
    (tmp_path / "own.toml").write_text(
        "length_m = 2.0\nwidth_m = 1.0\nclearance_m = 0.4\nunknown_passes = true\n"
    )
    words = ("--vehicle", tmp_path / "own.toml")
    assert given(*words).body() == Vehicle(2.0, 1.0, 0.4, unknown_passes=True)
    assert given(*words, "--set", "unknown_passes=false").body() == Vehicle(2.0, 1.0, 0.4)


def test_values_of_the_mobility_can_be_set_one_by_one():
    own = load_mobility("large-rover")
    for words in (("--vehicle", "large-rover"), ("--mobility", "large-rover")):
        found = given(*words, "--set", "mobility.energy.mass_kg=77").mobility()
        assert found.energy == replace(own.energy, mass_kg=77.0) and found.time == own.time
    assert given("--set", "mobility.linear.up_per_m=3").body() is None
    with pytest.raises(NnppEdgeError, match="large-rover: mobility: energies is unknown"):
        given("--vehicle", "large-rover", "--set", "mobility.energies.mass_kg=1").mobility()


def test_no_number_that_could_overflow_is_set():
    for name in {field.name for field in fields(Vehicle)} - {"unknown_passes", "turns_on_spot"}:
        for number in ("nan", "inf", "-inf", "1e308", "-1e308", "9" * 40, "-1", "1e-400"):
            if number == "1e-400" and name in ("turn_cost_m_per_rad", "gear_change_m", "reserve"):
                continue  # 0 is allowed
            with pytest.raises(NnppEdgeError):
                given("--vehicle", "large-rover", "--set", f"{name}={number}").body()
