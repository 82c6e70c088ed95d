"""`nnpp-edge dataset` as a new user meets it: one's own terrain, mistakes first."""

import json
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.export.to_onnx import dataset_facts
from nnpp_edge.runtime.network.model_file import read_model_file
from nnpp_edge.terrain.dataset import read_recipe, read_samples
from nnpp_edge.terrain.shards import WORKLOADS, shard_content
from nnpp_edge.terrain.synthetic import synthetic_terrain

FEW = ("--maps", 4, "--workers", 1, "--synthetic-share", 0)


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    """A map of 100 × 160 cells."""
    elevation = synthetic_terrain(np.random.default_rng(5), 160, 5.0)[:100]
    np.savez(tmp_path / "dem.npz", elevation_m=elevation, cell_size_m=5.0)
    return tmp_path / "dem.npz"


@pytest.fixture
def in_this_process(monkeypatch):
    """Shards without the processes that the command starts."""

    def make(recipe, tiles, indices, _):
        for index in indices:
            yield index, shard_content(recipe, tiles, index)

    monkeypatch.setattr("nnpp_edge.terrain.dataset._shards_here", make)


def test_terrain_that_is_too_small_names_the_size_that_fits_and_leaves_nothing(nnpp_edge, dem, tmp_path):
    words = ("dataset", dem, "-o", tmp_path / "set", *FEW)
    ended = nnpp_edge(*words)
    ended.refused(
        "wanted at least 256 cells on the shorter side", "got 100 × 160", "--size 96 is the largest that fits"
    )
    assert not (tmp_path / "set").exists()
    ended = nnpp_edge(*words, "--size", 64)
    assert ended.code == 0
    assert "no room for maps of 128² and 256² cells" in ended.err
    assert len(read_samples(tmp_path / "set").planes) == 4


def test_terrain_that_cannot_be_read_is_one_line_before_any_process_starts(nnpp_edge, tmp_path, monkeypatch):
    monkeypatch.setattr("nnpp_edge.terrain.dataset.ProcessPoolExecutor", None)
    for name, content, words in (
        ("none.tif", None, "no such file"),
        ("text.tif", b"these are no heights\n", "cannot be read"),
        ("text.npy", b"these are no heights\n", "wanted an elevation map"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        ended = nnpp_edge("dataset", tmp_path / name, "-o", tmp_path / "set", *FEW)
        ended.refused(name, words)
        assert ended.err.count("\n") == 1 and not (tmp_path / "set").exists()


def test_the_options_that_are_advised_are_there(nnpp_edge, dem, tmp_path, in_this_process):
    np.save(tmp_path / "dem.npy", np.load(dem)["elevation_m"])
    words = ("dataset", tmp_path / "dem.npy", "-o", tmp_path / "set", *FEW, "--size", 32)
    nnpp_edge(*words).refused("--cell-size")
    assert nnpp_edge(*words, "--cell-size", 5).code == 0
    assert read_recipe(tmp_path / "set").cell_size_m == 5.0


def test_options_that_make_no_sense_are_refused(nnpp_edge, dem, tmp_path):
    words = ("dataset", dem, "-o", tmp_path / "set", *FEW, "--size")
    for size in (0, 16, 17, 48):  # no network has them
        nnpp_edge(*words, size).refused("error: ")
    for given, said in (
        (("--held-out",), "--validation-share"),
        (("--own-cell-size", "--rescale", 2), "--own-cell-size"),
        (("--papers-maps", "--workload", "soft"), "--papers-maps"),
        (("--workload", "limit20", "--limit", "hard_slope_deg=20"), "leave out --limit hard_slope_deg"),
        (("--limit", "hard_step_m=-1"), "hard_step_m must be greater than 0, got -1"),
        (("--omega", "nan"), "wanted a finite number, got nan"),
        (("--seed", -1), "-1 is not in the range 0<=x"),
    ):
        nnpp_edge(*words, 32, *given).refused(said)
    assert not (tmp_path / "set").exists()


def test_ones_own_limits_weight_and_cells_are_in_the_recipe(nnpp_edge, dem, tmp_path, in_this_process):
    words = ("dataset", dem, *FEW, "--size", 32, "--validation-share", 0.4)
    own = ("--own-cell-size", "--limit", "hard_slope_deg=20", "--limit", "roughness_limit_m=0.3", "--omega", 0.03)
    for folder, more in (("train", ()), ("val", ("--held-out",))):
        assert nnpp_edge(*words, *own, *more, "-o", tmp_path / folder).code == 0
    training, validation = (read_recipe(tmp_path / folder) for folder in ("train", "val"))
    assert training.limits == {"hard_slope_deg": 20.0, "roughness_limit_m": 0.3}
    assert (training.omega, training.cell_sizes_m, training.workloads) == (0.03, (), (("soft", 1.0),))
    assert training.stripe == (0.0, validation.stripe[0]) == (0.0, 0.6)
    assert dataset_facts(training)["limits"] == training.limits
    nnpp_edge(*words, "--workload", "limit25", "--rescale", 2, "-o", tmp_path / "steep")
    steep = read_recipe(tmp_path / "steep")
    assert (steep.workloads, steep.cell_sizes_m, steep.common_limits.hard_slope_deg) == (
        (("limit25", 1.0),),
        (2.0,),
        25,
    )
    assert nnpp_edge(*words, "--papers-maps", "-o", tmp_path / "papers").code == 0
    papers = read_recipe(tmp_path / "papers")
    assert (papers.workloads, papers.poolings, papers.margin_share) == ((("soft", 1.0),), ((1, 1.0),), 0.0)
    assert nnpp_edge("dataset", *FEW, "--size", 32, "-o", tmp_path / "default").code == 0
    default = read_recipe(tmp_path / "default")
    assert (default.limits, default.workloads, len(default.cell_sizes_m)) == ({}, WORKLOADS, 5)


def test_from_ones_own_terrain_to_a_plan(nnpp_edge, dem, tmp_path, in_this_process):
    """The commands of docs/models.md, with tiny settings; the model says what it was made for."""
    own = ("--own-cell-size", "--limit", "hard_slope_deg=25", "--omega", 0.02)
    split = ("--validation-share", 0.4, *own, "--synthetic-share", 0, "--maps", 12)
    train, val, run = (tmp_path / name for name in ("train", "val", "run"))
    assert nnpp_edge("dataset", dem, "-o", train, "--size", 64, *split).code == 0
    assert nnpp_edge("dataset", dem, "-o", val, "--held-out", "--size", 64, *split).code == 0
    assert nnpp_edge("train", train, "--validation", val, "-o", run, "--steps", 2, "--batch", 8).code == 0
    fp32, int8 = tmp_path / "own-fp32.onnx", tmp_path / "own.onnx"
    assert nnpp_edge("export", run / "checkpoint.pt", "-o", fp32, "--name", "own", "--dataset", train).code == 0
    few = ("--samples", 4, "--exclude", "none-of-them")
    nnpp_edge("quantize", fp32, "--dataset", train, "-o", int8, *few).refused("none-of-them")
    assert nnpp_edge("quantize", fp32, "--dataset", train, "--validation", val, "-o", int8, "--samples", 4).code == 0
    told = read_model_file(int8).metadata
    assert (told.name, told.precision, told.omega, told.cost_limits["hard_slope_deg"]) == ("own", "int8", 0.02, 25.0)
    assert told.training["dataset"]["cell_sizes_m"] == []
    words = ("--start", "5,5", "--goal", "90,150", "--method", "nnpp", "--model", int8, "--omega", 0.02)
    ended = nnpp_edge("plan", dem, *words, "--json")
    assert ended.code in (0, 1) and json.loads(ended.out)
