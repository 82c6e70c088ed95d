"""Planning on elevations: computed where a search looks. All maps are tried by `tests.fuzz.elevations`."""

import copy
import pickle
import random

import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Traversability, traversability_cost
from nnpp_edge.runtime.terrain.traversability import SaturationWarning
from tests.fuzz import elevations

SIDE = 300
ROW, COL = np.mgrid[:SIDE, :SIDE]
HILLS = (4.0 * np.sin(ROW / 23.0) * np.cos(COL / 31.0)).astype(np.float32)
ENDS = (20, 30), (60, 80)


def planner(lazy=True, dem=HILLS, **options):
    return Planner.of_elevation(dem, 1.0, lazy=lazy, warn=False, **options)


def test_nothing_is_computed_before_somebody_looks():
    ours = planner()
    assert ours.state.costs_computed == 0.0
    plan = ours.plan(*ENDS, method="astar")
    assert plan.ok and 0.0 < plan.costs_computed < 0.5
    assert planner(lazy=False).plan(*ENDS, method="astar").costs_computed == 1.0
    assert Planner(traversability_cost(HILLS, 1.0, warn=False)).plan(*ENDS).costs_computed == 1.0


def test_heights_relative_to_a_base_stay_so_in_patches():
    high = HILLS.astype(np.float64) + 2.0**23
    ours = planner(dem=high)
    assert ours.plan(*ENDS, method="astar").cost == pytest.approx(
        planner().plan(*ENDS, method="astar").cost, rel=1e-5
    )
    ours.update_elevation(30, 30, high[30:50, 30:60])
    np.testing.assert_allclose(ours.state.grid.map(), planner(False).state.grid.map(), atol=1e-4)


def test_a_saturated_map_warns_once_it_arrives():
    with pytest.warns(SaturationWarning, match="slope") as caught:
        Planner.of_elevation(HILLS * 100.0, 1.0, Traversability(step_limit_m=1e6, roughness_limit_m=1e6))
    assert caught[0].filename == __file__


@pytest.mark.filterwarnings("ignore:the network edge was trained for omega")
@pytest.mark.parametrize("seed", [1795346114005736, 1795346114009973, 1795346114008315])
def test_what_is_computed_does_not_depend_on_what_was_there_before(seed):
    """Three coarse levels; a patch in tiles that are pooled and not yet linked; costs that weigh nothing."""
    assert elevations.check(elevations.generate(random.Random(f"elevations {seed}"))) is None


def test_a_copy_has_the_elevations_as_they_are_now():
    dem = HILLS.copy()
    ours = planner(dem=dem)
    dem[:] = np.nan  # they are copied
    assert ours.plan(*ENDS).ok
    ours.update_elevation(40, 40, np.full((9, 9), 90.0))
    for copied in (copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))):
        other = copied(ours)
        assert other.state.costs_computed == 0.0
        assert other.plan(*ENDS, method="astar").cost == ours.plan(*ENDS, method="astar").cost
        other.update_elevation(40, 40, HILLS[40:49, 40:49])
        assert ours.state.grid.map()[44, 40] > other.state.grid.map()[44, 40]
