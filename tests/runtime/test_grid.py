import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import StepModel


@given(st.sampled_from(["paper", "length"]), st.integers(0, 2**32), st.booleans())
def test_an_update_says_what_it_changed_and_what_stood_there(step_cost, seed, keep):
    rng, model = np.random.default_rng(seed), StepModel.of(step_cost)
    cost = (rng.random((9, 12)) * 0.9 + 0.05).astype(np.float32)
    cost[rng.random(cost.shape) < 0.2] = np.inf
    grid = Grid.of(cost, model)
    row, col = int(rng.integers(0, 9)), int(rng.integers(0, 12))
    part = np.s_[row : row + int(rng.integers(1, 5)), col : col + int(rng.integers(1, 5))]
    patch = cost[part].copy()
    patch[rng.random(patch.shape) < 0.3] *= np.float32(0.5)
    patch[rng.random(patch.shape) < 0.2] = np.nan
    before = grid.map().copy()
    change = grid.update(patch, (row, col), keep_old_weights=keep)
    cost[part] = patch
    np.testing.assert_array_equal(grid.map(), Grid.of(cost, model).map())
    differs = grid.map() != before
    assert change.cells == differs.sum()
    assert change.cheaper == (grid.map() < before).any()
    passable = grid.map()[np.isfinite(grid.map())]
    assert passable.size == 0 or grid.least <= passable.min() <= passable.max() <= grid.greatest
    if not change.cells:
        assert change.part[2:] == (0, 0)
        return
    rows, cols = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    assert change.part == (rows[0], cols[0], rows[-1] - rows[0] + 1, cols[-1] - cols[0] + 1)
    changed = [grid.node(*cell) for cell in np.argwhere(differs).tolist()]
    np.testing.assert_array_equal(change.nodes, changed if keep else [])
    np.testing.assert_array_equal(change.old_weights, before[differs] if keep else [])


@pytest.mark.parametrize(("step_cost", "bad"), [("paper", -0.1), ("length", -1.0), ("length", 0.0)])
def test_a_cost_too_low_is_refused_and_the_map_stays(step_cost, bad):
    grid = Grid.of(np.full((5, 6), 0.5), StepModel.of(step_cost))
    before, bounds = grid.weights.copy(), (grid.least, grid.greatest)
    with pytest.raises(InvalidMapError, match=f"got one of {bad:g}"):
        grid.update(np.array([[0.2, bad]]), (1, 1))
    for origin in ((-1, 0), (0, 5), (5, 0)):
        with pytest.raises(InvalidMapError, match="inside the map"):
            grid.update(np.full((1, 2), 0.3), origin)
    np.testing.assert_array_equal(grid.weights, before)
    assert (grid.least, grid.greatest) == bounds


def test_the_whole_map_taken_over_narrows_its_bounds():
    grid = Grid.of(np.array([[0.1, 0.9]]), StepModel.of("paper"))
    assert grid.update(np.array([[0.4, 0.5]])).cells == 2
    assert (grid.least, grid.greatest) == pytest.approx(tuple(grid.model.scale * x for x in (0.4, 0.5)))
