"""Which nodes lose the most by being quantised."""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.calibrate.calibration_set import probabilities
from nnpp_edge.calibrate.quantizer import Quantizer
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Samples

MOST_FLOAT = 3
"""At most one convolution in this many is left float: beyond that int8 no longer pays."""


def node_errors(quantizer: Quantizer, samples: Samples, *, reduce_range: bool = True) -> dict[str, float]:
    """Quantise one convolution at a time; what that does to the probabilities of a few queries.

    Gives the signal-to-noise ratio for each node, of probability to error, in dB, the worst node first.
    """
    wanted = probabilities(quantizer.model, samples)
    found = {}
    for node in quantizer.nodes:
        path = quantizer.build("single", only=node, reduce_range=reduce_range)
        found[node] = snr_db(wanted, probabilities(NetworkModel(path), samples))
    return dict(sorted(found.items(), key=lambda item: item[1]))


def exclude_worst(
    quantizer: Quantizer,
    samples: Samples,
    target: float,
    *,
    reduce_range: bool = True,
    errors: dict[str, float] | None = None,
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Leave the worst nodes float, one, two, four, …, until the mean difference is at most `target`.

    Gives the nodes to exclude (none if int8 throughout is good enough; no more than a third of them), and the ranking
    of `node_errors` if it was needed.
    """
    wanted = probabilities(quantizer.model, samples)
    errors = errors or {}
    count = 0
    while True:
        exclude = tuple(errors)[:count]
        path = quantizer.build("excluding", exclude=exclude, reduce_range=reduce_range)
        if np.abs(probabilities(NetworkModel(path), samples) - wanted).mean() <= target:
            return exclude, errors
        errors = errors or node_errors(quantizer, samples, reduce_range=reduce_range)
        most = len(quantizer.nodes) // MOST_FLOAT
        if count >= most:
            return exclude, errors
        count = min(max(1, 2 * count), most)


def snr_db(wanted: NDArray[np.float32], got: NDArray[np.float32]) -> float:
    """Power of what was wanted over power of the error, in dB; at most 200."""
    error = float(np.square(got.astype(np.float64) - wanted).sum())
    power = float(np.square(wanted.astype(np.float64)).sum())
    return min(10.0 * float(np.log10(max(power, 1e-300) / max(error, 1e-300))), 200.0)
