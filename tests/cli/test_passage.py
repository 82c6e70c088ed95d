"""A passage network by the commands of docs/models.md, with small counts."""

import json

import pytest


def test_a_passage_network_is_made_from_terrain_by_commands(nnpp_edge, tmp_path):
    data, held_out, first, run = (str(tmp_path / name) for name in ("poses", "poses-val", "first", "run"))
    small = ("--poses", "--size", "64", "--workers", "1")
    for folder, seed in ((data, "1"), (held_out, "2")):
        assert nnpp_edge("dataset", "-o", folder, "--maps", "16", "--seed", seed, *small).code == 0
    train = ("train", data, "--validation", held_out, "--batch", "8", "--steps", "2")
    assert nnpp_edge(*train, "-o", first).code == 0
    assert nnpp_edge(*train, "-o", run, "--begin-with", f"{first}/checkpoint.pt").code == 0
    plain, small_file = str(tmp_path / "passage-fp32.onnx"), str(tmp_path / "passage.onnx")
    assert nnpp_edge("export", f"{run}/checkpoint.pt", "-o", plain, "--name", "passage", "--dataset", data).code == 0
    ended = nnpp_edge("quantize", plain, "--dataset", data, "--validation", held_out, "-o", small_file, "--json")
    report = json.loads(ended.out)
    assert report["int8"]["chance_error"] == pytest.approx(report["fp32"]["chance_error"], abs=0.02)
    for rows in report["reliability"].values():
        assert sum(weight for _, _, weight in rows) == pytest.approx(1.0, abs=1e-3)
    training = json.loads(nnpp_edge("models", small_file, "--json").out)["metadata"]["training"]
    assert (training["steps"], training["begun_with"]["steps"]) == (2, 2)
