"""Batches: the runtime's encodings, positions, and the same ones from a run that goes on."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.terrain.dataset import GrowingSet, make_dataset, read_samples
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training import train as training
from nnpp_edge.training.batches import POSITIONS, Batches, turned
from nnpp_edge.training.checkpoint import TrainSettings, load_checkpoint
from tests.training.conftest import RECIPE, SMALL, enlarged

APPEARS = {1: "shard-00001.npz", 4: "shard-00002.npz"}
"""Shards of a growing set, by the step that they appear at."""
PAPERS = Spec("nnpp", 128, options={"width": 2})


@pytest.fixture(scope="module")
def known():
    """Maps known by their blocks; on one of them a corner is unknown, another has no hard limit."""
    rng = np.random.default_rng(5)
    count = 40
    heights = rng.normal(0.0, 30.0, (count, 16, 16)).astype(np.float32)
    heights[3, :5, :7] = np.nan
    facts = np.full((3, count), [[2.0], [25.0], [20.0]], np.float32)
    facts[2, 1] = np.inf
    answers = rng.integers(255, size=(count, 3, 16, 16), dtype=np.uint8)
    return KnownMaps(heights, answers, np.full(count, 4, np.int32), *facts)


@pytest.fixture(params=["edge", "nnpp", "unseen"])
def batches(request, samples, known):
    """Batches of each architecture, and the settings."""
    settings = TrainSettings(batch=8, seed=4)
    of, spec = {
        "edge": (samples, SMALL),
        "nnpp": (enlarged(samples, 128), PAPERS),
        "unseen": (known, Spec("unseen", 16)),
    }[request.param]
    batches = Batches(of, spec, settings)
    batches.samples = of
    return batches


def alike(one, other):
    pairs = zip(one, other, strict=True)
    return all(torch.equal(*map(torch.nan_to_num, each)) for each in pairs)


def test_coarse_maps_are_turned_as_if_encoded_in_their_position(known):
    """The rises along rows and columns turn with the map."""
    batches = Batches(known, Spec("unseen", 16), TrainSettings(batch=40))
    order = np.arange(len(known))[None]
    turns = np.sort(np.arange(len(known)) % POSITIONS)
    maps, _, _ = batches.made(batches.held, order, order > 0, turns)
    for at, turn in enumerate(turns):
        heights = turned(torch.from_numpy(known.heights[at]), turn).numpy()
        wanted = np.empty(maps.shape[1:], np.float32)
        alone = replace(known.pick(slice(at, at + 1)), heights=heights[None])
        alone.encode(0, wanted)
        np.testing.assert_allclose(maps[at], wanted, atol=2e-6)


@pytest.mark.parametrize("streamed", [False, True])
def test_batches_and_what_a_network_is_shown_are_made_on_the_device_that_trains(
    batches, monkeypatch, streamed
):
    """On a device that holds no numbers, and refuses to mix its tensors with a CPU's; `streamed`
    where it has no room for the maps.
    """
    meta = torch.device("meta")
    pinned = []
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda self: pinned.append(self) or self)
    if streamed:
        monkeypatch.setattr(Batches, "_placed", lambda _, held: held)
    elsewhere = Batches(batches.samples, batches.spec, batches.settings, device=meta)
    maps, facts, targets = next(elsewhere.epoch(0))
    network = Network(batches.spec).to(meta)
    answers = network(*network.shown(maps, facts))
    assert {each.device for each in (maps, facts, targets, answers)} == {meta}
    assert answers.shape == targets.shape
    assert bool(pinned) == streamed


def test_the_eight_positions_differ():
    cells = torch.arange(9).reshape(3, 3)
    assert len({tuple(turned(cells, turn).ravel().tolist()) for turn in range(POSITIONS)}) == 8


def test_the_rest_of_an_epoch_is_that_of_the_whole(batches):
    whole = list(batches.epoch(2))
    assert len(whole) == len(batches) > 4
    for skip in (1, 4):
        rest = list(batches.epoch(2, skip))
        assert len(rest) == len(whole) - skip
        assert all(map(alike, rest, whole[skip:]))
    assert not alike(next(batches.epoch(3)), whole[0])


def test_samples_added_are_those_read_at_once(samples):
    settings = TrainSettings(batch=8)
    half = len(samples) // 2
    grown = Batches(samples.pick(range(half)), SMALL, settings)
    grown.extend(samples.pick(range(half, len(samples))))
    whole = Batches(samples, SMALL, settings)
    assert all(map(alike, grown.epoch(0), whole.epoch(0)))


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """A data set of three shards."""
    folder = tmp_path_factory.mktemp("shards") / "set"
    make_dataset(msgspec.structs.replace(RECIPE, maps=12, maps_per_shard=4), folder, workers=1)
    return folder


def planes_of_a_run(monkeypatch, source, judged_on, folder, pauses):
    """The planes of all steps on a set whose second and third shards appear within an epoch, in
    calls that end after these numbers of steps.
    """
    set_of = folder / "set"
    set_of.mkdir(parents=True)
    shutil.copy(source / "dataset.json", set_of)
    seen = []
    step = training.TrainingRun.step

    def recorded(run, batch):
        if run.progress.step in APPEARS:
            shutil.copy(source / APPEARS[run.progress.step], set_of)
        seen.append(batch[0].clone())
        step(run, batch)

    monkeypatch.setattr(training.TrainingRun, "step", recorded)
    shutil.copy(source / "shard-00000.npz", set_of)
    for steps in pauses:
        settings = TrainSettings(batch=8, steps=steps, validations=1, warmup_steps=1)
        with GrowingSet(set_of, size=64) as growing:
            training.train(SMALL, settings, growing, judged_on, folder / "run", omega=0.011)
    return seen


def test_a_resumed_run_on_a_growing_set_sees_the_batches_of_an_unbroken_one(
    monkeypatch, samples, shards, tmp_path
):
    few = samples.pick(range(2))
    with monkeypatch.context() as patch:
        whole = planes_of_a_run(patch, shards, few, tmp_path / "whole", [9])
    with monkeypatch.context() as patch:
        parts = planes_of_a_run(patch, shards, few, tmp_path / "parts", [2, 5, 9])
    assert len(whole) == len(parts) == 9
    assert all(map(torch.equal, whole, parts))
    assert load_checkpoint(tmp_path / "parts" / "run" / "last.pt").progress.shards > 1


def test_missing_shards_are_made_while_a_set_is_read(shards, tmp_path):
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("dataset.json", "shard-00000.npz"):
        shutil.copy(shards / name, folder)
    with GrowingSet(folder, make=True) as growing:
        first = growing.read(growing.ready())
        while growing.growing():
            os.sched_yield()
        rest = growing.read(growing.ready())
    whole = read_samples(Path(shards))
    np.testing.assert_array_equal(np.concatenate([first.excess, rest.excess]), whole.excess)
