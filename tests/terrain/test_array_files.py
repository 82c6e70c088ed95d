"""Maps in NumPy files that are damaged, or promise too much."""

import io
import random
import zipfile

import numpy as np
import pytest

from nnpp_edge.runtime.errors import NnppEdgeError, TerrainError
from nnpp_edge.terrain.array_files import read_cost_map
from nnpp_edge.terrain.dem import read_dem
from tests.fuzz.mutations import damaged
from tests.strategies import uniform

COST = uniform(0, (40, 30), 0, 0.9)


@pytest.fixture
def good(tmp_path):
    """A sound file of each kind."""
    np.savez_compressed(tmp_path / "packed.npz", cost=COST, cell_size_m=2.0, cell_width_m=2.0)
    np.savez(tmp_path / "plain.npz", cost=COST, cell_size_m=2.0)
    np.savez(tmp_path / "heights.npz", elevation_m=COST, cell_size_m=2.0)
    np.save(tmp_path / "heights.npy", COST)
    return tmp_path


def header(shape, kind="<f4"):
    """The header of a `.npy` that promises an array."""
    content = io.BytesIO()
    promised = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(content, promised)
    return content.getvalue()


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(f"{name}.npy", content)
    return path


def read(path):
    found = read_cost_map(path)
    return read_dem(path, cell_size_m=1.0) if found is None else found


def test_a_cost_map_is_read_with_its_cell_size(good):
    for name in ("packed.npz", "plain.npz"):
        cost, size = read_cost_map(good / name)
        np.testing.assert_array_equal(cost, COST)
        assert size == 2.0
    np.savez(good / "no_size.npz", cost=COST.astype(np.float64))
    cost, size = read_cost_map(good / "no_size.npz")
    assert (cost.dtype, size) == (np.float32, 1.0)
    assert read_cost_map(good / "heights.npz") is None and read_cost_map(good / "none.npz") is None
    with pytest.raises(TerrainError, match="wanted heights, got costs"):
        read_dem(good / "plain.npz")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["packed.npz", "plain.npz", "heights.npy"])
def test_however_a_file_is_damaged_it_is_read_or_refused_in_one_line(good, capfd, name):
    """Other formats: the fuzzer."""
    content = (good / name).read_bytes()
    path = good / f"damaged{name[-4:]}"
    refused = 0
    for case in range(150):
        path.write_bytes(damaged(random.Random(case), content))
        try:
            read(path)
        except NnppEdgeError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 50
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("size", [np.nan, 0.0, np.inf, [1.0, 2.0], "two", None, True])
def test_a_cell_size_that_is_none_is_refused(tmp_path, size):
    np.savez(tmp_path / "cost.npz", cost=COST, cell_size_m=size)
    with pytest.raises(TerrainError, match="cell_size_m must be one number above 0"):
        read_cost_map(tmp_path / "cost.npz")


@pytest.mark.parametrize(
    "cost",
    [COST[0], "costs", np.array([[{}]]), np.empty((0, 5)), COST + 1j],
    ids=["one row", "text", "objects", "empty", "complex"],
)
def test_costs_that_are_no_map_are_refused(tmp_path, cost):
    np.savez(tmp_path / "cost.npz", cost=cost)
    with pytest.raises(TerrainError, match=r"wanted an \(H, W\) array of costs"):
        read_cost_map(tmp_path / "cost.npz")


def test_a_cost_beyond_float32_is_infinite(tmp_path):
    np.savez(tmp_path / "cost.npz", cost=np.array([[1e300, 0.5]]))
    np.testing.assert_array_equal(read_cost_map(tmp_path / "cost.npz")[0], [[np.inf, 0.5]])


@pytest.mark.parametrize("name", ["cost", "elevation_m", "anything", ""])
@pytest.mark.parametrize(
    "sides",
    [(20_000, 2_000_000), (2**62, 1), (-5, 3), (10**30, 10**30)],
)
def test_a_map_larger_than_memory_is_refused_by_its_header(tmp_path, sides, name):
    beginning = header(sides) + bytes(4096)
    path = tmp_path / "dem.npy"
    path.write_bytes(beginning)
    if name:
        path = archive(tmp_path / "dem.npz", **{name: beginning})
    with pytest.raises(TerrainError) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_arrays_that_are_not_wanted_are_not_unpacked_and_nothing_advises_to_unpickle(tmp_path):
    """Where no array has a name of ours, the headers alone tell which has two dimensions."""
    bomb = header((10**9, 1, 1), "<f8") + bytes(1000)
    path = archive(tmp_path / "dem.npz", bomb=bomb, heights=header((2, 2)) + bytes(16))
    assert read_dem(path, cell_size_m=1.0).elevation.shape == (2, 2)
    (tmp_path / "dem.npy").write_bytes(b"\x80\x04K\x01.")
    with pytest.raises(TerrainError) as caught:
        read_dem(tmp_path / "dem.npy", cell_size_m=1.0)
    assert "pickle" not in str(caught.value)
