"""Numbers along a way: by hand on ramps, by brute force on rough ground, and where heights are not
known.
"""

import math
import pickle

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from nnpp_edge.runtime import DynamicPlanner, EnergyCost, Mobility, Planner, TimeCost, Vehicle
from nnpp_edge.runtime.map.along import Along, Numbers, heights_at, joined
from tests.strategies import flat, uniform

ROVER = Mobility(
    time=TimeCost((-20.0, 0.0, 20.0), (0.2, 0.4, 0.1)), energy=EnergyCost(50.0, 0.15, 0.8, 0.3)
)


def rough(rows=40, cols=50, seed=1):
    return uniform(seed, (rows, cols), 0.0, 3.0)


def brute(line, heights, sides_m, pieces=4000):
    """Length on the ground, climb and descent of a line over the bilinear ground, cut into many
    short pieces.
    """
    ground = 0.0
    climb = 0.0
    descent = 0.0
    for begin, end in zip(line[:-1], line[1:], strict=True):
        points = begin + np.linspace(0.0, 1.0, pieces)[:, None] * (end - begin)
        rises = np.diff(map_coordinates(heights, points.T, order=1, mode="nearest"))
        ground += np.hypot(np.hypot(*((end - begin) * sides_m)) / (pieces - 1), rises).sum()
        climb = climb + rises[rises > 0].sum()
        descent = descent - rises[rises < 0].sum()
    return ground, climb, descent


def test_a_ramp_up_and_down_again_is_as_long_and_steep_as_it_is_by_hand():
    heights = np.array([[0.0, 3.0, 6.0, 2.0]])
    found = Along.of(
        np.array([(0, 0), (0, 1), (0, 2), (0, 3)], np.int32), heights, (7.0, 4.0), ROVER
    ).numbers
    assert found.length_m == 12.0
    assert found.ground_length_m == pytest.approx(5.0 + 5.0 + math.sqrt(32.0))
    assert (found.climb_m, found.descent_m) == (6.0, 4.0)
    assert found.steepest_up_deg == pytest.approx(math.degrees(math.atan(0.75)))
    assert found.steepest_down_deg == pytest.approx(45.0)
    assert found.time_s == pytest.approx(5.0 / 0.1 + 5.0 / 0.1 + math.sqrt(32.0) / 0.2)
    level = Along.of(np.array([(0, 0), (0, 1)], np.int32), np.zeros((1, 2)), (1.0, 1000.0)).numbers
    assert math.isnan(level.time_s) and math.isnan(level.energy_j)
    weight = 50.0 * 9.80665
    assert found.energy_j == pytest.approx(
        2 * weight * (0.15 * 4 + 3) / 0.8 + 0.3 * weight * (0.15 * 4 - 4)
    )


def test_what_is_summed_along_the_way_ends_with_the_whole_and_back_again_climb_is_descent():
    path = np.array([(r, r) for r in range(30)], np.int32)
    along, back = (Along.of(each, rough(), (2.0, 3.0), ROVER) for each in (path, path[::-1]))
    there = along.numbers
    numbers = back.numbers
    for name, whole in (
        ("distance_m", there.length_m),
        ("ground_m", there.ground_length_m),
        ("time_s", there.time_s),
    ):
        assert getattr(along, name)[0] == 0.0 and getattr(along, name)[-1] == pytest.approx(whole)
    assert there.climb_m - there.descent_m == pytest.approx(
        along.heights_m[-1] - along.heights_m[0]
    )
    assert (there.climb_m, there.descent_m) == pytest.approx((numbers.descent_m, numbers.climb_m))
    assert there.ground_length_m == pytest.approx(numbers.ground_length_m)
    assert there.time_s != pytest.approx(numbers.time_s)


def test_heights_between_middles_are_bilinear_and_an_unknown_cell_matters_only_where_it_weighs():
    heights = np.array([[0.0, 1.0], [2.0, np.nan]])
    assert heights_at(heights, np.array([(0.0, 0.5), (0.5, 0.0), (1.0, 0.0)])) == pytest.approx(
        [0.5, 1.0, 2.0]
    )
    assert np.isnan(heights_at(heights, np.array([(0.5, 0.5)])))[0]


def test_over_unknown_ground_the_way_is_even_from_the_last_known_height_to_the_next():
    heights = np.array([[np.nan, 1.0, np.nan, np.nan, 4.0, np.nan]])
    path = np.column_stack((np.zeros(6, np.int32), np.arange(6, dtype=np.int32)))
    assert Along.of(path, heights, (1.0, 2.0)).heights_m.tolist() == [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    nothing = Along.of(path, heights * np.nan, (1.0, 2.0)).numbers
    assert nothing.length_m == 10.0 and math.isnan(nothing.climb_m) and math.isnan(nothing.time_s)


def test_a_plan_keeps_its_numbers_when_the_ground_changes_and_a_copy_of_the_planner_goes_on_with_its_mobility():
    planner = Planner.of_elevation(
        rough() / 20.0, 1.0, step_cost="time", mobility=ROVER, warn=False
    )
    plan = planner.plan((5, 5), (30, 40))
    before = tuple(plan.numbers)
    copy = pickle.loads(pickle.dumps(planner))
    planner.update_elevation(0, 0, flat(40, 50))
    assert tuple(plan.numbers) == before
    again = copy.plan((5, 5), (30, 40))
    assert (again.cost, again.energy_j) == pytest.approx((plan.cost, plan.energy_j))
    copy.update_elevation(0, 0, flat(40, 50))
    assert (
        copy.plan((5, 5), (30, 40)).cost
        == pytest.approx(planner.plan((5, 5), (30, 40)).cost)
        != plan.cost
    )
    assert planner.plan((5, 5), (30, 40)).climb_m == 0.0


def test_numbers_of_way_points_are_those_of_the_bilinear_ground():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        heights = rough(seed=seed) / 10.0
        line = rng.uniform(0.0, 1.0, (6, 2)) * (39, 49)
        ground, climb, descent = brute(line, heights, (2.0, 3.0))
        found = Along.of(line, heights, (2.0, 3.0)).numbers
        assert found.length_m == pytest.approx(np.hypot(*(np.diff(line, axis=0) * (2, 3)).T).sum())
        # between two places the bilinear ground is about a parabola, which is taken as its chord
        assert found.ground_length_m == pytest.approx(ground, rel=2e-3)
        assert found.climb_m == pytest.approx(climb, rel=0.15) and found.climb_m <= climb + 1e-9
        assert found.descent_m == pytest.approx(descent, rel=0.15)


def test_a_plan_over_elevations_has_their_numbers():
    heights = rough() / 20.0 + 1000.0
    for vehicle in (None, Vehicle(radius_m=1.0), Vehicle(2.0, 2.0, 3.0, 60.0)):
        planner = Planner.of_elevation(
            heights, 2.0, cell_width_m=3.0, vehicle=vehicle, mobility=ROVER, warn=False
        )
        plan = planner.plan((5, 5), (30, 40), method="astar")
        wanted = Along.of(plan.path, heights, (2.0, 3.0), ROVER)
        assert plan.ok and plan.numbers == pytest.approx(wanted.numbers, rel=1e-3)
        assert plan.along.heights_m == pytest.approx(wanted.heights_m, abs=1e-3)
        summary = plan.summary()
        for name in ("climb_m", "descent_m", "time_s", "energy_j", "ground_length_m"):
            assert (
                summary[name]
                == round(getattr(plan, name), 6)
                == round(getattr(plan.numbers, name), 6)
            )
    planner = DynamicPlanner.of_elevation(heights, 1.0, goal=(30, 40), method="astar")
    planner.move((5, 5))
    plan = planner.replan()
    assert plan.climb_m == pytest.approx(
        Along.of(plan.path, heights, (1.0, 1.0)).numbers.climb_m, rel=1e-3
    )


def test_without_a_path_or_heights_there_are_no_numbers_and_one_cell_has_none_but_zeros():
    assert all(map(math.isnan, Along.of(np.empty((0, 2), np.int32), rough(), (1.0, 1.0)).numbers))
    assert set(Along.of(np.array([(3, 3)], np.int32), rough(), (1.0, 1.0), ROVER).numbers) == {0.0}
    assert joined([np.array([(0, 0), (1, 1)]), np.array([(1, 1), (1, 2)])]).tolist() == [
        [0, 0],
        [1, 1],
        [1, 2],
    ]
    plan = Planner(flat(20, 20, 0.1)).plan((1, 1), (15, 15))
    assert plan.along is None and all(map(math.isnan, plan.numbers))
    assert all(plan.summary()[name] is None for name in Numbers._fields)
