"""Time from import to the first plan in a new process, without and with compiled kernels in the cache.

Run it as ``python -m nnpp_edge.profiling.cold_start``.
"""

import json
import os
import subprocess
import sys
from typing import NamedTuple

import numpy as np

from nnpp_edge.files import temporary_folder

METHODS = ("astar", "corridor", "nnpp")

_FIRST_PLAN = """
import sys, time
began = time.perf_counter()
import numpy as np
from nnpp_edge.runtime import Planner
cost = np.random.default_rng(0).uniform(0.0, 0.5, (256, 256)).astype(np.float32)
plan = Planner(cost).plan((5, 5), (250, 240), method=sys.argv[1])
assert plan.ok
print(time.perf_counter() - began, 1e-3 * plan.timings_ms.get("load", 0.0))
"""


class ColdStart(NamedTuple):
    """Seconds to the first plan in a new process."""

    cold_s: float
    """From an empty cache."""
    warm_s: float
    """From a full one."""
    load_s: float
    """Of that, waiting for the network: importing onnxruntime, reading, checking and opening the file."""


def cold_start(method: str, repeats: int = 3) -> ColdStart:
    """Time to the first plan by `method` on a map of 256².

    The empty cache is met once, the full one `repeats` times, of which the medians count.
    """
    with temporary_folder() as folder:
        cold, _ = _first_plan(method, str(folder))
        warm, load = np.median([_first_plan(method, str(folder)) for _ in range(repeats)], axis=0).tolist()
    return ColdStart(round(cold, 3), round(warm, 3), round(load, 3))


def _first_plan(method: str, cache: str) -> tuple[float, float]:
    """Seconds from import to plan, and of these to load the network."""
    command = [sys.executable, "-c", _FIRST_PLAN, method]
    environment = os.environ | {"NUMBA_CACHE_DIR": cache}
    ended = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    whole, load = map(float, ended.stdout.split())
    return whole, load


if __name__ == "__main__":
    for name in METHODS:
        found = cold_start(name)
        ratio = round(found.cold_s / found.warm_s, 2)
        print(json.dumps({"method": name, **found._asdict(), "ratio": ratio}))
