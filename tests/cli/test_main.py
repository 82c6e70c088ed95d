import sys

import numpy as np
import pytest


def test_a_missing_extra_is_named(nnpp_edge, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "nnpp_edge.cli.export", raising=False)
    for name in [
        m for m in sys.modules if m.startswith(("nnpp_edge.export", "nnpp_edge.training", "nnpp_edge.model"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    (tmp_path / "checkpoint.pt").write_bytes(b"any")
    ended = nnpp_edge("export", tmp_path / "checkpoint.pt", "-o", tmp_path / "model.onnx")
    ended.refused("nnpp-edge[train]")


def test_reading_a_geotiff_without_rasterio_names_the_extra(nnpp_edge, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    (tmp_path / "dem.tif").write_bytes(b"II*\0")
    nnpp_edge("costmap", tmp_path / "dem.tif", "-o", tmp_path / "cost.npy").refused("nnpp-edge[geo]")


def test_without_a_command_the_commands_are_listed(nnpp_edge):
    ended = nnpp_edge()
    assert ended.code == 2 and all(name in ended.err for name in ("plan", "warmup"))


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["plan", "--help"]])
def test_help_and_version_succeed(nnpp_edge, words):
    assert nnpp_edge(*words).code == 0


@pytest.mark.slow
def test_the_whole_chain_from_terrain_to_an_int8_model(nnpp_edge, tmp_path):
    """A model far too small and trained far too short, but every link is the real one."""
    data, run, int8 = (tmp_path / name for name in ("data", "run", "int8.onnx"))
    ended = nnpp_edge("dataset", "-o", data, "--maps", 6, "--workers", 1, "--size", 256, "--points", 3)
    assert ended.code == 0, ended.err
    assert (data / "samples.png").stat().st_size > 10_000
    words = ["train", data, "--validation", data, "-o", run, "--epochs", 1, "--batch", 4, "--threads", 1]
    ended = nnpp_edge(*words)
    assert ended.code == 0, ended.err
    assert (run / "curves.png").stat().st_size > 10_000
    ended = nnpp_edge("export", run / "checkpoint.pt", "-o", tmp_path / "fp32.onnx", "--name", "mine")
    assert ended.code == 0, ended.err
    ended = nnpp_edge("quantize", tmp_path / "fp32.onnx", "--dataset", data, "-o", int8, "--samples", 8)
    assert ended.code == 0, ended.err
    np.savez(tmp_path / "dem.npz", elevation_m=np.random.default_rng(0).normal(0, 0.1, (90, 120)), cell_size_m=1.0)
    words = ["plan", tmp_path / "dem.npz", "--start", "2,3", "--goal", "80,110", "--method", "nnpp", "--model", int8]
    ended = nnpp_edge(*words, "-o", tmp_path / "out")
    assert ended.code == 0, ended.err
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"path.geojson", "path.csv", "plan.png", "plan.json"}


def test_a_data_set_that_cannot_be_written_is_refused(nnpp_edge, tmp_path):
    (tmp_path / "file").write_text("in the way")
    nnpp_edge("dataset", "-o", tmp_path / "file" / "set", "--maps", 2).refused("wanted a folder to write to")
