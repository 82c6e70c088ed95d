"""Queries to calibrate and to judge on, fed as the runtime feeds them."""

import numpy as np
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader

from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Samples

HELD_OUT_SHARE = 4
"""Of a data set's maps, one in this many is held out to judge on."""


class QueryReader(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime has no types
    """Inputs of a network for all queries of `samples`, one at a time; `model` lays them out but does not run."""

    def __init__(self, model: NetworkModel, samples: Samples) -> None:
        self.model, self.samples = model, samples
        self.at = 0

    def get_next(self) -> dict[str, NDArray[np.generic]] | None:
        """The next query's inputs by name; None at the end."""
        if self.at == len(self.samples):
            return None
        feed(self.model, self.samples, self.at)
        self.at += 1
        return {name: array.copy() for name, array in self.model.inputs.items()}


def feed(model: NetworkModel, samples: Samples, query: int) -> None:
    """Write a query and its map into a network's inputs."""
    planes, start, goal = samples.query(query)
    model.set_map(planes)
    model.set_query(start, goal)


def probabilities(model: NetworkModel, samples: Samples) -> NDArray[np.float32]:
    """(Q, B, B) what a network computes for all the queries."""
    out = np.empty((len(samples), model.metadata.blocks, model.metadata.blocks), np.float32)
    for query in range(len(samples)):
        feed(model, samples, query)
        out[query] = model.run()
    return out


def split(samples: Samples, seed: int) -> tuple[Samples, Samples]:
    """Queries to calibrate on and queries to judge on, of different maps.

    Raises
    ------
    DataSetError
        There are queries on one map only.
    """
    maps = np.random.default_rng([seed, 0]).permutation(np.unique(samples.map_index))
    if len(maps) < 2:
        raise DataSetError(f"wanted queries on at least two maps, got {len(maps)}")
    held_out = np.isin(samples.map_index, maps[: -(-len(maps) // HELD_OUT_SHARE)])
    return samples.pick(~held_out), samples.pick(held_out)


def spread(samples: Samples, count: int, seed: int) -> Samples:
    """At most `count` queries at random, from as many maps as there are: each map gives one, then a second, …"""
    order = np.random.default_rng([seed, 1]).permutation(len(samples))
    maps = samples.map_index[order]
    turn = np.empty(len(order), np.int64)  # how many queries of the same map come before
    by_map = np.argsort(maps, kind="stable")
    _, first, counts = np.unique(maps[by_map], return_index=True, return_counts=True)
    turn[by_map] = np.arange(len(order)) - np.repeat(first, counts)
    return samples.pick(order[np.argsort(turn, kind="stable")[:count]])
