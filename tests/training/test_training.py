"""Training runs: their losses, how they are resumed and repeated, checkpoints, batches."""

import itertools
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nnpp_edge.model.encoding import encode_ends
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.training import train as training
from nnpp_edge.training.batches import Batches
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.settings import TrainSettings
from nnpp_edge.training.train import train
from nnpp_edge.training.validation import Judgement, Validator
from tests.training.conftest import RECIPE, SMALL, VALIDATED_AFTER, enlarged

RUN = ("begin_with", "judged_on")


def run(samples, folder, spec=SMALL, **changes):
    """Train on the samples and validate on the first four; the last checkpoint."""
    options = {name: changes.pop(name) for name in RUN if name in changes}
    usual = {"epochs": 1, "batch": 16, "warmup_steps": 5, "validations": 1}
    settings = TrainSettings(**(usual | changes))
    few = options.pop("judged_on", None) or samples.pick(range(4))
    train(spec, settings, samples, few, folder, omega=RECIPE.omega, **options)
    return load_checkpoint(folder / "last.pt")


def test_the_loss_falls_and_validation_searches(trained):
    history = json.loads((trained.folder / "history.json").read_text())
    saved = load_checkpoint(trained.folder / "last.pt")
    assert "loss" not in history[0]
    assert history[-1]["loss"] < 0.8 * history[1]["loss"]
    assert history[-1]["factor"] == 0.2, "where planners use `edge`"
    assert 0.0 <= history[-1]["gap"] < 0.2
    assert 0.0 < history[-1]["region_share"] < 0.9
    assert saved.progress.epoch == VALIDATED_AFTER[-1]
    assert saved.progress.history == history
    assert not saved.trained().training


def test_a_network_is_trained_in_bfloat16_where_that_is_asked_for(samples, tmp_path, monkeypatch):
    """What it is shown is encoded in float32 all the same."""
    shown = Network.shown
    encoded_in_half = set()

    def recorded(*arguments):
        encoded_in_half.add(torch.is_autocast_enabled("cpu"))
        return shown(*arguments)

    monkeypatch.setattr(Network, "shown", recorded)
    half, full = (
        run(samples, tmp_path / kind, epochs=10_000, steps=12, precision=kind)
        for kind in ("bfloat16", "float32")
    )
    assert half.facts()["precision"] == "bfloat16"
    assert {values.dtype for values in half.average.values() if values.ndim} == {torch.float32}
    assert encoded_in_half == {False}
    losses = [saved.progress.history[-1]["loss"] for saved in (half, full)]
    assert losses[0] != losses[1]
    assert losses[0] == pytest.approx(losses[1], rel=0.05)


@pytest.mark.parametrize("limit", [{"steps": 2}, {"time_limit_s": 1e-3}], ids=str)
def test_it_may_begin_at_the_full_learning_rate(samples, tmp_path, limit):
    assert run(samples, tmp_path, warmup_steps=0, **limit).progress.step >= 1


def test_a_stopped_run_goes_on_where_it_was(samples, tmp_path):
    first = run(samples, tmp_path, epochs=1).progress
    second = run(samples, tmp_path, epochs=2).progress
    assert second.step == 2 * first.step
    assert len(second.history) == 3  # before, and after each
    with pytest.raises(ModelError, match="wanted a checkpoint of"):
        run(samples, tmp_path, replace(SMALL, sigma=0.1))


@pytest.mark.parametrize("greatest", [255, 200], ids=["impassable cells", "averaged ones"])
def test_every_validation_query_is_searched_on_the_map_as_it_is_held(samples, greatest):
    """At twice the network's resolution: a network that says yes everywhere gets the very optimum
    in every region.
    """
    planes = np.minimum(samples.planes, greatest)
    scaled = replace(samples, planes=planes, start=2 * samples.start, goal=2 * samples.goal)
    held = enlarged(scaled, 128)
    validator = Validator(held, SMALL, RECIPE.omega, 12)
    everywhere = np.ones((12, SMALL.blocks, SMALL.blocks), np.float32)
    found = validator.judge_answers(everywhere, 1.0)
    assert (found.success, found.gap, found.region_share) == (1.0, 0.0, 1.0)
    cells = [cells for _, cells in validator.optima]
    assert found.mm == pytest.approx(np.mean(cells) / 128**2)


def test_a_run_may_begin_with_anothers_weights_and_keeps_what_it_began_with(
    samples, trained, tmp_path
):
    begin_with = trained.folder / "last.pt"
    theirs = load_checkpoint(begin_with)
    unmoved = {"learning_rate": 1e-12, "weight_decay": 0.0}
    ours = run(samples, tmp_path, begin_with=begin_with, steps=1, **unmoved)
    for one, other in zip(theirs.trained().parameters(), ours.trained().parameters(), strict=True):
        torch.testing.assert_close(one, other)
    facts = ours.facts()
    assert facts["begun_with"] == theirs.facts()
    assert facts["begun_with"]["steps"] == theirs.progress.step
    assert (facts["input_size"], facts["threads"], facts["torch"]) == (64, 1, torch.__version__)
    assert "resumed_with_other_settings" not in facts
    facts = run(samples, tmp_path, steps=2, **unmoved).facts()
    assert facts["resumed_with_other_settings"] is True
    assert facts["begun_with"] == theirs.facts()


def test_weights_of_another_network_are_refused(samples, trained, tmp_path):
    narrow = Spec("edge", 64, options={"widths": (8, 8, 8, 8), "stem": 8})
    with pytest.raises(ModelError, match="wanted weights for"):
        run(samples, tmp_path, narrow, begin_with=trained.folder / "last.pt")


@pytest.fixture
def scored(samples, tmp_path, monkeypatch):
    """Trains by validations with these scores. The progress at the end, and which validations each
    file was saved after.
    """

    def train(scores, **settings):
        saved = {"best.pt": [], "last.pt": []}
        at_end = []
        left = iter(scores)

        def judge(network):
            return Judgement(0.2, 1.0, 0.1, 0.1, 0.1, next(left))

        def save(checkpoint, path):
            saved[path.name].append(len(checkpoint.progress.history))
            at_end[:] = [checkpoint.progress]

        monkeypatch.setattr(training, "Validator", lambda *_: SimpleNamespace(judge=judge))
        monkeypatch.setattr(training.Checkpoint, "save", save)
        steps = len(scores) - 1
        asked = TrainSettings(batch=2, steps=steps, validations=steps, **settings)
        training.train(SMALL, asked, samples, samples, tmp_path, omega=RECIPE.omega)
        return *at_end, saved

    return train


def test_the_best_weights_are_those_of_the_least_score(scored):
    progress, saved = scored([0.9, 0.5, 0.7, 0.4, 0.6])
    assert saved == {"best.pt": [1, 2, 4], "last.pt": [1, 2, 3, 4, 5, 5]}
    assert (progress.best, progress.waited) == (3, 1)


def test_a_training_that_gets_worse_ends_early_where_that_is_asked_for(scored):
    worse = [0.5, 0.1, 0.2, 0.3, 0.4, 0.5]
    progress, saved = scored(worse, patience=2)
    assert (progress.step, progress.steps, saved["best.pt"]) == (3, 5, [1, 2])


@pytest.fixture
def clock(monkeypatch):
    """A clock for the training that a busy machine does not disturb: 0.1 s pass whenever it is
    read.
    """
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: next(ticks) / 10)
    monkeypatch.setattr("nnpp_edge.training.train.time", clock)


@pytest.mark.parametrize("limit_s", [0.5, 4.0], ids=["within the warm-up", "after it"])
def test_a_training_limited_by_time_is_repeated_by_its_number_of_steps(
    samples, tmp_path, clock, limit_s
):
    """Bit for bit: the clock only decides how many steps there are."""
    limits = {"epochs": 10_000, "time_limit_s": limit_s}
    limited = run(samples, tmp_path / "limited", **limits)
    progress = limited.progress
    assert progress.step == progress.steps
    assert (progress.step > 5) == (limit_s == 4.0)
    assert progress.spent_s == pytest.approx(limit_s, rel=0.5)
    again = run(samples, tmp_path / "again", epochs=10_000, steps=progress.steps)
    for name, weights in limited.average.items():
        assert torch.equal(weights, again.average[name])
    assert limited.facts() | {"seconds": 0} == again.facts() | {"seconds": 0}
    assert run(samples, tmp_path / "limited", **limits).progress.step == progress.step


@pytest.fixture
def saved(trained):
    """The content of a checkpoint."""
    return torch.load(trained.folder / "last.pt", weights_only=True)


def test_a_checkpoint_of_another_time_is_read(saved, tmp_path):
    saved["spec"]["architecture"] = "split"
    saved["settings"]["loss"] = "bce"
    torch.save(saved, tmp_path / "old.pt")
    assert load_checkpoint(tmp_path / "old.pt").spec == SMALL


def test_weights_that_are_not_finite_are_refused(saved, tmp_path):
    next(iter(saved["average"].values())).view(-1)[0] = math.nan
    torch.save(saved, tmp_path / "nan.pt")
    with pytest.raises(ModelError, match="wanted a checkpoint of nnpp-edge train, got another"):
        load_checkpoint(tmp_path / "nan.pt")


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04 half a zip"])
def test_a_file_that_is_no_checkpoint_is_refused(tmp_path, content):
    (tmp_path / "other.pt").write_bytes(content)
    with pytest.raises(ModelError, match="wanted a checkpoint"):
        load_checkpoint(tmp_path / "other.pt")


def test_batches_turn_map_query_and_target_together(samples):
    batches = Batches(samples, SMALL, TrainSettings(batch=16))
    seen = set()
    for batch in batches.epoch(0):
        planes, ends, target = (each.numpy() for each in batch)
        query = encode_ends(SMALL, batch[1]).numpy()
        assert planes.shape == (16, 2, 64, 64)
        assert ends.shape == (16, 2, 2)
        assert target.shape == (16, 16, 16)
        # the optimal path's ends are where the target is 1 and the sharp encoding peaks
        sharp = query[:, [5, 11]].max(axis=1).repeat(2, axis=1).repeat(2, axis=2)
        assert np.where(target > 0.99, sharp, 0.0).max(axis=(1, 2)).min() > 0.4
        impassable = planes[:, 1].reshape(16, 16, 4, 16, 4).min(axis=(2, 4)) == 255
        assert target[impassable].max(initial=0) == 0
        seen.add(planes.tobytes())
    assert len(seen) == len(batches)


def test_the_papers_targets_are_the_blocks_of_the_path(samples):
    batches = Batches(samples, SMALL, TrainSettings(batch=16, target="path"))
    target = next(batches.epoch(0))[2].numpy()
    assert set(np.unique(target)) == {0.0, 1.0}
    assert target.sum(axis=(1, 2)).min() >= 2
    assert target.mean() < 0.2


def test_an_architecture_that_does_not_exist_is_refused():
    with pytest.raises(ModelError, match="architecture must be one of edge, nnpp"):
        replace(SMALL, architecture="none")
