"""A passage network in int8: how large its hidden outputs get, what int8 costs, and what it saves on this machine."""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from nnpp_edge.calibrate.chances import make_chances_true
from nnpp_edge.calibrate.passage_searches import SearchFigures, reliability, search_figures
from nnpp_edge.export.passage_to_onnx import HiddenRanges, write_passage
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.kernels.blocks import CHANNELS, MIDDLE
from nnpp_edge.runtime.network.model_file import METADATA_KEY, PassageMetadata, read_passage
from nnpp_edge.runtime.network.passage import STEPS
from nnpp_edge.runtime.network.passage_model import VehicleNetwork, logits
from nnpp_edge.training.passage import FIGURES, passage_loss
from nnpp_edge.training.passage_batches import PassageBatch, PassageMaps

PERCENTILE = 0.9999
"""Share of a convolution's outputs, on a vehicle's maps, that int8 can tell apart; the others are cut off."""
CALIBRATED, JUDGED = 256, 32
"""Vehicles of a data set to calibrate on and to judge on, at most."""
RIDGE, COVERED = 1e-3, 0.9
"""Of the fit of the convolutions' ranges; and the share of vehicles whose outliers alone are cut off."""
SEARCHED = 64
"""Vehicles on the first of whose maps a query is searched by either file."""
TIMED_BLOCKS, ROUNDS = 66, 50
"""Blocks to the side of the timed map, 256 cells and a rim, and timed runs of each file."""


@dataclass(frozen=True)
class PassageReport:
    """Both files beside each other; figures as `training.passage.FIGURES`."""

    source: str
    output: str
    vehicles: int
    fp32: dict[str, float]
    int8: dict[str, float]
    fp32_searches: SearchFigures
    int8_searches: SearchFigures
    fp32_ms: float
    int8_ms: float
    reliability: dict[str, list[tuple[float, ...]]]
    """Of the int8 file, see `reliability`."""

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self))

    def render(self) -> str:
        """The report as lines of text."""
        lines = [f"{self.output}: calibrated on {self.vehicles} vehicles", f"  {'':14}{'fp32':>9}{'int8':>9}"]
        lines += [f"  {name:14}{self.fp32[name]:9.4f}{self.int8[name]:9.4f}" for name in FIGURES]
        one, other = self.fp32_searches, self.int8_searches
        lines.append(f"  {'first region':14}{100 * one.success:8.1f}%{100 * other.success:8.1f}%")
        lines.append(f"  {'gap':14}{100 * one.gap:8.2f}%{100 * other.gap:8.2f}%")
        lines.append(f"  {'poses checked':14}{one.checks:9.0f}{other.checks:9.0f}")
        lines.append(f"  {'ms at 256²':14}{self.fp32_ms:9.2f}{self.int8_ms:9.2f}")
        lines.append(f"  {one.queries} queries; the exact search checks {one.exact_checks:.0f} poses")
        for name, rows in self.reliability.items():
            came = ", ".join(f"{said:.2f} {true:.2f}" for said, true, weight in rows if weight)
            lines.append(f"  chance of a {name} said, and how often it was: {came}")
        return "\n".join(lines)


def quantize_passage(model: Path, dataset: Path, output: Path, validation: Path | None = None) -> PassageReport:
    """Write an int8 file of a passage network in fp32, and judge both on a data set for such networks.

    Its chances are brought in line with one half of the vehicles that it is judged on; the other half judges.

    Raises ModelError where the file is no such network, DataSetError where a folder is no such set, OutputError where
    the file cannot be written.
    """
    network, facts = read_network(model)
    maps, judged_on = PassageMaps(dataset), PassageMaps(validation or dataset)
    count, held_out = min(len(maps), CALIBRATED), range(len(judged_on) // 2, len(judged_on))[:CALIBRATED]
    make_chances_true(network, [judged_on.batch(range(k, k + 1)) for k in held_out])
    ranges = hidden_ranges(network, [maps.batch(range(k, k + 1)) for k in range(count)])
    write_passage(network, output, name=output.stem, training=facts.training, ranges=ranges)
    with TemporaryDirectory() as folder:
        plain = Path(folder) / "fp32.onnx"
        write_passage(network, plain, name=output.stem, training=facts.training)
        return _report(model, (plain, output), judged_on, count)


def _report(model: Path, files: tuple[Path, Path], judged_on: PassageMaps, calibrated: int) -> PassageReport:
    """The same network in fp32 and in int8 beside each other."""
    parts = [judged_on.batch(range(k, k + 1)) for k in range(min(max(len(judged_on) // 2, 1), JUDGED))]
    answers = [_answers(path, parts) for path in files]
    one, other = (_figures(each, parts) for each in answers)
    by_fp32, by_int8 = search_figures(list(files), judged_on, SEARCHED)
    numbers = parts[0].numbers[0].numpy()
    times = _times([VehicleNetwork(read_passage(path), numbers, path) for path in files])
    came_so = reliability(answers[1], parts)
    return PassageReport(str(model), str(files[1]), calibrated, one, other, by_fp32, by_int8, *times, came_so)


def hidden_ranges(network: PassageNet, batches: list[PassageBatch]) -> HiddenRanges:
    """The greatest output of each hidden convolution, but for outliers, by vehicle: fitted to batches of one each."""
    found, said = [], []
    with torch.no_grad():
        for batch in batches:
            x, greatest = batch.blocks[0], []
            for layer in network.of_vehicle(batch.numbers[0]):
                x = layer(x)
                if isinstance(layer, nn.ReLU):
                    greatest.append(_percentile(x))
            found.append(np.log(greatest))
            said.append(network.describe(batch.numbers[:1])[0].numpy())
    logs, features = np.stack(found), np.stack(said).astype(np.float64)
    middle, mean = features.mean(0), logs.mean(0)
    apart = features - middle
    ridge = apart.T @ apart + RIDGE * len(batches) * np.eye(apart.shape[1])
    weight = np.linalg.solve(ridge, apart.T @ (logs - mean))
    above = np.quantile(logs - mean - apart @ weight, COVERED, axis=0)
    return HiddenRanges(weight.astype(np.float32), (mean + above - middle @ weight).astype(np.float32))


def _percentile(outputs: Tensor) -> float:
    return max(float(np.quantile(outputs.numpy(), PERCENTILE)), 1e-6)


def read_network(path: Path) -> tuple[PassageNet, PassageMetadata]:
    """The network in a file that `nnpp-edge export` wrote, and its metadata; ModelError for another one."""
    content = read_passage(path)
    try:
        model = onnx.load_from_string(content)
        facts = PassageMetadata.from_json({p.key: p.value for p in model.metadata_props}[METADATA_KEY], str(path))
        stored = {each.name: numpy_helper.to_array(each) for each in model.graph.initializer}
        count = sum(name.startswith("kernels") for name in stored)
        shapes = [(len(stored[f"kernels{i}"]), *stored[f"shape{i}"].tolist()) for i in range(count)]
        described, widths = stored["describe0.bias"].size, [shape[1] for shape in shapes[:-1]]
        network = PassageNet(widths, [shape[3] for shape in shapes[:-1]], shapes[0][0], described)
        state = {f"describe.{i}.weight": stored[f"describe{i}.weight"].T for i in (0, 2)}
        state |= {f"describe.{i}.bias": stored[f"describe{i}.bias"] for i in (0, 2)}
        for i, shape in enumerate(shapes):
            layer = "head" if i == count - 1 else f"convolutions.{i}"
            state[f"{layer}.kernels"] = stored[f"kernels{i}"].reshape(shape)
            for part in ("shares", "gain", "bias"):
                state[f"{layer}.{part}.weight"] = stored[f"{part}{i}.weight"].T
                state[f"{layer}.{part}.bias"] = stored[f"{part}{i}.bias"]
        network.load_state_dict({name: torch.from_numpy(np.array(part)) for name, part in state.items()})
    except Exception as error:  # protobuf, onnx and torch each have errors of their own
        raise ModelError(f"{path}: wanted a passage network of nnpp-edge export, got another graph") from error
    return network.eval(), facts


def _answers(path: Path, parts: list[PassageBatch]) -> list[NDArray[np.float32]]:
    """What a file answers of the maps of each part's one vehicle: (N, 16, R + 2, C + 2) logits."""
    content, found = read_passage(path), []
    for part in parts:
        network = VehicleNetwork(content, part.numbers[0].numpy(), path)
        blocks = torch.round(part.blocks[0] * STEPS + MIDDLE).to(torch.uint8).numpy()
        found.append(np.stack([logits(network.answers(each)) for each in blocks]))
    return found


def _figures(answers: list[NDArray[np.float32]], parts: list[PassageBatch]) -> dict[str, float]:
    """The same judged by the labels."""
    pairs = zip(answers, parts, strict=True)
    rows = [passage_loss(torch.from_numpy(each)[None], part.labels)[1] for each, part in pairs]
    return dict(zip(FIGURES, np.mean(rows, 0).tolist(), strict=True))


def _times(networks: list[VehicleNetwork]) -> tuple[float, float]:
    """Median milliseconds of each, in turns, on a map of random blocks."""
    shape = CHANNELS, TIMED_BLOCKS, TIMED_BLOCKS
    blocks = np.random.default_rng(0).integers(MIDDLE - 40, MIDDLE + 40, shape).astype(np.uint8)
    spent: list[list[float]] = [[] for _ in networks]
    for _ in range(ROUNDS):
        for network, times in zip(networks, spent, strict=True):
            began = time.perf_counter()
            network.answers(blocks)
            times.append(1e3 * (time.perf_counter() - began))
    one, other = (float(np.median(times)) for times in spent)
    return one, other
