"""Vehicles and how they get up and down, from TOML: what is read, and what is refused with which
words.
"""

import pytest

from nnpp_edge.runtime import (
    EnergyCost,
    LinearCost,
    Mobility,
    TimeCost,
    ToblerCost,
    Vehicle,
)
from nnpp_edge.terrain.vehicle_files import (
    VehicleError,
    load_mobility,
    load_vehicle,
    shipped_vehicles,
)
from tests.tables import cases

BODY = "length_m = 1.5\nwidth_m = 1\nclearance_m = 0.3\n"
ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"
TIME = "[mobility.time]\nslope_deg = [-10, 0, 10]\nspeed_m_s = [0.5, 1, 0.25]\n"
WALKER = "[mobility.tobler]\nfactor = 0.6\n"


def test_what_is_shipped_can_be_read():
    assert shipped_vehicles() == ["large-rover", "small-rover", "tracked"]
    small, large, tracked = map(load_vehicle, ("small-rover", "large-rover", "tracked"))
    assert small.length_m < tracked.length_m < large.length_m
    assert (small.axles, large.axles, large.max_tilt_deg) == (3, 3, 30.0)
    spacing = tracked.stance_m[0] / (tracked.axles - 1)
    patch, _ = tracked.contact_m
    assert spacing == pytest.approx(patch)  # a track without gaps
    for name in shipped_vehicles():
        mobility = load_mobility(name)
        assert mobility.time is not None and mobility.energy.mass_kg > 1.0


def test_a_vehicle_has_what_stands_in_its_file_and_defaults_else(write_toml):
    found = load_vehicle(write_toml(BODY + "axles = 4\nunknown_passes = true\nmax_roll_deg = 15\n"))
    assert found == Vehicle(1.5, 1.0, 0.3, axles=4, unknown_passes=True, max_roll_deg=15.0)
    assert load_vehicle(str(write_toml(BODY))) == Vehicle(1.5, 1.0, 0.3)
    assert load_vehicle(write_toml("radius_m = 0.5")) == Vehicle(radius_m=0.5)


def test_a_mobility_has_what_stands_in_its_tables_and_defaults_else(write_toml):
    energy = EnergyCost(50.0, 0.1, recovery=0.5)
    table = TimeCost((-10.0, 0.0, 10.0), (0.5, 1.0, 0.25))
    wanted = Mobility(ToblerCost(factor=0.6), LinearCost(), table, energy)
    tables = ENERGY + "recovery = 0.5\n" + TIME + WALKER
    assert load_mobility(write_toml(tables)) == wanted
    beside = write_toml(BODY + tables)
    assert load_mobility(beside) == wanted
    assert load_vehicle(beside) == load_vehicle(write_toml(BODY))


REFUSED = r"""
vehicle | BODY colour = 1                | colour is unknown | one of length_m, width_m | unknown_passes
vehicle | BODY [wheels]\nlength_m = 1    | wheels is unknown
vehicle | length_m = 1.0\nwidth_m = 1.0  | clearance_m is missing
vehicle |                                | length_m is missing
vehicle | BODY axles = 2.5               | axles: Expected int, got 2.5
vehicle | BODY axles = 9                 | axles | 2 to 8 | got 9
vehicle | length_m = true\nwidth_m = 1\nclearance_m = 0.3 | length_m: Expected float | got True
vehicle | length_m = 1.5\nwidth_m = 1\nclearance_m = -0.3 | clearance_m | -0.3
vehicle | length_m = 1.5\nwidth_m = 1\nclearance_m = 300  | toml: clearance_m must be in metres, | got 300
vehicle | BODY max_tilt_deg = 90         | max_tilt_deg | below 90 | got 90
vehicle | BODY track_m = 1.2             | the wheels must lie under the body | track_m
vehicle | BODY length_m = 2              | wanted a vehicle in TOML
vehicle | BODY [mobility.energy]\nmass_kg = -50\nrolling_resistance = 0.1 | mobility: energy | mass_kg
mobility | BODY                           | wanted a table [mobility], got none
mobility | BODY mobility = 3              | mobility: Expected object, got 3
mobility | [mobility]\nfuel = 1           | mobility: fuel is unknown | tobler, linear, time, energy
mobility | [mobility]\ntime = 1           | mobility: time: Expected object | null, got 1
mobility | ENERGY colour = 1              | mobility.energy: colour is unknown | mass_kg
mobility | [mobility.energy]\nmass_kg = 50 | mobility: energy: | missing required field rolling
mobility | [mobility.energy]\nmass_kg = -50\nrolling_resistance = 0.1 | energy | mass_kg must be | got -50
mobility | [mobility.time]\nslope_deg = [-10, 0]\nspeed_m_s = [1, true] | time.speed_m_s[1]: Expected float, got True
mobility | [mobility.time]\nslope_deg = [-0.5, 0.35]\nspeed_m_s = [1, 1] | slope_deg must be in degrees
mobility | WALKER path = true             | mobility.tobler: path is unknown: wanted one of top_speed_km_h, steepness, best_slope, factor
"""
"""What is read, what its file holds, and words of the refusal."""
READ = {"vehicle": load_vehicle, "mobility": load_mobility}


@pytest.mark.parametrize(("what", "text", "words"), cases(REFUSED, 3))
def test_what_is_wrong_is_refused_in_one_line(what, text, words, write_toml):
    text = text.replace("BODY", BODY).replace("ENERGY", ENERGY).replace("WALKER", WALKER)
    with pytest.raises(VehicleError) as caught:
        READ[what](write_toml(text))
    message = str(caught.value)
    assert [each for each in ["mine.toml", *words.split(" | ")] if each not in message] == []
    assert "\n" not in message


@pytest.mark.parametrize("name", ["nope", "", "/", "a\0b", "../quick"])
def test_a_name_of_no_vehicle_is_refused_with_those_there_are(name):
    with pytest.raises(VehicleError, match="large-rover, small-rover, tracked") as caught:
        load_vehicle(name)
    assert repr(name) in str(caught.value)
