import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nnpp_edge.model.registry import PRESETS, Spec
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.training import train as training
from nnpp_edge.training.batches import Batches
from nnpp_edge.training.train import TrainSettings, load_checkpoint, train

ROOT = Path(__file__).parent.parent.parent
SMALL = Spec("edge", 64, options={"widths": [8, 8, 8, 8], "stem": 8})
RECIPE = Recipe((), maps=24, size=64, blocks=16, maps_per_shard=24, poolings=((1, 1.0),))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    make_dataset(RECIPE, folder, workers=1)
    return folder


def run(data, folder, validated=None, **changes):
    """Train on a data set and validate on its first `validated` queries; the path of the checkpoint."""
    samples = read_samples(data)
    few = {name: getattr(samples, name)[:validated] for name in ("map_index", "start", "goal", "excess", "on_path")}
    settings = TrainSettings(**({"epochs": 4, "batch": 16, "warmup_steps": 5} | changes))
    return train(SMALL, settings, samples, dataclasses.replace(samples, **few), folder, omega=RECIPE.omega)


def test_the_loss_falls_and_validation_searches(data, tmp_path):
    torch.set_num_threads(1)
    path = run(data, tmp_path, epochs=8, validate_every_s=0.0)
    history = json.loads((tmp_path / "history.json").read_text())
    assert history[-1]["loss"] < 0.8 * history[0]["loss"]
    assert 0.0 <= history[-1]["gap@0.25"] < 0.2
    assert history[-1]["region_share@1"] <= history[-1]["region_share@0.25"]
    network, saved = load_checkpoint(path)
    assert saved["progress"]["epoch"] == 8
    assert not network.training


def test_a_stopped_run_goes_on_where_it_was(data, tmp_path):
    torch.set_num_threads(1)
    run(data, tmp_path, epochs=1)
    first = load_checkpoint(tmp_path / "checkpoint.pt")[1]["progress"]
    run(data, tmp_path, epochs=3)
    second = load_checkpoint(tmp_path / "checkpoint.pt")[1]["progress"]
    assert second["step"] == 3 * first["step"]
    assert len(second["history"]) == 2
    with pytest.raises(ModelError, match="wanted a checkpoint of"):
        samples = read_samples(data)
        other = dataclasses.replace(SMALL, sigma=0.1)
        train(other, TrainSettings(epochs=1, batch=16), samples, samples, tmp_path, omega=RECIPE.omega)


def test_a_time_limit_ends_the_run(data, tmp_path):
    torch.set_num_threads(1)
    path = run(data, tmp_path, epochs=10_000, time_limit_s=1.0)
    assert 1.0 <= load_checkpoint(path)[1]["progress"]["spent_s"] < 20.0


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path):
    for content in (b"", b"not a checkpoint", b"PK\x03\x04 half a zip"):
        path = tmp_path / "checkpoint.pt"
        path.write_bytes(content)
        with pytest.raises(ModelError, match="wanted a checkpoint"):
            load_checkpoint(path)


def test_batches_turn_map_query_and_target_together(data):
    samples = read_samples(data)
    batches = Batches(samples, SMALL, 16)
    seen = set()
    for planes, query, target in batches.epoch(0):
        assert planes.shape == (16, 2, 64, 64)
        assert query.shape == (16, 3, 8, 8)
        assert target.shape == (16, 16, 16)
        for one in range(16):
            # the optimal path's ends are where the target is 1 and the sharp encoding peaks
            sharp = query[one, 1].repeat(2, axis=0).repeat(2, axis=1)
            assert sharp[target[one] > 0.99].max() > 0.5
            assert target[one][planes[one, 1].reshape(16, 4, 16, 4).min(axis=(1, 3)) == 255].max(initial=0) == 0
        seen.add(planes.tobytes())
    assert len(seen) == len(batches)


def test_two_processes_share_out_the_very_samples_of_one(data):
    samples = read_samples(data)
    whole = Batches(samples, SMALL, 8, seed=3)
    parts = [Batches(samples, SMALL, 4, seed=3, rank=r, world=2) for r in range(2)]
    assert len(whole) == len(parts[0]) == len(parts[1])
    for batch, first, second in zip(whole.epoch(1), parts[0].epoch(1), parts[1].epoch(1), strict=True):
        for arrays in zip(batch, first, second, strict=True):
            np.testing.assert_array_equal(arrays[0][0::2], arrays[1])
            np.testing.assert_array_equal(arrays[0][1::2], arrays[2])


def test_the_papers_target_is_the_optimal_path(data):
    samples = read_samples(data)
    batches = Batches(samples, SMALL, 16, target="path")
    _, _, target = next(iter(batches.epoch(0)))
    assert set(np.unique(target)) == {0.0, 1.0}
    assert target.sum(axis=(1, 2)).min() >= 2
    assert target.mean() < 0.2


TWO_PROCESSES = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import torch
from tests.training.test_training import norm_of_one_sample, run_step_by_step
torch.set_num_threads(1)
if sys.argv[4] == "sample norm":
    torch.nn.BatchNorm2d.forward = norm_of_one_sample
run_step_by_step(Path(sys.argv[2]), Path(sys.argv[3]))
"""


def norm_of_one_sample(self, x):
    """In place of batch norm: what a sample comes to then depends on no other sample of the batch."""
    return torch.nn.functional.group_norm(x, 1, self.weight, self.bias)


def run_step_by_step(data, folder, **changes):
    """A run whose history has a row for each step; the losses."""
    run(data, folder, validated=4, epochs=3, validate_every_s=0.0, **changes)
    return np.array([row["loss"] for row in json.loads((folder / "history.json").read_text())])


@pytest.mark.parametrize(("norm", "allowed"), [("sample norm", 1e-4), ("batch norm", 0.01)])
def test_two_processes_under_torchrun_learn_as_one_does(data, tmp_path, monkeypatch, norm, allowed):
    """Step by step the same loss: to rounding, but for what batch norm makes of half a batch.

    Another seed, that is, other samples in a step, sets the curves ten times as far apart as is allowed.
    """
    (tmp_path / "run.py").write_text(TWO_PROCESSES)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    words = [str(tmp_path / "run.py"), str(ROOT), str(data), str(tmp_path / "two"), norm]
    quiet = os.environ | {"CUDA_VISIBLE_DEVICES": "", "OMP_NUM_THREADS": "1"}
    ended = subprocess.run([*command, *words], env=quiet, capture_output=True, text=True, timeout=240, check=False)
    assert ended.returncode == 0, ended.stderr[-2000:]
    two = np.array([row["loss"] for row in json.loads((tmp_path / "two" / "history.json").read_text())])
    torch.set_num_threads(1)
    if norm == "sample norm":
        monkeypatch.setattr(torch.nn.BatchNorm2d, "forward", norm_of_one_sample)
    one = run_step_by_step(data, tmp_path / "one")
    assert len(one) == len(two) > 10
    np.testing.assert_allclose(two, one, rtol=allowed)
    other = run_step_by_step(data, tmp_path / "other", seed=2)
    assert np.abs(other / one - 1.0).max() > 10 * allowed


def test_a_batch_that_cannot_be_shared_out_is_refused(data, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "_join_processes", lambda: (0, 3, torch.device("cpu")))
    with pytest.raises(InvalidQueryError, match="multiple of the 3 processes, got 16"):
        run(data, tmp_path)


def test_only_the_first_process_prints_and_draws(nnpp_edge, data, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "train", lambda *_, **__: tmp_path / "checkpoint.pt")
    monkeypatch.setattr("nnpp_edge.terrain.dataset.read_samples", lambda *_, **__: None)
    (tmp_path / "history.json").write_text('[{"step": 1, "spent_s": 1.0, "loss": 0.5}]')
    words = ("train", data, "--validation", data, "-o", tmp_path, "--json")
    monkeypatch.setenv("RANK", "1")
    ended = nnpp_edge(*words)
    assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert not (tmp_path / "curves.png").exists()
    monkeypatch.setenv("RANK", "0")
    assert json.loads(nnpp_edge(*words).out)["history"][0]["loss"] == 0.5


def test_the_presets_can_be_built():
    assert (PRESETS["edge"].blocks, PRESETS["edge-256"].blocks) == (16, 64)
    assert PRESETS["nnpp"].blocks == 32
    assert PRESETS["edge"].encoding == "ends"
    assert PRESETS["nnpp"].encoding == "gaussian"
