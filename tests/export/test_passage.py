"""Passage networks from torch to the prices of links."""

import numpy as np
import pytest
import torch

from nnpp_edge.calibrate.passage import read_network
from nnpp_edge.export.passage_to_onnx import write_passage
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.runtime.errors import InvalidMapError, ModelError
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.passage import shown_blocks, shown_numbers, vehicle_numbers
from nnpp_edge.runtime.network.passage_model import ANSWER_STEPS, PassageModel, logits
from nnpp_edge.runtime.region.looked import NOT_LOOKED_AT, LookedMap
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.synthetic import fractal

BODIES = Vehicle(1.5, 1.2, 0.3), Vehicle(1.0, 0.9, 0.2, max_step_m=0.15), Vehicle(1.9, 1.1, 0.25, axles=3)
CELL = 0.25


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(1)
    made = PassageNet((8, 8, 8), (3, 3, 3), 2, 16)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return made.eval()


@pytest.fixture(scope="module")
def model_file(network, tmp_path_factory):
    path = tmp_path_factory.mktemp("passage") / "small.onnx"
    write_passage(network, path, name="small", training={})
    return path


def heights_of(size, seed=0):
    return fractal(np.random.default_rng(seed), size, CELL, 6.0)


@pytest.mark.parametrize("vehicle", BODIES)
def test_the_file_answers_what_torch_does_for_every_vehicle(network, model_file, vehicle):
    blocks = shown_blocks(heights_of(64), (CELL, CELL), vehicle, (-1, -1), (18, 18))
    numbers = torch.from_numpy(shown_numbers(vehicle_numbers(vehicle, (CELL, CELL))))
    with torch.no_grad():
        wanted = network((torch.from_numpy(blocks).float()[None, None] - 128) / 127, numbers[None])[0, 0]
        plain = network.of_vehicle(numbers)((torch.from_numpy(blocks).float()[None] - 128) / 127)[0]
    answers = logits(PassageModel(model_file).of(vehicle, (CELL, CELL)).answers(blocks))
    np.testing.assert_allclose(answers, wanted.clip(-8.0, 127 / ANSWER_STEPS), atol=0.5 / ANSWER_STEPS + 1e-4)
    np.testing.assert_allclose(plain, wanted, atol=1e-4)


def test_a_network_is_read_back_from_its_file(network, model_file):
    back, _ = read_network(model_file)
    assert all(torch.equal(back.state_dict()[name], part) for name, part in network.state_dict().items())


@pytest.mark.parametrize("part", [(0, 0, 9, 5), (40, 31, 17, 20), (90, 80, 6, 16)])
def test_a_patch_is_looked_at_again_and_nothing_else_need_be(model_file, part):
    heights, (row, col, rows, cols) = heights_of(96), part
    sides, rule, model = (CELL, CELL), Traversability(), StepModel.of("paper")
    state = MapState.of_elevation(heights, sides, rule, model, vehicle=BODIES[0])
    looked = LookedMap(state, PassageModel(model_file))
    before = looked.links.prices.copy()
    patch = heights[row : row + rows, col : col + cols] + np.float32(0.3) * heights_of(96, 5)[:rows, :cols]
    state.update_elevation(row, col, patch)
    heights[row : row + rows, col : col + cols] = patch
    fresh = LookedMap(MapState.of_elevation(heights, sides, rule, model, vehicle=BODIES[0]), PassageModel(model_file))
    assert not np.allclose(before, fresh.links.prices, rtol=1e-4)
    np.testing.assert_allclose(looked.links.prices, fresh.links.prices, rtol=1e-4)


def test_a_vehicle_outside_the_range_and_another_file_are_refused(model_file, tmp_path):
    with pytest.raises(InvalidMapError, match="length in cells"):
        PassageModel(model_file).of(BODIES[0], (0.05, 0.05))
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no model")
    with pytest.raises(ModelError, match="wanted"):
        PassageModel(broken)


def test_what_is_looked_at_in_parts_has_the_prices_of_the_whole_map(model_file):
    heights, sides = heights_of(300), (CELL, CELL)
    rule, model = Traversability(), StepModel.of("paper")
    state = MapState.of_elevation(heights, sides, rule, model, vehicle=BODIES[0])
    looked, whole = (LookedMap(state, PassageModel(model_file)) for _ in range(2))
    blocks = (77, 77, 8)
    part = looked.links_within((10, 140, 90, 100)).prices.reshape(blocks).copy()
    assert (part[1:32, 1:32, 1] == NOT_LOOKED_AT).all()
    np.testing.assert_allclose(part[3:26, 36:61], whole.links.prices.reshape(blocks)[3:26, 36:61], rtol=1e-4)
    looked.links_within((100, 0, 100, 100))
    np.testing.assert_allclose(looked.links.prices, whole.links.prices, rtol=1e-4)
