"""Eq. 1, of whole maps and where a search looks. Many more maps are tried by
`tests.fuzz.elevations`.
"""

import copy
import dataclasses
import math
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicPlanner, Goal, Ground, Navigator, Planner, Pose
from nnpp_edge.runtime.kernels.traversability import RULE_SLOTS
from nnpp_edge.runtime.options import LAYER_TERMS, TERMS
from nnpp_edge.runtime.terrain.traversability import (
    SaturationWarning,
    Traversability,
    terrain_terms,
    traversability_cost,
)
from tests import oracles
from tests.strategies import flat


@st.composite
def dems(draw):
    """Small maps, and every fifth time one of rows long enough to be computed several cells at
    once.
    """
    shape = draw(st.sampled_from([(9, 9)] * 4 + [(5, 120)]))
    shape = tuple(draw(st.integers(1, most)) for most in shape)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    dem = rng.normal(
        draw(st.sampled_from([0.0, -5000.0])), draw(st.sampled_from([0.05, 1.0, 30.0])), shape
    )
    dem[rng.random(shape) < draw(st.sampled_from([0.0, 0.02, 0.2, 0.6]))] = draw(
        st.sampled_from([np.nan, np.inf])
    )
    return dem.astype(np.float32)


CELLS = [(1.0, 1.0), (20.0, 20.0), (2.0, 1.7)]
LIMITS = [
    Traversability(),
    Traversability(slope_limit_deg=15, hard_slope_deg=15),
    Traversability(step_limit_m=5, roughness_limit_m=8, hard_step_m=4, hard_roughness_m=7),
    Traversability(slope_weight=0.2, roughness_weight=0.3, step_weight=0.5, slope_limit_deg=80),
    Traversability.safe(slope_limit_deg=40, step_limit_m=5),
    Traversability(hard_gradient_deg=12),
]


@given(
    dems(),
    st.sampled_from(LIMITS),
    st.sampled_from(CELLS),
    st.sampled_from("fdFTs"),
)
def test_the_cost_equals_the_oracles_whatever_the_layout(dem, limits, cell, layout):
    if layout not in "fF":
        dem = dem.astype(np.float64)
    given = {
        "F": np.asfortranarray(dem),
        "T": np.ascontiguousarray(dem.T).T,
        "s": np.repeat(dem, 2, 1)[:, ::2],
    }
    found = traversability_cost(
        given.get(layout, dem), cell[0], limits, cell_width_m=cell[1], warn=False
    )
    wanted = oracles.traversability(dem, *cell, limits)
    assert found.dtype == np.float32
    near_a_limit = np.isfinite(found) != np.isfinite(wanted)
    assert near_a_limit.mean() <= (1e-3 if dem.size > 100 else 0.0)
    known = np.isfinite(found) & np.isfinite(wanted)
    np.testing.assert_allclose(found[known], wanted[known], atol=2e-5)


def test_heights_in_float64_keep_their_millimetres_and_large_maps_are_computed_in_bands_that_meet(
    monkeypatch,
):
    dem = np.random.default_rng(1).normal(0.0, 0.05, (70, 90))
    low = traversability_cost(dem, 1.0, warn=False)
    np.testing.assert_allclose(traversability_cost(dem + 2.0**23, 1.0, warn=False), low, atol=1e-5)
    monkeypatch.setattr("nnpp_edge.runtime.bands.THREADS_FROM", 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(3))
    np.testing.assert_array_equal(traversability_cost(dem, 1.0, warn=False), low)


def test_by_hand_a_plane_costs_its_slope_a_spike_steps_and_unknown_cells_are_impassable():
    row, _ = np.mgrid[:6, :7]
    plane = (row * 2.0 * math.tan(math.radians(12)) + 900).astype(np.float32)
    slope, roughness, step, *_ = terrain_terms(plane, 2.0)
    np.testing.assert_allclose(np.degrees(slope), 12, atol=1e-3)
    assert max(roughness.max(), step.max()) < 1e-4
    np.testing.assert_allclose(traversability_cost(plane, 2.0), 0.6 * 12 / 30, atol=1e-4)
    dem = flat(5, 5)
    dem[2, 2] = 0.09
    _, roughness, step, *_ = terrain_terms(dem, 1.0)
    assert step[2, 2] == pytest.approx(0.08, rel=1e-5)
    assert roughness[2, 2] == pytest.approx(math.sqrt((0.08**2 + 8 * 0.01**2) / 9), rel=1e-5)
    dem[2, 2] = 0.0
    dem[4, 4] = np.nan
    dem[0, 0] = np.inf
    assert np.argwhere(np.isinf(traversability_cost(dem, 1.0))).tolist() == [[0, 0], [4, 4]]
    ragged = np.where(np.indices((6, 6)).sum(axis=0) % 3 == 0, 50.0, 0.0).astype(np.float32)
    assert np.isinf(traversability_cost(ragged, 1.0, warn=False)).any()


@pytest.mark.parametrize("along", np.indices((6, 6)), ids=["rows", "columns"])
def test_a_steep_step_shuts_the_cells_on_both_its_sides_at_the_border_too(along):
    dem = np.where(along < 3, np.float32(0.0), np.float32(0.3))
    shut = np.isinf(traversability_cost(dem, 1.0, Traversability(hard_gradient_deg=12)))
    assert np.array_equal(shut, (along == 2) | (along == 3))


def test_every_term_has_its_place_in_the_kernels_and_its_limits():
    names = [name for term in (*TERMS, *LAYER_TERMS) for name in term[2:]]
    fields = {field.name for field in dataclasses.fields(Traversability)}
    assert len(Traversability().rule(1.0, 1.0)) == RULE_SLOTS
    assert fields == {*names, "hard_gradient_deg"} and len(names) == len(set(names))


def test_more_than_half_saturated_is_said_by_term():
    rough = np.random.default_rng(0).normal(0, 3, (40, 40)).astype(np.float32)
    with pytest.warns(SaturationWarning) as caught:
        traversability_cost(rough, 20.0)
    (told,) = caught
    assert (
        "raise roughness_limit_m and step_limit_m (" in str(told.message)
        and told.filename == __file__
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traversability_cost(rough, 20.0, Traversability(step_limit_m=20, roughness_limit_m=20))


SIDE = 300
ROW, COL = np.mgrid[:SIDE, :SIDE]
HILLS = (4.0 * np.sin(ROW / 23.0) * np.cos(COL / 31.0)).astype(np.float32)
ENDS = (20, 30), (60, 80)


def planner_on(lazy=True, dem=HILLS, **options):
    return Planner.of_elevation(dem, 1.0, lazy=lazy, warn=False, **options)


def test_nothing_is_computed_before_somebody_looks():
    ours = planner_on()
    assert ours.state.costs_computed == 0.0
    plan = ours.plan(*ENDS, method="astar")
    assert plan.ok and 0.0 < plan.costs_computed < 0.5
    assert planner_on(lazy=False).plan(*ENDS, method="astar").costs_computed == 1.0
    assert Planner(traversability_cost(HILLS, 1.0, warn=False)).plan(*ENDS).costs_computed == 1.0


def test_heights_relative_to_a_base_stay_so_in_patches():
    high = HILLS.astype(np.float64) + 2.0**23
    ours = planner_on(dem=high)
    assert ours.plan(*ENDS, method="astar").cost == pytest.approx(
        planner_on().plan(*ENDS, method="astar").cost, rel=1e-5
    )
    ours.update_elevation(30, 30, high[30:50, 30:60])
    np.testing.assert_allclose(ours.state.grid.map(), planner_on(False).state.grid.map(), atol=1e-4)


def test_a_saturated_map_warns_once_it_arrives():
    with pytest.warns(SaturationWarning, match="raise slope_limit_deg") as caught:
        Planner.of_elevation(
            HILLS * 100.0, 1.0, Traversability(step_limit_m=1e6, roughness_limit_m=1e6)
        )
    assert caught[0].filename == __file__


def test_a_copy_has_the_elevations_as_they_are_now():
    dem = HILLS.copy()
    ours = planner_on(dem=dem)
    dem[:] = np.nan  # they are copied
    assert ours.plan(*ENDS).ok
    ours.update_elevation(40, 40, np.full((9, 9), 90.0))
    for copied in (copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))):
        other = copied(ours)
        assert other.state.costs_computed == 0.0
        assert other.plan(*ENDS, method="astar").cost == ours.plan(*ENDS, method="astar").cost
        other.update_elevation(40, 40, HILLS[40:49, 40:49])
        assert ours.state.grid.map()[44, 40] > other.state.grid.map()[44, 40]


def cliff(rise):
    dem = flat(64, 90)
    dem[:, 45:] = rise
    return dem


OVER = (30, 5), (30, 80)


def of_elevation(dem):
    return Planner.of_elevation(dem, 1.0).plan(*OVER).status


def of_ground(dem):
    return Planner(Ground(elevation=dem, cell_size_m=1.0)).plan(*OVER).status


def of_coarse(dem):
    planner = DynamicPlanner.of_coarse(dem[::2, ::2], 2.0, 2, OVER[1], prior="slope")
    planner.update_elevation(0, 0, dem)
    planner.move(OVER[0])
    return planner.replan().status


def by_the_loop(dem):
    navigator = Navigator(Ground.of_elevation(dem, 1.0))
    navigator.offer(Pose(*OVER[0]))
    navigator.offer(Goal(*OVER[1]))
    return navigator.tick().outcome


@pytest.mark.parametrize("rise", [5.0, 0.9], ids=["cliff", "one step of more than 30°"])
@pytest.mark.parametrize("status", [of_elevation, of_ground, of_coarse, by_the_loop])
def test_no_path_leads_over_a_cliff_unless_the_papers_cost_is_asked_for(status, rise):
    assert status(cliff(0.5)) == "OK"
    assert status(cliff(rise)) == "NO_PATH"
    assert Planner.of_elevation(cliff(rise), 1.0, Traversability()).plan(*OVER).ok


def test_safe_limits_follow_the_limit_of_slope_unless_others_are_given():
    safe = Traversability.safe(slope_limit_deg=22.0)
    assert (safe.hard_slope_deg, safe.hard_gradient_deg) == (22.0, 22.0)
    assert Traversability.safe(hard_slope_deg=40.0).hard_gradient_deg == 40.0
    assert Traversability.safe(hard_gradient_deg=35.0).hard_slope_deg == 30.0
    assert Traversability.safe().soft() == Traversability()
