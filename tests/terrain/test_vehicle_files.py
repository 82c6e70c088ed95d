from dataclasses import fields

import pytest

from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.vehicle_files import VehicleError, load_mobility, load_vehicle, shipped_vehicles

GOOD = "length_m = 1.5\nwidth_m = 1\nclearance_m = 0.3\n"


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "mine.toml").write_text(text)
        return tmp_path / "mine.toml"

    return write


def test_what_is_shipped_can_be_read():
    assert shipped_vehicles() == ["large-rover", "small-rover", "tracked"]
    small, large, tracked = map(load_vehicle, ("small-rover", "large-rover", "tracked"))
    assert small.length_m < tracked.length_m < large.length_m
    assert (small.axles, large.axles, large.max_tilt_deg) == (3, 3, 30.0)
    spacing, (patch, _) = tracked.stance_m[0] / (tracked.axles - 1), tracked.contact_m
    assert spacing == pytest.approx(patch)  # a track without gaps


def test_a_vehicle_has_what_stands_in_its_file_and_defaults_else(write):
    found = load_vehicle(write(GOOD + "axles = 4\nunknown_passes = true\nmax_roll_deg = 15\n"))
    assert found == Vehicle(1.5, 1.0, 0.3, axles=4, unknown_passes=True, max_roll_deg=15.0)
    assert load_vehicle(str(write(GOOD))) == Vehicle(1.5, 1.0, 0.3)


def test_every_value_can_stand_in_a_file(write):
    lines = {"unknown_passes": "true", "axles": "3", "length_m": "9.0", "width_m": "9.0"}
    lines |= {f"max_{name}_deg": "12.5" for name in ("tilt", "pitch", "roll")}
    names = [field.name for field in fields(Vehicle) if field.name != "radius_m"]
    found = load_vehicle(write("\n".join(f"{name} = {lines.get(name, '1.25')}" for name in names)))
    assert {getattr(found, name) for name in names} == {True, 3, 9.0, 1.25, 12.5}
    assert load_vehicle(write("radius_m = 0.5")) == Vehicle(radius_m=0.5)


def test_a_file_in_millimetres_or_radians_is_refused_with_the_unit_that_is_wanted(write):
    with pytest.raises(VehicleError, match=r"toml: clearance_m must be in metres, .*got 300"):
        load_vehicle(write("length_m = 1.5\nwidth_m = 1.0\nclearance_m = 300"))
    with pytest.raises(VehicleError, match=r"slope_deg must be in degrees"):
        load_mobility(write("[mobility.time]\nslope_deg = [-0.5, 0.0, 0.35]\nspeed_m_s = [1.0, 1.0, 0.5]"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD + "colour = 1", ["colour is unknown", "one of length_m, width_m", "unknown_passes"]),
        (GOOD + "[wheels]\nlength_m = 1", ["wheels is unknown"]),
        ("length_m = 1.0\nwidth_m = 1.0", ["clearance_m is missing"]),
        ("", ["length_m is missing"]),
        (GOOD + "axles = 2.5", ["axles: wanted a whole number, got 2.5"]),
        (GOOD + "axles = true", ["axles: wanted a whole number, got True"]),
        (GOOD + "axles = 9", ["axles", "2 to 8", "got 9"]),
        (GOOD + "track_m = '1'", ["track_m: wanted a number, got '1'"]),
        (GOOD + "track_m = [1]", ["track_m: wanted a number, got [1]"]),
        (GOOD.replace("1.5", "true"), ["length_m: wanted a number, got True"]),
        (GOOD + "unknown_passes = 1", ["unknown_passes: wanted true or false, got 1"]),
        (GOOD.replace("0.3", "-0.3"), ["clearance_m", "-0.3"]),
        (GOOD.replace("0.3", "nan"), ["clearance_m", "nan"]),
        (GOOD + "max_tilt_deg = 90", ["max_tilt_deg", "(0, 90)", "90"]),
        (GOOD + "track_m = 1.2", ["the wheels must lie under the body", "track_m"]),
        (GOOD + "length_m = 2", ["wanted a vehicle in TOML"]),
        ("length_m = ", ["wanted a vehicle in TOML"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line(write, text, words):
    with pytest.raises(VehicleError) as caught:
        load_vehicle(write(text))
    message = str(caught.value)
    assert all(word in message for word in ["mine.toml", *words]), message
    assert "\n" not in message and isinstance(caught.value, NnppEdgeError | ValueError)


@pytest.mark.parametrize("name", ["nope", "", "/", "a\0b", "../quick"])
def test_no_such_vehicle_names_those_that_there_are(name):
    with pytest.raises(VehicleError, match="large-rover, small-rover, tracked") as caught:
        load_vehicle(name)
    assert repr(name) in str(caught.value)
