from dataclasses import fields, replace

import click
import pytest
from click.testing import CliRunner

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.vehicle_files import VehicleError, load_vehicle


@pytest.fixture
def make():
    """What a command with these options makes of words on its command line."""

    def make(*words):
        made = []

        @click.command()
        @vehicle_options.vehicle
        @options.seed
        def drive(vehicle, seed):
            made.append(vehicle.make())

        ended = CliRunner().invoke(drive, [str(word) for word in words], standalone_mode=False)
        if ended.exception is not None:
            raise ended.exception
        return made[0]

    return make


def test_no_option_is_no_vehicle(make):
    assert make() is None and make("--seed", 3) is None


def test_a_vehicle_by_name_or_file(make, tmp_path):
    assert make("--vehicle", "large-rover") == load_vehicle("large-rover")
    (tmp_path / "own.toml").write_text("length_m = 2.0\nwidth_m = 1.0\nclearance_m = 0.4\n")
    assert make("--vehicle", tmp_path / "own.toml") == Vehicle(2.0, 1.0, 0.4)


def test_every_value_can_be_set_in_place_of_the_vehicles_own(make):
    own = load_vehicle("large-rover")
    names = {"length_m": "--vehicle-length", "width_m": "--vehicle-width"}
    for field in fields(Vehicle):
        option = names.get(field.name, "--" + field.name.removesuffix("_m").removesuffix("_deg").replace("_", "-"))
        if field.name == "radius_m":
            assert make("--radius", 0.5) == Vehicle(radius_m=0.5)
            continue
        if field.name == "unknown_passes":
            assert make("--vehicle", "large-rover", option) == replace(own, unknown_passes=True)
            continue
        value = {"axles": 4, "length_m": 3.5, "width_m": 3.5, "wheel_width_m": 0.3}.get(field.name, 0.5)
        value = 20.0 if field.name.endswith("_deg") else value
        assert make("--vehicle", "large-rover", option, value) == replace(own, **{field.name: value}), field.name


def test_a_value_in_millimetres_or_radians_is_refused(make):
    with pytest.raises(VehicleError, match="large-rover: clearance_m must be in metres, at most 9"):
        make("--vehicle", "large-rover", "--clearance", 400)
    with pytest.raises(VehicleError, match="max_tilt_deg must be in degrees"):
        make("--vehicle", "large-rover", "--max-tilt", 0.5)


def test_what_a_file_says_of_unknown_cells_can_be_taken_back(make, tmp_path):
    (tmp_path / "own.toml").write_text("length_m = 2.0\nwidth_m = 1.0\nclearance_m = 0.4\nunknown_passes = true\n")
    assert make("--vehicle", tmp_path / "own.toml").unknown_passes
    assert not make("--vehicle", tmp_path / "own.toml", "--unknown-fails").unknown_passes


def test_values_make_a_vehicle_by_themselves(make):
    words = ("--vehicle-length", 1.5, "--vehicle-width", 1.2, "--clearance", 0.3)
    assert make(*words, "--max-tilt", 20) == Vehicle(1.5, 1.2, 0.3, max_tilt_deg=20.0)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--vehicle", "nope"), "large-rover, small-rover, tracked"),
        (("--clearance", 0.3), "length_m is missing"),
        (("--vehicle", "tracked", "--max-tilt", 90), "90"),
        (("--vehicle", "tracked", "--max-tilt", "nan"), "nan"),
        (("--vehicle", "tracked", "--clearance", -1), "-1"),
        (("--vehicle", "tracked", "--axles", 1), "1"),
        (("--vehicle", "tracked", "--track", 5), "under the body"),
    ],
)
def test_what_makes_no_vehicle_is_one_line(make, words, complaint):
    with pytest.raises((NnppEdgeError, click.UsageError), match=complaint) as caught:
        make(*words)
    assert "\n" not in str(caught.value)
