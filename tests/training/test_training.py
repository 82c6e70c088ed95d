import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from nnpp_edge.model.registry import PRESETS, Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.terrain.dataset import Recipe, make_dataset, read_samples
from nnpp_edge.training.batches import Batches
from nnpp_edge.training.train import TrainSettings, load_checkpoint, train

SMALL = Spec("edge", 64, options={"widths": [8, 8, 8, 8], "stem": 8})
RECIPE = Recipe((), maps=24, size=64, blocks=16, maps_per_shard=24, poolings=((1, 1.0),))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    make_dataset(RECIPE, folder, workers=1)
    return folder


def run(data, folder, **changes):
    samples = read_samples(data)
    settings = TrainSettings(**({"epochs": 4, "batch": 16, "warmup_steps": 5} | changes))
    return train(SMALL, settings, samples, samples, folder, omega=RECIPE.omega)


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


def test_two_processes_share_a_batch_without_overlap(data):
    samples = read_samples(data)
    whole = Batches(samples, SMALL, 8, seed=3)
    parts = [Batches(samples, SMALL, 4, seed=3, rank=r, world=2) for r in range(2)]
    assert len(whole) == len(parts[0]) == len(parts[1])

    def shares(batches):
        return sorted(float(t.sum()) for _, _, ts in batches.epoch(0) for t in ts)

    np.testing.assert_allclose(shares(whole), sorted(shares(parts[0]) + shares(parts[1])), rtol=1e-5)


def test_the_papers_target_is_the_optimal_path(data):
    samples = read_samples(data)
    batches = Batches(samples, SMALL, 16, target="path")
    _, _, target = next(iter(batches.epoch(0)))
    assert set(np.unique(target)) == {0.0, 1.0}
    assert target.sum(axis=(1, 2)).min() >= 2
    assert target.mean() < 0.2


def test_torchrun_trains_in_two_processes(data, tmp_path):
    code = (
        "import sys; from pathlib import Path\n"
        "import torch; torch.set_num_threads(1)\n"
        "from nnpp_edge.model.registry import Spec\n"
        "from nnpp_edge.terrain.dataset import read_samples\n"
        "from nnpp_edge.training.train import TrainSettings, train\n"
        "samples = read_samples(Path(sys.argv[1]))\n"
        "spec = Spec('edge', 64, options={'widths': [8, 8, 8, 8], 'stem': 8})\n"
        "settings = TrainSettings(epochs=2, batch=16, warmup_steps=5)\n"
        "train(spec, settings, samples, samples, Path(sys.argv[2]), omega=0.011)\n"
    )
    script = tmp_path / "run.py"
    script.write_text(code)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", str(script)]
    result = subprocess.run([*command, str(data), str(tmp_path / "two")], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr[-2000:]
    run(data, tmp_path / "one", epochs=2)
    one, two = (json.loads((tmp_path / name / "history.json").read_text())[-1] for name in ("one", "two"))
    assert one["step"] == two["step"]
    assert np.isfinite(two["gap@0.25"])


def test_the_presets_can_be_built():
    assert PRESETS["edge"].blocks == 64
    assert PRESETS["nnpp"].blocks == 32
    assert PRESETS["nnpp"].encoding == "gaussian"
