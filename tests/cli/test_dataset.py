"""`nnpp-edge dataset` as a new user meets it: one's own terrain, mistakes first."""

from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.export.to_onnx import dataset_facts
from nnpp_edge.terrain.dataset import read_recipe, read_samples
from nnpp_edge.terrain.shards import WORKLOADS

FEW = "--maps 4 --workers 1 --synthetic-share 0"


@pytest.fixture
def dem(trained_on):
    """dem.npz, a map of 100 × 160 cells."""
    return trained_on(100)


def test_terrain_that_is_too_small_names_the_size_that_fits_and_leaves_nothing(run, dem):
    ended = run(f"dataset dem.npz -o set {FEW}")
    told = (
        "wanted at least 256 cells on the shorter side",
        "got 100 × 160",
        "--size 96 is the largest that fits",
    )
    ended.refused(*told)
    assert not Path("set").exists()
    ended = run(f"dataset dem.npz -o set {FEW} --size 64")
    assert ended.code == 0 and "no room for maps of 128² and 256² cells" in ended.err
    assert len(read_samples(Path("set")).planes) == 4


def test_what_makes_no_sense_is_one_line_before_any_process_starts(run, dem, monkeypatch):
    monkeypatch.setattr("nnpp_edge.terrain.dataset.ProcessPoolExecutor", None)
    run(f"dataset none.tif -o set {FEW}").refused("none.tif", "no such file")
    words = f"dataset dem.npz -o set {FEW} --size"
    for given, said in (
        *((size, "error: ") for size in (0, 16, 17, 48)),  # no network has them
        ("32 --held-out", "--validation-share"),
        ("32 --own-cell-size --rescale 2", "--own-cell-size"),
        ("32 --papers-maps --workload soft", "--papers-maps"),
        ("32 --workload limit20 --limit hard_slope_deg=20", "leave out --limit hard_slope_deg"),
        ("32 --limit hard_step_m=-1", "hard_step_m must be greater than 0, got -1"),
        ("32 --omega nan", "wanted a finite number, got nan"),
        ("32 --seed -1", "-1 is not in the range 0<=x"),
    ):
        run(f"{words} {given}").refused(said)
    assert not Path("set").exists()


def test_ones_own_limits_weight_and_cells_are_in_the_recipe(run, dem):
    np.save("dem.npy", dem)
    words = f"dataset dem.npy -o cells {FEW} --size 32"
    run(words).refused("--cell-size")
    assert run(f"{words} --cell-size 5").code == 0 and read_recipe(Path("cells")).cell_size_m == 5.0
    words = f"dataset dem.npz {FEW} --size 32 --validation-share 0.4"
    own = "--own-cell-size --limit hard_slope_deg=20 --limit roughness_limit_m=0.3 --omega 0.03"
    for more in (
        f"{own} -o train",
        f"{own} --held-out -o val",
        "--workload limit25 --rescale 2 -o steep",
        "--papers-maps -o papers",
    ):
        assert run(f"{words} {more}").code == 0
    assert run(f"dataset {FEW} --size 32 -o default").code == 0
    names = ("train", "val", "steep", "papers", "default")
    training, validation, steep, papers, default = (read_recipe(Path(name)) for name in names)
    assert training.limits == {"hard_slope_deg": 20.0, "roughness_limit_m": 0.3}
    assert (training.omega, training.cell_sizes_m, training.workloads) == (
        0.03,
        (),
        (("soft", 1.0),),
    )
    assert training.stripe == (0.0, validation.stripe[0]) == (0.0, 0.6)
    assert dataset_facts(training)["limits"] == training.limits
    assert (steep.workloads, steep.cell_sizes_m) == ((("limit25", 1.0),), (2.0,))
    assert steep.common_limits.hard_slope_deg == 25
    assert (papers.workloads, papers.poolings, papers.margin_share) == (
        (("soft", 1.0),),
        ((1, 1.0),),
        0.0,
    )
    assert (default.limits, default.workloads, len(default.cell_sizes_m)) == ({}, WORKLOADS, 5)
