import msgspec
import numpy as np
import pytest

from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.terrain.dataset import make_dataset, read_recipe, read_samples
from nnpp_edge.terrain.labels import EXCESS_STEP, label_queries
from nnpp_edge.terrain.shards import Recipe, make_shard, shard_content
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


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a data set made by `RECIPE`."""
    folder = tmp_path_factory.mktemp("whole")
    make_dataset(RECIPE, folder, workers=2)
    return folder


def make_in_this_process(recipe, tiles, indices):
    """Shards without the processes that `make_dataset` starts."""
    for index in indices:
        yield index, shard_content(recipe, tiles, index)


def test_the_parts_together_are_the_whole_and_it_can_be_resumed(whole, tmp_path):
    for k in (2, 1):
        make_dataset(RECIPE, tmp_path, make=make_in_this_process, part=(k, 2))
    wanted = arrays(whole)
    assert [len(s["planes"]) for s in wanted.values()] == [3, 3, 3, 1]
    assert_same(wanted, arrays(tmp_path))
    (tmp_path / "shard-00001.npz").unlink()
    counts = make_dataset(RECIPE, tmp_path, make=make_in_this_process)
    assert (counts["shards"], counts["maps"]) == (4, 10)
    assert_same(wanted, arrays(tmp_path))
    samples = read_samples(tmp_path)
    assert samples.map_index.max() == 9
    assert len(samples) == counts["queries"]
    assert read_recipe(tmp_path) == RECIPE


def test_another_recipe_is_refused(whole, tmp_path):
    with pytest.raises(DataSetError, match="another recipe"):
        make_dataset(msgspec.structs.replace(RECIPE, seed=2), whole, workers=1)
    with pytest.raises(DataSetError, match="1 <= k <= n"):
        make_dataset(RECIPE, tmp_path, part=(3, 2))
    with pytest.raises(DataSetError, match=r"dataset\.json"):
        read_samples(tmp_path / "nowhere")


def test_samples_are_averaged_down_to_a_smaller_network(whole):
    full, half = read_samples(whole), read_samples(whole, size=RECIPE.size // 2)
    side = RECIPE.size // 2
    assert half.planes.shape == (len(full.planes), 2, side, side)
    wanted = full.planes[3, :, 4:6, 6:8].mean(axis=(1, 2))
    np.testing.assert_allclose(half.planes[3, :, 2, 3], wanted, atol=0.51)
    np.testing.assert_allclose(half.start, (full.start - 0.5) / 2)
    np.testing.assert_array_equal(half.excess, full.excess)
    with pytest.raises(DataSetError, match="a multiple of that"):
        read_samples(whole, size=RECIPE.size - 1)


def test_labels_are_the_optimum_and_the_excess_of_every_block():
    rng = np.random.default_rng(0)
    cost = rng.random((16, 16)).astype(np.float32)
    cost[rng.random((16, 16)) < 0.2] = np.inf
    points = np.argwhere(np.isfinite(cost))[[3, 60, 150]].astype(np.int32)
    labelled = label_queries(cost, points, 4.0, 8, 0.011)
    assert labelled
    for label in labelled:
        start, goal, optimum, path, excess = label.start, label.goal, label.optimum, label.path, label.excess
        forward, backward = oracles.dijkstra(cost, start), oracles.dijkstra(cost, goal)
        assert optimum == pytest.approx(forward[goal], rel=1e-5)
        assert oracles.path_cost(path, cost) == pytest.approx(optimum, rel=1e-5)
        through = (forward + backward).reshape(8, 2, 8, 2).min(axis=(1, 3))
        wanted = np.minimum((through / forward[goal] - 1) / EXCESS_STEP, 255)
        np.testing.assert_allclose(excess, wanted, atol=0.6)
        assert (excess[path[:, 0] // 2, path[:, 1] // 2] == 0).all()


def test_samples_keep_their_distance_and_see_obstacles():
    recipe = msgspec.structs.replace(RECIPE, obstacle_share=1.0, margin_share=0.0)
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


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"format": "another"}, "of format nnpp-edge-dataset-1"),
        ({"format": None}, "of format nnpp-edge-dataset-1"),
        ({"maps": "ten"}, "got Expected `int`, got `str` - at `$.maps`"),
        ({"colour": "grey"}, "got Object contains unknown field `colour`"),
    ],
)
def test_a_recipe_that_was_not_written_by_us_is_refused(whole, tmp_path, changes, word):
    stored = msgspec.json.decode((whole / "dataset.json").read_bytes())
    (tmp_path / "dataset.json").write_bytes(msgspec.json.encode(stored | changes))
    with pytest.raises(DataSetError) as refused:
        read_recipe(tmp_path)
    assert word in str(refused.value)
