import pytest

from nnpp_edge.runtime.map.slope_cost import (
    SLOPE_COSTS,
    EnergyCost,
    IrmischerCost,
    LinearCost,
    Mobility,
    TimeCost,
    ToblerCost,
)
from nnpp_edge.terrain.vehicle_files import VehicleError, load_mobility, load_vehicle, shipped_vehicles

BODY = "length_m = 1.5\nwidth_m = 1\nclearance_m = 0.3\n"
ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"
TIME = "[mobility.time]\nslope_deg = [-10, 0, 10]\nspeed_m_s = [0.5, 1, 0.25]\n"
WALKER = "[mobility.irmischer]\non_path = true\nfactor = 0.95\n"


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "mine.toml").write_text(text)
        return tmp_path / "mine.toml"

    return write


@pytest.mark.parametrize("body", ["", BODY])
def test_a_mobility_has_what_stands_in_its_tables_and_defaults_else(write, body):
    file = write(body + ENERGY + "recovery = 0.5\n" + TIME + "[mobility.tobler]\nfactor = 0.6\n" + WALKER)
    energy = EnergyCost(50.0, 0.1, recovery=0.5)
    table = TimeCost((-10.0, 0.0, 10.0), (0.5, 1.0, 0.25))
    assert load_mobility(file) == Mobility(
        ToblerCost(factor=0.6), LinearCost(), table, energy, IrmischerCost(on_path=True, factor=0.95)
    )
    if body:
        assert load_vehicle(file) == load_vehicle(write(body))


def test_shipped_vehicles_have_every_model():
    for name in shipped_vehicles():
        mobility = load_mobility(name)
        assert mobility.time is not None and mobility.energy is not None and mobility.energy.mass_kg > 1.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BODY, ["wanted a table [mobility], got none"]),
        (BODY + "mobility = 3", ["mobility: wanted a table, got 3"]),
        ("[mobility]\nfuel = 1", ["mobility: fuel is unknown", ", ".join(SLOPE_COSTS)]),
        ("[mobility]\ntime = 1", ["mobility.time: wanted a table, got 1"]),
        (ENERGY + "colour = 1", ["mobility.energy: colour is unknown", "mass_kg"]),
        (ENERGY.replace("50", "-50"), ["mobility.energy", "mass_kg must be a number above 0, got -50"]),
        (ENERGY + "recovery = 1.5", ["recovery must lie from 0 to 1, got 1.5"]),
        (ENERGY + "recovery = '1'", ["mobility.energy.recovery: wanted a number, got '1'"]),
        ("[mobility.energy]\nmass_kg = 50", ["mobility.energy.rolling_resistance is missing"]),
        (TIME.replace("0.25", "true"), ["mobility.time.speed_m_s.2: wanted a number, got True"]),
        (TIME.replace("[0.5, 1, 0.25]", "1"), ["mobility.time.speed_m_s: wanted numbers in brackets, got 1"]),
        (TIME.replace("0.25", "0"), ["speed_m_s must be positive"]),
        (WALKER.replace("true", "1"), ["mobility.irmischer.on_path: wanted true or false, got 1"]),
        (WALKER + "path = true", ["mobility.irmischer: path is unknown: wanted one of on_path, factor"]),
        (WALKER.replace("0.95", "0"), ["mobility.irmischer: factor must be a number above 0, got 0"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line(write, text, words):
    with pytest.raises(VehicleError) as caught:
        load_mobility(write(text))
    assert all(word in str(caught.value) for word in ["mine.toml", *words]), str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_vehicle_with_a_mobility_that_is_wrong_is_refused(write):
    with pytest.raises(VehicleError, match=r"mine\.toml: mobility\.energy.*mass_kg"):
        load_vehicle(write(BODY + ENERGY.replace("50", "-50")))
