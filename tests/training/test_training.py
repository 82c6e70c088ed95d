import dataclasses
import itertools
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nnpp_edge.model.network import Network, encode
from nnpp_edge.model.registry import PRESETS, Spec
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError
from nnpp_edge.runtime.network.model_file import UNSEEN
from nnpp_edge.terrain.dataset import read_samples
from nnpp_edge.training.batches import Batches
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.train import Processes, TrainSettings, train
from nnpp_edge.training.validation import Validator
from tests.training.conftest import RECIPE, SMALL, VALIDATED_AFTER

ROOT = Path(__file__).parent.parent.parent


def run(samples, folder, spec=SMALL, begin_with=None, **changes):
    """Train on the samples and validate on the first four; the path of the checkpoint."""
    settings = TrainSettings(**({"epochs": 1, "batch": 16, "warmup_steps": 5} | changes))
    few = samples.pick(range(4))
    return train(spec, settings, samples, few, folder, omega=RECIPE.omega, begin_with=begin_with)


def test_the_loss_falls_and_validation_searches(trained):
    history = json.loads((trained.folder / "history.json").read_text())
    assert history[-1]["loss"] < 0.8 * history[0]["loss"]
    assert 0.0 <= history[-1]["gap@0.25"] < 0.2
    assert history[-1]["region_share@1"] <= history[-1]["region_share@0.25"]
    saved = load_checkpoint(trained.folder / "checkpoint.pt")
    assert saved.progress.epoch == VALIDATED_AFTER[-1]
    assert saved.progress.history == history
    assert not saved.trained().training


def test_a_network_is_trained_in_bfloat16_where_that_is_asked_for(samples, tmp_path):
    half, full = (
        load_checkpoint(run(samples, tmp_path / kind, epochs=10_000, steps=12, precision=kind))
        for kind in ("bfloat16", "float32")
    )
    assert (half.facts()["precision"], full.facts()["precision"]) == ("bfloat16", "float32")
    assert {values.dtype for values in half.average.values() if values.ndim} == {torch.float32}
    losses = [checkpoint.progress.history[-1]["loss"] for checkpoint in (half, full)]
    assert losses[0] != losses[1] and losses[0] == pytest.approx(losses[1], rel=0.05)


def test_it_may_begin_at_the_full_learning_rate(samples, tmp_path):
    for limit in ({"steps": 2}, {"time_limit_s": 1e-3}):
        path = run(samples, tmp_path / str(*limit), warmup_steps=0, **limit)
        assert load_checkpoint(path).progress.step >= 1


def test_a_stopped_run_goes_on_where_it_was(samples, tmp_path):
    first = load_checkpoint(run(samples, tmp_path, epochs=1)).progress
    second = load_checkpoint(run(samples, tmp_path, epochs=2)).progress
    assert second.step == 2 * first.step
    assert len(second.history) == 2
    with pytest.raises(ModelError, match="wanted a checkpoint of"):
        run(samples, tmp_path, dataclasses.replace(SMALL, sigma=0.1))


def test_a_paused_run_goes_on_from_a_small_checkpoint(samples, tmp_path):
    """The rest is made of the mean weights in 16 bits, with a new optimiser that is warmed up."""
    settings = TrainSettings(epochs=1, batch=16, warmup_steps=5)
    few = samples.pick(range(4))

    def go(folder, pause_after_s=math.inf, small=True):
        path = train(
            SMALL,
            settings,
            samples,
            few,
            folder,
            omega=0.1,
            small_checkpoints=small,
            pause_after_s=pause_after_s,
        )
        return path.stat().st_size, load_checkpoint(path)

    whole = go(tmp_path / "whole", small=False)
    size, paused = go(tmp_path / "small", pause_after_s=0.0)
    assert paused.progress.step == 0 and size < 0.25 * whole[0]
    for one, other in zip(paused.network.values(), paused.average.values(), strict=True):
        assert torch.equal(one, other)
    _, resumed = go(tmp_path / "small")
    assert (
        resumed.progress.step == whole[1].progress.step > 5
        and resumed.origin["resumed_without_optimiser"]
    )
    assert len(resumed.progress.history) == 1


def test_every_validation_query_is_searched_on_the_map_as_it_is_held(samples):
    """At twice the network's resolution: a network that says yes everywhere gets the very optimum
    in every region.
    """
    larger = dataclasses.replace(
        samples,
        planes=samples.planes.repeat(2, 2).repeat(2, 3),
        start=2 * samples.start,
        goal=2 * samples.goal,
    )
    blurred = dataclasses.replace(larger, planes=np.where(larger.planes == 255, 200, larger.planes))
    for held in (larger, blurred):
        validator = Validator(held, SMALL, RECIPE.omega, 12)
        (found,) = validator.judge_probabilities(
            np.ones((12, SMALL.blocks, SMALL.blocks), np.float32), (1.0,)
        )
        cells = [len_of for _, len_of in validator.optima]
        assert (found.success, found.gap, found.region_share) == (1.0, 0.0, 1.0)
        assert found.mm == pytest.approx(np.mean(cells) / 128**2)
    with pytest.raises(DataSetError, match="a multiple of that"):
        Validator(dataclasses.replace(samples, planes=samples.planes[..., :60, :60]), SMALL, 0.1)


def test_a_run_may_begin_with_anothers_weights_and_keeps_what_it_began_with(
    samples, trained, tmp_path
):
    begin_with = trained.folder / "checkpoint.pt"
    theirs = load_checkpoint(begin_with)
    more = {"learning_rate": 1e-12, "weight_decay": 0.0}
    path = run(samples, tmp_path / "fine", begin_with=begin_with, steps=1, **more)
    ours = load_checkpoint(path)
    for one, other in zip(theirs.trained().parameters(), ours.trained().parameters(), strict=True):
        torch.testing.assert_close(one, other)
    facts = ours.facts()
    assert (
        facts["begun_with"] == theirs.facts()
        and facts["begun_with"]["steps"] == theirs.progress.step
    )
    assert (facts["input_size"], facts["threads"], facts["torch"]) == (64, 1, torch.__version__)
    assert "resumed_with_other_settings" not in facts
    run(samples, tmp_path / "fine", steps=2, **more)
    facts = load_checkpoint(path).facts()
    assert facts["resumed_with_other_settings"] is True and facts["begun_with"] == theirs.facts()
    narrow = Spec("edge", 64, options={"widths": (8, 8, 8, 8), "stem": 8})
    with pytest.raises(ModelError, match="wanted weights for"):
        run(samples, tmp_path / "other", narrow, begin_with=begin_with)


@pytest.fixture
def clock(monkeypatch):
    """A clock for the training that a busy machine does not disturb: 0.1 s pass whenever it is
    looked at.
    """
    ticks = itertools.count()
    monkeypatch.setattr(
        "nnpp_edge.training.train.time", SimpleNamespace(monotonic=lambda: next(ticks) / 10)
    )


@pytest.mark.parametrize("limit_s", [0.5, 4.0], ids=["within the warm-up", "after it"])
def test_a_training_limited_by_time_is_repeated_by_its_number_of_steps(
    samples, tmp_path, clock, limit_s
):
    """Bit for bit, and whatever else the machine does: the clock only decides how many steps there
    are.
    """
    path = run(samples, tmp_path / "limited", epochs=10_000, time_limit_s=limit_s)
    limited = load_checkpoint(path)
    progress = limited.progress
    facts = limited.facts()
    assert facts["steps"] == progress.step == progress.steps and (progress.step > 5) == (
        limit_s == 4.0
    )
    assert progress.spent_s == pytest.approx(limit_s, rel=0.5)
    again = load_checkpoint(run(samples, tmp_path / "again", epochs=10_000, steps=facts["steps"]))
    assert again.progress.step == facts["steps"]
    for name, weights in limited.average.items():
        assert torch.equal(weights, again.average[name])
    assert facts | {"seconds": 0} == again.facts() | {"seconds": 0}
    run(samples, tmp_path / "limited", epochs=10_000, time_limit_s=limit_s)
    assert load_checkpoint(path).progress.step == progress.step


def test_a_checkpoint_of_another_time_is_read_and_a_file_that_is_none_refused(trained, tmp_path):
    saved = torch.load(trained.folder / "checkpoint.pt", weights_only=True)
    path = tmp_path / "checkpoint.pt"
    saved["spec"]["architecture"] = "split"
    saved["settings"]["loss"] = "bce"
    torch.save(saved, path)
    assert load_checkpoint(path).spec == SMALL
    next(iter(saved["average"].values())).view(-1)[0] = math.nan
    torch.save(saved, path)
    with pytest.raises(ModelError, match="wanted a checkpoint of nnpp-edge train, got another"):
        load_checkpoint(path)
    for content in (b"", b"not a checkpoint", b"PK\x03\x04 half a zip"):
        path.write_bytes(content)
        with pytest.raises(ModelError, match="wanted a checkpoint"):
            load_checkpoint(path)


def test_batches_turn_map_query_and_target_together(samples):
    batches = Batches(samples, SMALL, TrainSettings(batch=16))
    seen = set()
    for planes, query, target in batches.epoch(0):
        assert planes.shape == (16, 2, 64, 64)
        assert query.shape == (16, 15, 8, 8)
        assert target.shape == (16, 16, 16)
        for one in range(16):
            # the optimal path's ends are where the target is 1 and the sharp encoding peaks
            sharp = query[one, [5, 11]].max(axis=0).repeat(2, axis=0).repeat(2, axis=1)
            assert sharp[target[one] > 0.99].max() > 0.4
            assert (
                target[one][planes[one, 1].reshape(16, 4, 16, 4).min(axis=(1, 3)) == 255].max(
                    initial=0
                )
                == 0
            )
        seen.add(planes.tobytes())
    assert len(seen) == len(batches)
    _, _, papers = next(
        iter(Batches(samples, SMALL, TrainSettings(batch=16, target="path")).epoch(0))
    )
    assert set(np.unique(papers)) == {0.0, 1.0}
    assert papers.sum(axis=(1, 2)).min() >= 2 and papers.mean() < 0.2


def test_two_processes_share_out_the_very_samples_of_one(samples):
    settings = TrainSettings(batch=8, seed=3)
    whole = Batches(samples, SMALL, settings)
    parts = [Batches(samples, SMALL, settings, rank=r, world=2) for r in range(2)]
    assert len(whole) == len(parts[0]) == len(parts[1])
    for batch, first, second in zip(
        whole.epoch(1), parts[0].epoch(1), parts[1].epoch(1), strict=True
    ):
        for arrays in zip(batch, first, second, strict=True):
            np.testing.assert_array_equal(arrays[0][0::2], arrays[1])
            np.testing.assert_array_equal(arrays[0][1::2], arrays[2])


NORMS = {"sample norm": 1e-4, "batch norm": 0.01}
"""The norms to train with, and by how much the losses of one process and of two may differ."""

TWO_PROCESSES = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from torch import distributed
start = distributed.init_process_group
distributed.init_process_group = lambda backend: distributed.is_initialized() or start(backend)
distributed.destroy_process_group = lambda: None
from tests.training.test_training import NORMS, losses_with_norm
for norm in NORMS:
    losses_with_norm(norm, Path(sys.argv[2]), Path(sys.argv[3]) / norm)
"""


def norm_of_one_sample(self, x):
    """In place of batch norm: what a sample comes to then depends on no other sample of
    the batch.
    """
    return torch.nn.functional.group_norm(x, 1, self.weight, self.bias)


def losses_with_norm(norm, dataset, folder, **changes):
    """Of each step of a run."""
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        if norm == "sample norm":
            patch.setattr(torch.nn.BatchNorm2d, "forward", norm_of_one_sample)
        run(read_samples(dataset), folder, epochs=2, validate_every_s=0.0, **changes)
    return losses(folder)


def losses(folder):
    return np.array([row["loss"] for row in json.loads((folder / "history.json").read_text())])


@pytest.mark.slow
def test_two_processes_under_torchrun_learn_as_one_does(dataset, tmp_path):
    """Step by step the same loss: to rounding, but for what batch norm makes of half a batch.

    Another seed, that is, other samples in a step, sets the curves ten times as far apart as is
    allowed.
    """
    (tmp_path / "run.py").write_text(TWO_PROCESSES)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    words = [str(tmp_path / "run.py"), str(ROOT), str(dataset), str(tmp_path)]
    quiet = os.environ | {"CUDA_VISIBLE_DEVICES": "", "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(
        [*command, *words], env=quiet, capture_output=True, text=True, timeout=150, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    for norm, tolerance in NORMS.items():
        two = losses(tmp_path / norm)
        one = losses_with_norm(norm, dataset, tmp_path / f"one {norm}")
        assert len(one) == len(two) > 10
        np.testing.assert_allclose(two, one, rtol=tolerance)
        other = losses_with_norm(norm, dataset, tmp_path / f"other {norm}", seed=2)
        assert np.abs(other / one - 1.0).max() > 10 * tolerance


def test_a_batch_that_cannot_be_shared_out_is_refused(samples, tmp_path, monkeypatch):
    monkeypatch.setattr(Processes, "join", lambda: Processes(0, 3, torch.device("cpu")))
    with pytest.raises(InvalidQueryError, match="multiple of the 3 processes, got 16"):
        run(samples, tmp_path)


def test_only_the_first_process_prints_and_draws(nnpp_edge, dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "nnpp_edge.training.train.train", lambda *_, **__: tmp_path / "checkpoint.pt"
    )
    monkeypatch.setattr("nnpp_edge.terrain.dataset.read_samples", lambda *_, **__: None)
    (tmp_path / "history.json").write_text('[{"step": 1, "spent_s": 1.0, "loss": 0.5}]')
    words = ("train", dataset, "--validation", dataset, "-o", tmp_path, "--json")
    monkeypatch.setenv("RANK", "1")
    ended = nnpp_edge(*words)
    assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert not (tmp_path / "curves.png").exists()
    monkeypatch.setenv("RANK", "0")
    assert json.loads(nnpp_edge(*words).out)["history"][0]["loss"] == 0.5


def test_the_presets_can_be_built_and_a_spec_that_no_network_fits_is_refused():
    assert (PRESETS["edge"].blocks, PRESETS["nnpp"].blocks) == (16, 32)
    assert (PRESETS["edge"].encoding, PRESETS["nnpp"].encoding) == ("ends", "gaussian")
    for spec in PRESETS.values():
        with torch.device("meta"):
            network = Network(spec)
            planes = torch.zeros(
                1, len(UNSEEN) if spec.encoding == "unseen" else 2, spec.input_size, spec.input_size
            )
        if spec.encoding == "unseen":
            assert network.eval()(planes, planes[:, :0]).shape == (1, 3, spec.blocks, spec.blocks)
            continue
        query = torch.from_numpy(encode(spec, (1.0, 2.0), (3.0, 4.0)))[None].to("meta")
        assert network.eval()(planes, query).shape == (1, spec.blocks, spec.blocks)
    with pytest.raises(ModelError, match="architecture must be one of edge, nnpp"):
        dataclasses.replace(SMALL, architecture="none")
