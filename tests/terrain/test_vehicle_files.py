"""Vehicles and how they get up and down, from TOML: what is read, and what is refused with which
words.
"""

from dataclasses import fields

import pytest

from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.robots.slope.cost import (
    SLOPE_COSTS,
    EnergyCost,
    IrmischerCost,
    LinearCost,
    Mobility,
    TimeCost,
    ToblerCost,
)
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.vehicle_files import (
    VehicleError,
    load_mobility,
    load_vehicle,
    shipped_vehicles,
)

BODY = "length_m = 1.5\nwidth_m = 1\nclearance_m = 0.3\n"
ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"
TIME = "[mobility.time]\nslope_deg = [-10, 0, 10]\nspeed_m_s = [0.5, 1, 0.25]\n"
WALKER = "[mobility.irmischer]\non_path = true\nfactor = 0.95\n"


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
        assert (
            mobility.time is not None
            and mobility.energy is not None
            and mobility.energy.mass_kg > 1.0
        )


def test_a_vehicle_has_what_stands_in_its_file_and_defaults_else(write_toml):
    found = load_vehicle(write_toml(BODY + "axles = 4\nunknown_passes = true\nmax_roll_deg = 15\n"))
    assert found == Vehicle(1.5, 1.0, 0.3, axles=4, unknown_passes=True, max_roll_deg=15.0)
    assert load_vehicle(str(write_toml(BODY))) == Vehicle(1.5, 1.0, 0.3)
    lines = {
        "unknown_passes": "true",
        "turns_on_spot": "true",
        "axles": "3",
        "length_m": "9.0",
        "width_m": "9.0",
    }
    lines["reserve"] = "0.25"
    lines |= {f"max_{name}_deg": "12.5" for name in ("tilt", "pitch", "roll")}
    names = [field.name for field in fields(Vehicle) if field.name != "radius_m"]
    found = load_vehicle(
        write_toml("\n".join(f"{name} = {lines.get(name, '1.25')}" for name in names))
    )
    assert {getattr(found, name) for name in names} == {True, 3, 9.0, 1.25, 12.5, 0.25}
    assert load_vehicle(write_toml("radius_m = 0.5")) == Vehicle(radius_m=0.5)


def test_a_mobility_has_what_stands_in_its_tables_and_defaults_else(write_toml):
    energy = EnergyCost(50.0, 0.1, recovery=0.5)
    table = TimeCost((-10.0, 0.0, 10.0), (0.5, 1.0, 0.25))
    wanted = Mobility(
        ToblerCost(factor=0.6),
        LinearCost(),
        table,
        energy,
        IrmischerCost(on_path=True, factor=0.95),
    )
    for body in ("", BODY):
        file = write_toml(
            body + ENERGY + "recovery = 0.5\n" + TIME + "[mobility.tobler]\nfactor = 0.6\n" + WALKER
        )
        assert load_mobility(file) == wanted
        assert not body or load_vehicle(file) == load_vehicle(write_toml(body))


def refused(load, file, *words):
    with pytest.raises(VehicleError) as caught:
        load(file)
    message = str(caught.value)
    assert all(word in message for word in ["mine.toml", *words]), message
    assert "\n" not in message and isinstance(caught.value, NnppEdgeError | ValueError)


def test_a_vehicle_that_is_wrong_is_refused_in_one_line(write_toml):
    for text, *words in (
        (BODY + "colour = 1", "colour is unknown", "one of length_m, width_m", "unknown_passes"),
        (BODY + "[wheels]\nlength_m = 1", "wheels is unknown"),
        ("length_m = 1.0\nwidth_m = 1.0", "clearance_m is missing"),
        ("", "length_m is missing"),
        (BODY + "axles = 2.5", "axles: Expected `int`, got `float`"),
        (BODY + "axles = 9", "axles", "2 to 8", "got 9"),
        (BODY.replace("1.5", "true"), "length_m: Expected `float", "got `bool`"),
        (BODY.replace("0.3", "-0.3"), "clearance_m", "-0.3"),
        (BODY.replace("0.3", "300"), "toml: clearance_m must be in metres, ", "got 300"),
        (BODY + "max_tilt_deg = 90", "max_tilt_deg", "(0, 90)", "90"),
        (BODY + "track_m = 1.2", "the wheels must lie under the body", "track_m"),
        (BODY + "length_m = 2", "wanted a vehicle in TOML"),
        (BODY + ENERGY.replace("50", "-50"), "mobility: energy", "mass_kg"),
    ):
        refused(load_vehicle, write_toml(text), *words)
    for name in ("nope", "", "/", "a\0b", "../quick"):
        with pytest.raises(VehicleError, match="large-rover, small-rover, tracked") as caught:
            load_vehicle(name)
        assert repr(name) in str(caught.value)


def test_a_mobility_that_is_wrong_is_refused_in_one_line(write_toml):
    for text, *words in (
        (BODY, "wanted a table [mobility], got none"),
        (BODY + "mobility = 3", "mobility: Expected `object`, got `int`"),
        ("[mobility]\nfuel = 1", "mobility: fuel is unknown", ", ".join(SLOPE_COSTS)),
        ("[mobility]\ntime = 1", "mobility: time: Expected `object | null`, got `int`"),
        (ENERGY + "colour = 1", "mobility.energy: colour is unknown", "mass_kg"),
        (
            ENERGY.replace("50", "-50"),
            "mobility: energy",
            "mass_kg must be a number above 0, got -50",
        ),
        (
            "[mobility.energy]\nmass_kg = 50",
            "mobility: energy: Object missing required field `rolling_resistance`",
        ),
        (TIME.replace("0.25", "true"), "mobility: time.speed_m_s[2]: Expected `float`, got `bool`"),
        (TIME.replace("[-10, 0, 10]", "[-0.5, 0.0, 0.35]"), "slope_deg must be in degrees"),
        (
            WALKER + "path = true",
            "mobility.irmischer: path is unknown: wanted one of on_path, factor",
        ),
    ):
        refused(load_mobility, write_toml(text), *words)
