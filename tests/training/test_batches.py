"""Batches: the runtime's encodings, positions, and the same ones from a run that goes on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training import train as training
from nnpp_edge.training.batches import POSITIONS, Batches, turned
from nnpp_edge.training.settings import TrainSettings
from tests.training.conftest import SMALL, enlarged

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
    order = np.arange(len(known))
    turns = np.sort(np.arange(len(known)) % POSITIONS)
    maps, _, _ = batches.made(order, order > 0, turns)
    for at, turn in enumerate(turns):
        heights = turned(torch.from_numpy(known.heights[at]), turn).numpy()
        wanted = np.empty(maps.shape[1:], np.float32)
        alone = replace(known.pick(slice(at, at + 1)), heights=heights[None])
        alone.encode(0, wanted)
        np.testing.assert_allclose(maps[at], wanted, atol=2e-6)


def test_batches_and_what_a_network_is_shown_are_made_on_the_device_that_trains(
    batches, monkeypatch
):
    """On a device that holds no numbers, and refuses to mix its tensors with a CPU's."""
    meta = torch.device("meta")
    pinned = []
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda self: pinned.append(self) or self)
    elsewhere = Batches(batches.samples, batches.spec, batches.settings, device=meta)
    maps, facts, targets = next(elsewhere.epoch(0))
    network = Network(batches.spec).to(meta)
    answers = network(*network.shown(maps, facts))
    assert {each.device for each in (maps, facts, targets, answers)} == {meta}
    assert answers.shape == targets.shape
    assert pinned


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


def test_a_resumed_run_sees_the_batches_of_an_unbroken_one(monkeypatch, samples, tmp_path):
    """In calls that end within an epoch."""
    seen = []
    step = training.TrainingRun.step

    def recorded(run, batch):
        seen.append(batch[0].clone())
        step(run, batch)

    monkeypatch.setattr(training.TrainingRun, "step", recorded)
    some = samples.pick(range(40))
    for folder, calls in (("whole", [9]), ("parts", [2, 7, 9])):
        for steps in calls:
            settings = TrainSettings(batch=8, steps=steps, validations=1, warmup_steps=1)
            few = samples.pick(range(2))
            training.train(SMALL, settings, some, few, tmp_path / folder, omega=0.011)
    assert len(seen) == 18
    assert all(map(torch.equal, seen[:9], seen[9:]))
