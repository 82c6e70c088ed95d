"""Time from import to the first plan in a new process, without and with compiled kernels in the cache.

Run it as ``python -m nnpp_edge.profiling.cold_start``.
"""

import json
import os
import subprocess
import sys

import numpy as np

from nnpp_edge.files import temporary_folder

METHODS = ("astar", "corridor", "nnpp")

_FIRST_PLAN = """
import sys, time
began = time.perf_counter()
import numpy as np
from nnpp_edge.runtime import Planner
cost = np.random.default_rng(0).uniform(0.0, 0.5, (256, 256)).astype(np.float32)
assert Planner(cost).plan((5, 5), (250, 240), method=sys.argv[1]).ok
print(time.perf_counter() - began)
"""


def cold_start(method: str, repeats: int = 3) -> tuple[float, float]:
    """Seconds to the first plan by `method` on a map of 256²: from an empty cache, and from a full one.

    The empty cache is met once, the full one `repeats` times, of which the median counts.
    """
    with temporary_folder() as folder:
        cold = _first_plan(method, str(folder))
        warm = float(np.median([_first_plan(method, str(folder)) for _ in range(repeats)]))
    return round(cold, 3), round(warm, 3)


def _first_plan(method: str, cache: str) -> float:
    command = [sys.executable, "-c", _FIRST_PLAN, method]
    environment = os.environ | {"NUMBA_CACHE_DIR": cache}
    ended = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return float(ended.stdout)


if __name__ == "__main__":
    for name in METHODS:
        cold, warm = cold_start(name)
        print(json.dumps({"method": name, "cold_s": cold, "warm_s": warm, "ratio": round(cold / warm, 2)}))
