import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from nnpp_edge import __version__
from nnpp_edge.benchmarks import map_stage
from nnpp_edge.runtime.errors import NnppEdgeError

ROOT = Path(__file__).parents[2]
STAGES = {
    "copy",
    "cost map",
    "grid",
    "pyramid",
    "grid and pyramid",
    "all less cost map",
    "all",
    "patch",
    "best method",
}
PATHS = {f"{method}, {how}" for method in ("astar", "corridor", "nnpp") for how in ("lazy", "eager")}
KEYS = {
    "size",
    "terrain",
    "stage",
    "unit",
    "here",
    "beside",
    "times_as_fast",
    "page_faults",
    "page_faults_beside",
    "repetitions",
}


@pytest.fixture
def older(tmp_path):
    """A checkout as it was: planners know costs alone, and the packages are put together when installed."""
    package = tmp_path / "older" / "nnpp_edge"
    package.mkdir(parents=True)
    (tmp_path / "older" / "runtime").symlink_to(ROOT / "runtime")
    (package / "models").symlink_to(ROOT / "nnpp_edge" / "models")
    (package / "__init__.py").write_text(
        f"__version__ = {__version__!r}\n"  # ours, so that its kernels are compiled already
        "from nnpp_edge.runtime.planners.planner import Planner\n"
        "del Planner.of_elevation, Planner.update_elevation\n"
    )
    return tmp_path / "older"


def run(*words):
    return CliRunner().invoke(map_stage.main, [str(word) for word in words], standalone_mode=False)


def test_every_stage_beside_a_checkout_without_maps_of_elevations(older, tiny_model):
    ended = run("--sizes", 64, "--repetitions", 2, "--model", tiny_model, "--beside", older, "--json")
    assert ended.exception is None, ended.exception
    rows = json.loads(ended.stdout)
    assert {row["stage"] for row in rows} == STAGES | PATHS
    for row in rows:
        assert set(row) == KEYS and (row["size"], row["terrain"], row["repetitions"]) == (64, "synthetic", 2)
        if row["stage"] == "all less cost map":  # a difference
            continue
        assert row["here"] > 0.0 and row["beside"] > 0.0 and row["times_as_fast"] > 0.0
    units = {row["unit"] for row in rows if row["stage"] in PATHS}
    assert units == {"ms"} and {row["unit"] for row in rows if row["stage"] == "patch"} == {"µs"}


def test_terrain_alone_and_a_table_in_markdown(tmp_path, tiny_model):
    heights = np.cumsum(np.random.default_rng(4).normal(0.0, 0.4, (80, 90)), axis=1).astype(np.float32)
    np.savez(tmp_path / "dem.npz", elevation_m=heights, cell_size_m=5.0)
    words = ("--terrain", tmp_path / "dem.npz", "--sizes", "64,96", "--repetitions", 1, "--model", tiny_model)
    ended = run(*words, "--markdown")
    assert ended.exception is None, ended.exception
    assert ended.stdout.startswith("| stage | size | unit | here |\n| --- | --- | --- | --- |\n")
    assert "| patch of 22 × 31 into all of it | 96² | µs |" in ended.stdout
    (first, *_, last) = map_stage.map_stage(
        (64, 96), map_stage.TerrainFiles((tmp_path / "dem.npz",)).read(), repetitions=1, model=str(tiny_model)
    )
    assert (first.terrain, last.terrain) == ("dem", "synthetic") and first.beside is None


def test_what_is_no_checkout_is_refused_and_a_broken_one_says_why(tmp_path, older, tiny_model):
    words = ("--sizes", 64, "--repetitions", 1, "--model", tiny_model)
    assert "wanted a checkout" in str(run(*words, "--beside", tmp_path).exception)
    (older / "nnpp_edge" / "__init__.py").write_text("raise ImportError('broken here')")
    ended = run(*words, "--beside", older)
    assert isinstance(ended.exception, NnppEdgeError)
    assert "older" in str(ended.exception) and "broken here" in str(ended.exception)


@pytest.mark.parametrize("words", [("--sizes", "8"), ("--sizes", "a"), ("--cores", "999"), ("--repetitions", "0")])
def test_wrong_use(words):
    assert type(run(*words).exception).__module__.startswith("click")
