"""Whether the exported model computes the same probabilities as the network."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from nnpp_edge.model.network import Network, encode
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Samples

LIMIT = 1e-4
"""Largest difference of two probabilities that passes; both sides compute in float32."""


@dataclass(frozen=True)
class Parity:
    """How two sides' probabilities differ over so many queries of `inputs`, ``dataset`` or ``random``."""

    queries: int
    inputs: str
    max_difference: float
    mean_difference: float
    limit: float
    passed: bool


@torch.no_grad()
def parity(network: Network, onnx_path: Path, samples: Samples | None = None, n: int = 32, seed: int = 1) -> Parity:
    """Compare a network in torch with its ONNX file as the runtime runs it, over `n` whole queries.

    They are some of the `samples`, or random maps and ends without samples. How `NetworkModel` lays out the map,
    encodes the query and reads the output is compared too.
    """
    network.eval()
    model, size, rng = NetworkModel(onnx_path), network.spec.input_size, np.random.default_rng(seed)
    if samples is None:
        drawn = rng.uniform(0, size - 1, (n, 2, 2)).tolist()
        queries = [(rng.random((2, size, size), np.float32), tuple(start), tuple(goal)) for start, goal in drawn]
    elif samples.planes.shape[-1] != size:
        raise DataSetError(f"wanted maps of {size} × {size} cells, got {samples.planes.shape[-1]}")
    else:
        chosen = rng.choice(len(samples), min(n, len(samples)), replace=False)
        queries = [samples.query(at) for at in chosen]
    differences = []
    for planes, start, goal in queries:
        query = torch.from_numpy(encode(network.spec, start, goal))
        wanted = torch.sigmoid(network(torch.from_numpy(planes)[None], query[None]))[0].numpy()
        model.set_map(planes)
        differences.append(np.abs(model.answer(start, goal) - wanted))
    worst, source = float(np.max(differences)), "random" if samples is None else "dataset"
    return Parity(len(differences), source, worst, float(np.mean(differences)), LIMIT, worst <= LIMIT)
