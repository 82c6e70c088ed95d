"""Data sets: what is made, resumed and read, and what is refused."""

import io
import json
import signal
from concurrent.futures.process import BrokenProcessPool

import msgspec
import numpy as np
import pytest

from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain import dataset
from nnpp_edge.terrain.dataset import make_dataset, read_recipe, read_samples
from nnpp_edge.terrain.shards import BARREN_MAPS, Recipe, make_shard, read_terrain, shard_content
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import workload
from tests.tables import cases

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
    make_dataset(RECIPE, folder, workers=1)
    return folder


@pytest.fixture
def here(monkeypatch):
    """Have shards made without other processes."""

    def made(recipe, tiles, indices, workers):
        for index in indices:
            yield index, shard_content(recipe, tiles, index)

    monkeypatch.setattr(dataset, "_shards_here", made)


def test_a_set_is_the_same_wherever_it_is_made_and_can_be_resumed(whole, tmp_path, here):
    make_dataset(RECIPE, tmp_path)
    wanted = arrays(whole)
    assert [len(s["planes"]) for s in wanted.values()] == [3, 3, 3, 1]
    assert_same(wanted, arrays(tmp_path))
    (tmp_path / "shard-00001.npz").unlink()
    counts = make_dataset(RECIPE, tmp_path)
    assert (counts["shards"], counts["maps"]) == (4, 10)
    assert_same(wanted, arrays(tmp_path))
    samples = read_samples(tmp_path)
    assert samples.map_index.max() == 9
    assert len(samples) == counts["queries"]
    assert read_recipe(tmp_path) == RECIPE


def test_another_recipe_is_refused(whole, tmp_path):
    with pytest.raises(DataSetError, match="another recipe"):
        make_dataset(msgspec.structs.replace(RECIPE, seed=2), whole, workers=1)
    with pytest.raises(DataSetError, match=r"dataset\.json"):
        read_samples(tmp_path / "nowhere")


def test_samples_are_averaged_down_to_a_smaller_network(whole):
    full = read_samples(whole)
    half = read_samples(whole, size=RECIPE.size // 2)
    side = RECIPE.size // 2
    assert half.planes.shape == (len(full.planes), 2, side, side)
    wanted = full.planes[3, :, 4:6, 6:8].mean(axis=(1, 2))
    np.testing.assert_allclose(half.planes[3, :, 2, 3], wanted, atol=0.51)
    np.testing.assert_allclose(half.start, (full.start - 0.5) / 2)
    np.testing.assert_array_equal(half.excess, full.excess)
    with pytest.raises(DataSetError, match="a multiple of that"):
        read_samples(whole, size=RECIPE.size - 1)


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
    south_and_east = np.gradient(synthetic_terrain(np.random.default_rng(2), 64, 5.0), 5.0)
    assert 1.0 < np.degrees(np.arctan(np.median(np.hypot(*south_and_east)))) < 25.0


def test_synthetic_terrain_may_be_small():
    for seed in range(60):
        heights = synthetic_terrain(np.random.default_rng(seed), 2 + seed % 15, 5.0)
        assert heights.dtype == np.float32 and np.isfinite(heights).all()


def test_workloads_by_name():
    assert workload("limit17.5").hard_slope_deg == workload("limit17.5").slope_limit_deg == 17.5
    assert np.isinf(workload("soft").hard_slope_deg)


@pytest.mark.parametrize("name", ["hard", "limit", "limit0", "limit95"])
def test_a_name_of_no_workload_is_refused(name):
    with pytest.raises(InvalidQueryError, match="workload"):
        workload(name)


def changed(whole, folder, changes):
    """A folder whose recipe has other values."""
    stored = msgspec.json.decode((whole / "dataset.json").read_bytes())
    (folder / "dataset.json").write_bytes(msgspec.json.encode(stored | json.loads(changes)))
    return folder


STRANGE = """
{"format": "another"} | of format nnpp-edge-dataset-1
{"format": null}      | of format nnpp-edge-dataset-1
{"maps": "ten"}       | Expected `int`, got `str` - at `$.maps`
{"colour": "grey"}    | Object contains unknown field `colour`
"""


@pytest.mark.parametrize(("changes", "words"), cases(STRANGE))
def test_a_recipe_that_was_not_written_by_us_is_refused_in_one_line(
    whole,
    tmp_path,
    changes,
    words,
):
    with pytest.raises(DataSetError) as caught:
        read_recipe(changed(whole, tmp_path, changes))
    assert str(caught.value).startswith(f"{tmp_path}: wanted a data set")
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"null", b'{"format": []}', b'{"format": "\xff"}', b"{" * 9000, b'{"a":' * 90_000],
    ids=["empty", "null", "list", "no UTF-8", "cut off", "deep"],
)
def test_a_file_that_is_no_recipe_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "dataset.json").write_bytes(content)
    with pytest.raises(DataSetError, match="wanted a data set") as caught:
        read_recipe(tmp_path)
    assert "\n" not in str(caught.value)


OUT_OF_RANGE = """
{"size": 16, "blocks": 4}
{"size": 33}
{"blocks": 0}
{"blocks": 24}
{"maps": 0}
{"points_per_map": 1}
{"poolings": []}
{"poolings": [[0, 1.0]]}
{"workloads": [["soft", 0.0]]}
{"workloads": [["hard", 1.0]]}
{"synthetic_share": 1.5}
{"omega": 0.0}
{"cell_sizes_m": [1e-320]}
{"cell_sizes_m": []}
{"limits": {"slope": 3.0}}
{"limits": {"hard_step_m": -1.0}}
{"stripe": [0.5, 0.5]}
{"seed": -1}
"""


@pytest.mark.parametrize("changes", cases(OUT_OF_RANGE, 1))
def test_numbers_out_of_range_are_no_recipe(whole, tmp_path, changes):
    with pytest.raises(DataSetError, match=r"dataset\.json"):
        read_recipe(changed(whole, tmp_path, changes))


def refused_shard(folder, whole):
    (folder / "dataset.json").write_bytes((whole / "dataset.json").read_bytes())
    with pytest.raises(DataSetError, match=r"shard-00000\.npz: wanted a shard") as refused:
        read_samples(folder)
    assert "\n" not in str(refused.value)
    with pytest.raises(DataSetError, match=r"shard-00000\.npz: wanted a shard"):
        make_dataset(RECIPE, folder)


OTHER_ARRAYS = """
s.pop('planes')
s.update(planes=s['planes'].astype(np.float64))
s.update(planes=s['planes'][..., :16])
s.update(goal=s['goal'][1:])
"""


@pytest.mark.parametrize("change", OTHER_ARRAYS.strip().splitlines())
def test_a_shard_of_other_arrays_is_refused_by_name(whole, tmp_path, here, change):
    shard = dict(np.load(whole / "shard-00000.npz"))
    eval(change, {"s": shard, "np": np})
    np.savez(tmp_path / "shard-00000.npz", **shard)
    refused_shard(tmp_path, whole)


@pytest.mark.parametrize("kept", [0, 40, 4000])
def test_a_shard_that_is_cut_short_is_refused_by_name(whole, tmp_path, here, kept):
    content = (whole / "shard-00000.npz").read_bytes()
    (tmp_path / "shard-00000.npz").write_bytes(content[:kept])
    refused_shard(tmp_path, whole)


def of_terrain(folder, elevation, **changes):
    """A recipe of small maps of this terrain alone, in cells of 5 m."""
    path = folder / "dem.npz"
    np.savez(path, elevation_m=np.asarray(elevation, np.float32), cell_size_m=5.0)
    plain = {"synthetic_share": 0.0, "obstacle_share": 0.0, "margin_share": 0.0}
    return msgspec.structs.replace(RECIPE, terrain=(str(path),), **(plain | changes))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_terrain_without_two_cells_to_plan_between_ends_the_making_and_does_not_block_another(
    tmp_path, here, share
):
    elevation = np.full((70, 70), np.nan)
    elevation[7, 9] = 3.0
    many = {"synthetic_share": share, "maps": 4000, "maps_per_shard": 4000}
    with pytest.raises(DataSetError, match=rf"dem\.npz: .*got none on {BARREN_MAPS} maps"):
        make_dataset(of_terrain(tmp_path, elevation, **many), tmp_path / "set")
    assert not list((tmp_path / "set").iterdir())
    good = of_terrain(tmp_path, synthetic_terrain(np.random.default_rng(0), 70, 5.0))
    assert make_dataset(good, tmp_path / "set")["maps"] == good.maps
    assert read_recipe(tmp_path / "set") == good


@pytest.mark.parametrize("shape", [(200, 40), (40, 200)])
def test_training_and_validation_have_different_parts_of_a_file(tmp_path, shape):
    """Cells are told apart by their heights."""
    elevation = np.arange(8000.0).reshape(shape)
    parts = [of_terrain(tmp_path, elevation, stripe=stripe) for stripe in ((0.0, 0.7), (0.7, 1.0))]
    training, validation = (read_terrain(part)[0].elevation for part in parts)
    assert not set(training.ravel()) & set(validation.ravel())
    assert (training.size, validation.size) == (5600, 2400)
    made = []
    for part in parts:
        recipe = msgspec.structs.replace(part, synthetic_share=1.0, poolings=((1, 1.0),))
        shard = np.load(io.BytesIO(shard_content(recipe, read_terrain(recipe), 0)))
        made.append(shard["planes"])
    assert not np.array_equal(*made), "synthetic maps differ, too"
    words = r"in the stripe that --validation-share leaves, got (20 × 40|40 × 20)"
    with pytest.raises(DataSetError, match=words):
        read_terrain(of_terrain(tmp_path, elevation, stripe=(0.9, 1.0)))


def test_maps_are_made_by_ones_own_limits_and_cells(tmp_path):
    """Steps of half a metre are too high; where the terrain is shrunk from cells of 5 m to 1 m,
    they are lower.
    """
    elevation = np.random.default_rng(2).uniform(0, 0.5, (70, 70))
    elevation[:, ::2] = 0.0
    own = {"limits": {"hard_step_m": 0.15}, "workloads": (("soft", 1.0),)}
    blocked = {}
    for cells in ((), (1.0,)):
        recipe = of_terrain(tmp_path, elevation, **own, cell_sizes_m=cells, poolings=((1, 1.0),))
        shard = make_shard(recipe, read_terrain(recipe), np.random.default_rng(0), 4)
        blocked[cells] = shard["planes"][:, 1].mean()
    assert blocked[()] > 10 * max(blocked[1.0,], 1.0)
    assert read_terrain(recipe)[0].cell_size_m == 5.0
    assert Recipe((), workloads=(("limit20", 1.0),)).common_limits.hard_slope_deg == 20.0
    assert Recipe(()).common_limits == Traversability()


def test_cells_that_are_not_square_are_judged_by_both_sides(tmp_path):
    cols = np.mgrid[:70, :70][1].astype(np.float32)
    kind = {"cell_sizes_m": (), "workloads": (("limit20", 1.0),), "poolings": ((1, 1.0),)}
    recipe = of_terrain(tmp_path, cols, **kind)
    np.savez(recipe.terrain[0], elevation_m=cols, cell_size_m=1.0, cell_width_m=10.0)
    planes = make_shard(recipe, read_terrain(recipe), np.random.default_rng(0), 2)["planes"]
    assert planes[:, 1, 2:-2, 2:-2].max() == 0  # a slope of 6°, not of 45°


def test_a_process_that_makes_shards_ends_at_once_when_it_is_interrupted():
    before = signal.getsignal(signal.SIGINT)
    try:
        dataset.start_worker(RECIPE, [])
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_process_that_dies_is_one_line(tmp_path, monkeypatch):
    recipe = of_terrain(tmp_path, synthetic_terrain(np.random.default_rng(0), 70, 5.0))

    def broken(*_, **__):
        raise BrokenProcessPool("a process died")

    monkeypatch.setattr("nnpp_edge.terrain.dataset.ProcessPoolExecutor.submit", broken)
    with pytest.raises(DataSetError, match="fewer --workers take less memory"):
        make_dataset(recipe, tmp_path / "set", workers=1)
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())
