"""Step costs by the slope: published values, and the table by which they are priced."""

import math

import numpy as np
import pytest

from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.robots.slope.cost import (
    EnergyCost,
    LinearCost,
    TimeCost,
    ToblerCost,
)
from nnpp_edge.runtime.robots.slope.directed import DirectedPrice
from nnpp_edge.runtime.terrain.step_cost import StepModel

TABLE = TimeCost((-20.0, -5.0, 0.0, 12.0), (0.3, 0.9, 0.8, 0.2))
ROVER = EnergyCost(
    180.0, 0.15, efficiency=0.6, recovery=0.4, gravity_m_s2=3.71, idle_w=45.0, speed_m_s=0.05
)
MODELS = [
    ToblerCost(),
    ToblerCost(best_slope=0.2),
    ToblerCost(best_slope=0.0),
    LinearCost(),
    LinearCost(1.0, 1.0, -3.0),
    LinearCost(1.0, 1.0, 2.0, 4.0),
    TABLE,
    ROVER,
    EnergyCost(20.0, 0.02),
]
SLOPES = np.concatenate(
    (
        np.linspace(-3.0, 3.0, 6001),
        [-0.2125, -0.05, 0.0, math.tan(math.radians(-5.0)), -200.0, 200.0],
    )
)

NEAR = 5e-5
"""By what share a table may be off."""


def test_tobler_is_what_was_published():
    for degrees, km_h, seconds in (  # as they are printed
        (-40.0, 0.38, 9.50),
        (-20.0, 2.00, 1.80),
        (-5.0, 5.26, 0.68),
        (-2.8624, 6.00, 0.60),
        (0.0, 5.04, 0.71),
        (1.0, 4.74, 0.76),
        (10.0, 2.72, 1.32),
        (30.0, 0.67, 5.39),
    ):
        slope = math.tan(math.radians(degrees))
        found = float(ToblerCost().cost(1.0, slope))
        assert found == pytest.approx(seconds, abs=0.0051) and 3.6 / found == pytest.approx(
            km_h, abs=0.0051
        )
        assert found == pytest.approx(0.6 * math.exp(3.5 * abs(slope + 0.05)), rel=NEAR)
        assert float(ToblerCost(factor=0.6).cost(7.0, 7.0 * slope)) == pytest.approx(
            7.0 * found / 0.6, rel=1e-12
        )


def test_linear_is_r_walk():
    """As it has it for a cell's neighbour: `a` a metre on the map, then `b` up, `c` down and `d`
    steeply down.
    """
    a = 0.72
    b = 6.0
    c = 1.9998
    d = -1.9998
    for slope in (-1.7, -0.5, -0.22, -0.2125, -0.2, -0.1, 0.0, 0.02, 0.1, 1.0):
        wanted = 100.0 * (a + slope * (b if slope >= 0 else d if slope < -0.2125 else c))
        assert float(LinearCost().cost(100.0, 100.0 * slope)) == pytest.approx(wanted, abs=1e-6)
    assert math.degrees(math.atan(LinearCost().steep_slope)) == pytest.approx(-12.0, abs=0.01)
    plain = LinearCost(1.0, 2.0, 3.0, 3.0)  # a metre up and one down cost alike on every slope
    assert plain.cost([1.0, 1.0, 1.0], [0.0, 5.0, -5.0]) == pytest.approx([1.0, 11.0, 16.0])


def test_a_rover_needs_its_ground_divided_by_its_speed_there():
    for degrees, speed in [
        (-20.0, 0.3),
        (-40.0, 0.3),
        (-12.5, 0.6),
        (0.0, 0.8),
        (6.0, 0.5),
        (12.0, 0.2),
        (30.0, 0.2),
    ]:
        rise = 10.0 * math.tan(math.radians(degrees))
        assert float(TABLE.cost(10.0, rise)) == pytest.approx(
            math.hypot(10.0, rise) / speed, rel=NEAR
        )


def test_energy_is_drawn_up_and_got_back_down():
    weight = 180.0 * 3.71
    idle = EnergyCost(180.0, 0.15, idle_w=45.0, speed_m_s=0.05, gravity_m_s2=3.71).cost(10.0, -1.5)
    assert float(idle) == pytest.approx(900.0 * math.hypot(10.0, 1.5), rel=NEAR)  # it just rolls
    ground = 900.0 * math.hypot(10.0, 2.0)
    assert float(ROVER.cost(10.0, 2.0)) == pytest.approx(weight * 3.5 / 0.6 + ground)
    assert float(ROVER.cost(10.0, -2.0)) == pytest.approx(-0.4 * weight * 0.5 + ground)
    whole = EnergyCost(10.0, 0.1, recovery=1.0)
    assert float(whole.cost(100.0, -50.0) + whole.cost(100.0, 50.0)) == pytest.approx(
        2 * 10.0 * 9.80665 * 10.0
    )
    assert float(whole.cost(1.0, -1.0)) < 0.0


@pytest.mark.parametrize("model", [*MODELS, TimeCost((0.0,), (2.0,))], ids=repr)
def test_steps_cost_what_ways_do_near_the_function_and_no_metre_is_cheaper_than_the_cheapest(model):
    metres = model.cost(1.0, SLOPES) - model.height_price * SLOPES
    assert metres.min() >= model.least_per_m * (1.0 - 1e-12) > 0.0
    assert metres.min() == pytest.approx(model.least_per_m, rel=1e-5)
    slopes = np.append(SLOPES, [-1e6, 1e6])
    for price in model.height_price + np.array(
        [-1e-3, 1e-3]
    ):  # by no other does the cheapest metre cost more
        assert (model.cost(1.0, slopes) - price * slopes).min() <= model.least_per_m * (1.0 + 1e-5)
    exact = model.per_m(SLOPES[:6004])
    found = model.cost(1.0, SLOPES[:6004])
    assert (np.abs(found - exact) <= NEAR * np.abs(exact) + 1e-9).all()
    length = np.full((3, 2), 1.7)
    rise = np.linspace(-1.0, 1.0, 6).reshape(3, 2)
    one_by_one = [[float(model.cost(1.7, float(r))) for r in row] for row in rise]
    assert model.cost(length, rise).tolist() == one_by_one == model.cost(1.7, rise).tolist()
    assert 2.0 * model.cost(length / 2.0, rise / 2.0) == pytest.approx(model.cost(length, rise))
    assert np.ndim(model.cost(1.0, 1.0)) == 0
    dem = np.array([[0.0], [1.0]]) * SLOPES[::20].astype(np.float32)
    dem = np.concatenate((dem, dem, dem))[:, np.newaxis].reshape(6, -1).astype(np.float32)
    sides = 1.0, 0.7
    grid = Grid(
        *dem.shape,
        StepModel.of("paper"),
        weights=np.zeros((len(dem) + 2) * (len(dem[0]) + 2), np.float32),
    )
    steps = DirectedPrice(dem, sides, model, grid).padded[1:-1, 1:-1]
    rated = model.ground(dem, sides)
    ground = rated.astype(np.float64) if rated.size else np.ones(dem.shape)
    for k, (up, left) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
        here = dem[1:-1, 1:-1].astype(np.float64)
        there = np.roll(dem, (-up, -left), (0, 1))[1:-1, 1:-1]
        ways = model.cost(math.hypot(up * sides[0], left * sides[1]), there - here)
        ways = ways * (ground + np.roll(ground, (-up, -left), (0, 1)))[1:-1, 1:-1] / 2.0
        assert steps[1:-1, 1:-1, k] == pytest.approx(
            ways - model.height_price * (there - here), rel=1e-6
        ), k


def test_a_table_has_its_jump_where_the_model_has():
    for steep in (-0.25, -0.2125):  # on a knot, and between two
        model = LinearCost(steep_slope=steep)
        at = np.array([steep - 1e-9, steep, steep + 1e-9])
        assert model.cost(1.0, at) == pytest.approx(
            [0.72 - 1.9998 * steep, *[0.72 + 1.9998 * steep] * 2]
        )
