"""What passage networks learn from."""

import numpy as np
import pytest

from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.passage import unsuited
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.passage import (
    CLOSED,
    PassageRecipe,
    as_stored,
    block_labels,
    make_passage_shard,
    of_stored,
    packed_heights,
    random_ground,
    random_vehicle,
    unpacked_heights,
)

BODY = Vehicle(5.0, 4.0, 1.0)


def test_on_flat_ground_all_passes_for_nothing_but_at_the_border():
    labels = block_labels(np.zeros((48, 48), np.float32), BODY)
    inner = slice(2, -2)
    assert (labels.passing[:, inner, inner] == 16).all()
    assert (labels.cost[:, inner, inner] == 0).all()
    assert (labels.link[:, inner, inner] == 0).all()
    assert (labels.passing[:, 0, 0] < 4).all()


def test_a_wall_closes_the_links_across_it_and_no_others():
    heights = np.zeros((64, 64), np.float32)
    heights[32:34] = 10.0
    link = block_labels(heights, BODY).link
    assert (link[:, 8, 3:-3] == CLOSED).all()
    assert (link[2, 4, 3:-3] == 0).all()


def test_vehicles_and_heights_come_back_as_they_were_stored():
    rng = np.random.default_rng(3)
    for _ in range(20):
        vehicle = random_vehicle(rng)
        np.testing.assert_allclose(as_stored(of_stored(as_stored(vehicle))), as_stored(vehicle))
    heights = random_ground(rng, [], 64, BODY)
    heights[3:5] = np.nan
    back = unpacked_heights(*packed_heights(heights))
    assert (np.isnan(back) == np.isnan(heights)).all()
    apart = back - heights  # but for the level of the whole
    assert np.nanmax(apart) - np.nanmin(apart) < 1e-3 * max(np.nanmax(heights) - np.nanmin(heights), 1.0)


def test_the_same_recipe_makes_the_same_shard():
    recipe = PassageRecipe((), maps=4, size=32, maps_per_vehicle=2)
    one, other = (make_passage_shard(recipe, [], np.random.default_rng(1), 4) for _ in range(2))
    assert all((one[name] == other[name]).all() for name in one)
    assert len(np.unique(one["vehicle"], axis=0)) == 2


def test_a_vehicle_that_no_network_is_made_for_is_refused():
    far_too_long = {"length_m": 30.0, "width_m": 20.0, "clearance_m": 5.0}
    assert "length in cells" in unsuited(Vehicle(30.0, 20.0, 5.0), (1.0, 1.0))
    with pytest.raises(DataSetError, match="length in cells"):
        PassageRecipe((), vehicle=far_too_long, vehicle_cell_m=1.0)
