from dataclasses import fields, replace

import click
import pytest
from click.testing import CliRunner

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import VehicleOptions
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.vehicle_files import load_mobility, load_vehicle


@pytest.fixture
def given():
    """The options that a command makes of words on its command line."""

    def given(*words):
        made = []

        @options.command("drive")
        def drive(vehicle: VehicleOptions, seed: options.Seed = 1):
            made.append(vehicle)

        ended = CliRunner().invoke(drive, [str(word) for word in words], standalone_mode=False)
        if ended.exception is not None:
            raise ended.exception
        return made[0]

    return given


def test_every_value_can_be_set_in_place_of_the_vehicles_own(given, tmp_path):
    own = load_vehicle("large-rover")
    assert given().body() is None and given("--seed", 3).body() is None
    assert given("--vehicle", "large-rover").body() == own
    assert given("--set", "radius_m=0.5").body() == Vehicle(radius_m=0.5)
    for field in fields(Vehicle):
        value = {"axles": 4, "length_m": 3.5, "width_m": 3.5, "wheel_width_m": 0.3, "unknown_passes": True}.get(
            field.name, 20.0 if field.name.endswith("_deg") else 0.5
        )
        if field.name != "radius_m":
            made = given("--vehicle", "large-rover", "--set", f"{field.name}={str(value).lower()}").body()
            assert made == replace(own, **{field.name: value}), field.name
    alone = (word for key in ("length_m=1.5", "width_m=1.2", "clearance_m=0.3") for word in ("--set", key))
    assert given(*alone, "--set", "max_tilt_deg=20").body() == Vehicle(1.5, 1.2, 0.3, max_tilt_deg=20.0)
    (tmp_path / "own.toml").write_text("length_m = 2.0\nwidth_m = 1.0\nclearance_m = 0.4\nunknown_passes = true\n")
    words = ("--vehicle", tmp_path / "own.toml")
    assert given(*words).body() == Vehicle(2.0, 1.0, 0.4, unknown_passes=True)
    assert given(*words, "--set", "unknown_passes=false").body() == Vehicle(2.0, 1.0, 0.4)


def test_values_of_the_mobility_can_be_set_one_by_one(given):
    own = load_mobility("large-rover")
    for words in (("--vehicle", "large-rover"), ("--mobility", "large-rover")):
        found = given(*words, "--set", "mobility.energy.mass_kg=77").mobility()
        assert found.energy == replace(own.energy, mass_kg=77.0) and found.time == own.time
    assert given("--set", "mobility.linear.up_per_m=3").body() is None
    with pytest.raises(NnppEdgeError, match="large-rover: mobility: energies is unknown"):
        given("--vehicle", "large-rover", "--set", "mobility.energies.mass_kg=1").mobility()


def test_what_makes_no_vehicle_is_one_line(given):
    for words, complaint in (
        (("--vehicle", "nope"), "large-rover, small-rover, tracked"),
        (("--vehicle", "tracked", "--set", "axles=1"), "1"),
        (("--vehicle", "large-rover", "--set", "clearance_m=400"), "clearance_m must be in metres, at most 9"),
        (("--vehicle", "large-rover", "--set", "max_tilt_deg=0.5"), "max_tilt_deg must be in degrees"),
        (("--set", "clearance"), "wanted KEY=VALUE in TOML, such as clearance_m=0.3, got 'clearance'"),
        (("--set", ""), "wanted KEY=VALUE"),
        (("--set", "axles=2\nlength_m=3"), "wanted KEY=VALUE"),
        (("--set", "a=" + "[" * 5000), "wanted KEY=VALUE"),
        (("--vehicle", "tracked", "--set", "axles='two'"), "axles: wanted a whole number, got 'two'"),
    ):
        with pytest.raises((NnppEdgeError, click.UsageError), match=complaint) as caught:
            given(*words).body()
        assert "\n" not in str(caught.value).replace("\\n", "")


def test_no_number_that_could_overflow_is_set(given):
    for field in fields(Vehicle):
        for number in ("nan", "inf", "-inf", "1e308", "-1e308", "9" * 40, "-1", "1e-400"):
            if field.name == "unknown_passes":
                continue
            with pytest.raises(NnppEdgeError):
                given("--vehicle", "large-rover", "--set", f"{field.name}={number}").body()
