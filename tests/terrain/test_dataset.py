import dataclasses

import numpy as np
import pytest

from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.terrain.dataset import make_dataset, read_recipe, read_samples
from nnpp_edge.terrain.labels import EXCESS_STEP, label_queries
from nnpp_edge.terrain.shards import Recipe, make_shard
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import workload
from tests import oracles

RECIPE = Recipe((), maps=10, size=32, blocks=8, maps_per_shard=3, poolings=((1, 0.7), (2, 0.3)))


def arrays(folder):
    return {p.name: dict(np.load(p)) for p in sorted(folder.glob("shard-*.npz"))}


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name in one:
        for key in one[name]:
            np.testing.assert_array_equal(one[name][key], other[name][key])


def test_the_parts_together_are_the_whole_and_it_can_be_resumed(tmp_path):
    make_dataset(RECIPE, tmp_path / "whole", workers=2)
    for k in (2, 1):
        make_dataset(RECIPE, tmp_path / "parts", workers=1, part=(k, 2))
    whole = arrays(tmp_path / "whole")
    assert [len(s["planes"]) for s in whole.values()] == [3, 3, 3, 1]
    assert_same(whole, arrays(tmp_path / "parts"))
    (tmp_path / "whole" / "shard-00001.npz").unlink()
    counts = make_dataset(RECIPE, tmp_path / "whole", workers=1)
    assert (counts["shards"], counts["maps"]) == (4, 10)
    assert_same(arrays(tmp_path / "whole"), arrays(tmp_path / "parts"))
    samples = read_samples(tmp_path / "whole")
    assert samples.map_index.max() == 9
    assert len(samples) == counts["queries"]
    assert read_recipe(tmp_path / "whole") == RECIPE


def test_another_recipe_is_refused(tmp_path):
    make_dataset(RECIPE, tmp_path, workers=1)
    with pytest.raises(DataSetError, match="another recipe"):
        make_dataset(dataclasses.replace(RECIPE, seed=2), tmp_path, workers=1)
    with pytest.raises(DataSetError, match="1 <= k <= n"):
        make_dataset(RECIPE, tmp_path, part=(3, 2))
    with pytest.raises(DataSetError, match=r"dataset\.json"):
        read_samples(tmp_path / "nowhere")


def test_samples_are_averaged_down_to_a_smaller_network(tmp_path):
    make_dataset(RECIPE, tmp_path, workers=1)
    whole, half = read_samples(tmp_path), read_samples(tmp_path, size=RECIPE.size // 2)
    side = RECIPE.size // 2
    assert half.planes.shape == (len(whole.planes), 2, side, side)
    wanted = whole.planes[3, :, 4:6, 6:8].mean(axis=(1, 2))
    np.testing.assert_allclose(half.planes[3, :, 2, 3], wanted, atol=0.51)
    np.testing.assert_allclose(half.start, (whole.start - 0.5) / 2)
    np.testing.assert_array_equal(half.excess, whole.excess)
    with pytest.raises(DataSetError, match="a multiple of that"):
        read_samples(tmp_path, size=RECIPE.size - 1)


def test_labels_are_the_optimum_and_the_excess_of_every_block():
    rng = np.random.default_rng(0)
    cost = rng.random((16, 16)).astype(np.float32)
    cost[rng.random((16, 16)) < 0.2] = np.inf
    points = np.argwhere(np.isfinite(cost))[[3, 60, 150]].astype(np.int32)
    labelled = label_queries(cost, points, 4.0, 8, 0.011)
    assert labelled
    for (start, goal), optimum, path, excess in labelled:
        forward, backward = oracles.dijkstra(cost, start), oracles.dijkstra(cost, goal)
        assert optimum == pytest.approx(forward[goal], rel=1e-5)
        assert oracles.path_cost(path, cost) == pytest.approx(optimum, rel=1e-5)
        through = (forward + backward).reshape(8, 2, 8, 2).min(axis=(1, 3))
        wanted = np.minimum((through / forward[goal] - 1) / EXCESS_STEP, 255)
        np.testing.assert_allclose(excess, wanted, atol=0.6)
        assert (excess[path[:, 0] // 2, path[:, 1] // 2] == 0).all()


def test_samples_keep_their_distance_and_see_obstacles():
    recipe = dataclasses.replace(RECIPE, obstacle_share=1.0, margin_share=0.0)
    shard = make_shard(recipe, [], np.random.default_rng(5), 8)
    apart = np.linalg.norm(shard["start"] - shard["goal"], axis=1)
    assert apart.min() >= 32 / 8 - 1e-3
    assert (shard["planes"][:, 1] > 0).any(axis=(1, 2)).all()
    assert set(shard["pooling"]) == {1, 2}
    masks = np.unpackbits(shard["on_path"], axis=-1)
    assert ((shard["excess"] == 0) >= masks).all()


def test_synthetic_terrain_is_rough_at_the_slope_asked_for():
    dem = synthetic_terrain(np.random.default_rng(2), 64, 5.0)
    gy, gx = np.gradient(dem, 5.0)
    assert 1.0 < np.degrees(np.arctan(np.median(np.hypot(gy, gx)))) < 25.0


def test_workloads_by_name():
    assert workload("limit17.5").hard_slope_deg == workload("limit17.5").slope_limit_deg == 17.5
    assert np.isinf(workload("soft").hard_slope_deg)
    for wrong in ("hard", "limit", "limit0", "limit95"):
        with pytest.raises(InvalidQueryError, match="workload"):
            workload(wrong)
