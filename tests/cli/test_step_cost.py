"""`--step-cost` and `--mobility`: what they do to `plan` and `evaluate`, and what is refused."""

import json

import numpy as np
import pytest
import rasterio

ENDS = ("--start", "5,5", "--goal", "35,50", "--method", "astar")
ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"


@pytest.fixture
def hill(tmp_path, monkeypatch):
    """A ramp, in whose folder commands run: down from start to goal."""
    row, col = np.mgrid[0:40, 0:60]
    heights = (-0.12 * col + 0.3 * np.sin(row / 5.0)).astype(np.float32)
    np.savez(tmp_path / "hill.npz", elevation_m=heights, cell_size_m=2.0)
    (tmp_path / "mine.toml").write_text(ENERGY)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "hill.npz"


def test_a_plan_by_tobler_is_in_seconds_and_the_way_back_takes_longer(nnpp_edge, hill):
    there = json.loads(nnpp_edge("plan", hill, *ENDS, "--step-cost", "tobler", "--json").out)
    back = json.loads(
        nnpp_edge("plan", hill, "--goal", "5,5", "--start", "35,50", "--step-cost", "tobler", "--json").out
    )
    assert there["step_cost"] == "tobler" and there["cost"] < back["cost"]
    assert there["cost"] == pytest.approx(0.6 * 2.0 * (10.0 + 35.0 * 2**0.5), rel=0.2)
    assert "cost" in (out := nnpp_edge("plan", hill, *ENDS, "--step-cost", "tobler").out) and " s, the optimum" in out


def test_a_walkers_time_is_told_by_the_function_that_the_steps_cost(nnpp_edge, hill):
    (hill.parent / "path.toml").write_text("[mobility.irmischer]\non_path = true\n")
    for given, words in (
        (("--step-cost", "irmischer"), "on foot, by Irmischer and Clarke's function"),
        (("--step-cost", "irmischer", "--mobility", "path.toml"), "on foot, by Irmischer and Clarke's function"),
        (("--step-cost", "tobler"), "on foot, by Tobler's function"),
        ((), "on foot, by Tobler's function"),
        (("--step-cost", "irmischer", "--mobility", "large-rover"), "at the vehicle's speeds"),
    ):
        told = json.loads(nnpp_edge("plan", hill, *ENDS, *given, "--json").out)
        agree = given and "large-rover" not in given
        assert (told["time_s"] == pytest.approx(told["cost"], rel=1e-5)) == bool(agree), given
        assert words in nnpp_edge("plan", hill, *ENDS, *given).out


def test_energy_is_in_joules_by_the_vehicles_own_table_or_another_file(nnpp_edge, hill):
    costs = set()
    for given in (("--vehicle", "large-rover"), ("--mobility", "mine.toml"), ("--mobility", "small-rover")):
        out = json.loads(nnpp_edge("plan", hill, *ENDS, "--step-cost", "energy", *given, "--json").out)
        assert out["status"] == "OK" and out["bound"] == 1.0
        costs.add(out["cost"])
    assert len(costs) == 3
    assert " J, the optimum" in nnpp_edge("plan", hill, *ENDS, "--step-cost", "energy", "--mobility", "mine.toml").out


def test_energy_goes_by_the_gravity_of_the_maps_body_and_says_so(nnpp_edge, hill):
    place = {"transform": rasterio.Affine(2, 0, 5e5, 0, -2, 0), "dtype": "float32", "tiled": True}
    for crs, given, gravity in (
        ("IAU_2015:30110", None, 1.62),
        ("IAU_2015:49910", None, 3.71),
        ("IAU_2015:30110", 2.5, 2.5),
        ("EPSG:32615", None, 9.80665),
        (None, None, 3.71),  # its file's
        (None, 1.62, 1.62),
    ):
        with rasterio.open("hill.tif", "w", "GTiff", 60, 40, 1, crs=crs, **place) as file:
            file.write(np.load(hill)["elevation_m"], 1)
        own = ("--set", f"mobility.energy.gravity_m_s2={given}") if given else ()
        for more in ((), ("--memory", "1kB")):
            words = ("plan", "hill.tif", *ENDS[:4], "--mobility", "large-rover", *own, *more)
            ended = nnpp_edge(*words, "--json")
            told = json.loads(ended.out)
            assert told["gravity_m_s2"] == gravity
            idle_j = 45.0 * told["ground_length_m"] / 0.042
            up_and_along = 0.2 * told["length_m"] + told["climb_m"] - told["descent_m"]  # all steps roll
            assert told["energy_j"] == pytest.approx(899.0 * gravity * up_and_along / 0.4 + idle_j, rel=1e-3)
            assert f"kJ at {gravity:.3g} m/s²" in nnpp_edge(*words).out
            warned = f"energy goes by {gravity:g} m/s², the gravity of the map's body, not by the vehicle's own 3.71"
            assert (warned in ended.err) == (gravity not in (3.71, 2.5) and crs is not None)


def test_energy_got_back_downhill_is_a_cost_below_zero(nnpp_edge, hill):
    (hill.parent / "mine.toml").write_text(ENERGY.replace("0.1", "0.01") + "recovery = 0.9\n")
    given = (*ENDS[:4], "--step-cost", "energy", "--mobility", "mine.toml")
    for method in ("astar", "corridor"):
        ended = nnpp_edge("plan", hill, *given, "--method", method, "--compare", "--json")
        out = json.loads(ended.out)
        assert out["cost"] < 0.0 and all(row["gap"] >= -1e-6 for row in out["compare"]), ended.out
        assert out["source"] in ("map", "region")
        text = nnpp_edge("plan", hill, *given, "--method", method).out
        assert "the optimum" in text or "no path costs less than -" in text


def test_without_a_step_cost_nothing_is_said_of_it(nnpp_edge, hill):
    out = json.loads(nnpp_edge("plan", hill, *ENDS, "--json").out)
    named = json.loads(nnpp_edge("plan", hill, *ENDS, "--step-cost", "paper", "--json").out)
    assert "step_cost" not in out and (out["cost"], out["cells"]) == (named["cost"], named["cells"])


def test_evaluate_judges_by_the_directed_optimum(nnpp_edge, hill):
    ended = nnpp_edge(
        "evaluate", "--terrain", hill, "--sizes", "36", "--queries", "4", "--repeats", "1", "--methods", "corridor",
        "--step-cost", "energy", "--mobility", "mine.toml", "--json",
    )  # fmt: skip
    exact, corridor = json.loads(ended.out)
    assert (exact["method"], exact["n"], exact["gap_max"]) == ("astar", 4, 0.0)
    assert corridor["success"] == 1.0 and corridor["gap_max"] >= -1e-6
