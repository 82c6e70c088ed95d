"""Figures of processes of their own: the peak memory of one that plans once, and the time to its first plan."""

import os
import pickle
import subprocess
import sys
from tempfile import TemporaryDirectory

import numpy as np

from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import NnppEdgeError

_PLAN_ONCE = """
import pickle, sys
from nnpp_edge.runtime import Planner
ground, query, method, model = pickle.load(sys.stdin.buffer)
assert Planner(ground, model=model).plan(*query, method=method).ok
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        print(line.split()[1])
"""
# VmHWM and not ru_maxrss: the latter begins, in a child, with what the parent held when it was started.
_FIRST_PLAN = """
import sys, time
began = time.perf_counter()
import numpy as np
from nnpp_edge.runtime import Planner
cost = np.random.default_rng(0).uniform(0.0, 0.5, (256, 256)).astype(np.float32)
assert Planner(cost).plan((5, 5), (250, 240), method=sys.argv[1]).ok
print(time.perf_counter() - began)
"""


def peak_memory_mb(on_map: Case, query: Endpoints, method: str, model: str) -> float | None:
    """Peak resident memory of import, load, map and one plan, in MB (10⁶ bytes); None where the kernel does not say.

    The map is read as costs, and with a vehicle as elevations. NnppEdgeError if the process fails; the message ends
    with the last line that it wrote.
    """
    given = pickle.dumps((on_map.standing, query, method, model), protocol=5)
    ended = subprocess.run([sys.executable, "-c", _PLAN_ONCE], check=False, capture_output=True, input=given)
    if ended.returncode:
        said = ended.stderr.decode().strip().splitlines() or ["no word of why"]
        raise NnppEdgeError(f"peak memory of {method}: the process that plans once failed: {said[-1]}")
    return 1.024e-3 * int(ended.stdout) if ended.stdout.strip() else None


def start_up_s(method: str, repeats: int = 3) -> tuple[float, float]:
    """Seconds from import to the first plan on a map of 256², from an empty cache of kernels and from a full one.

    The empty cache is met once, the full one `repeats` times, of which the median counts.
    """
    with TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        command = [sys.executable, "-c", _FIRST_PLAN, method]
        cold, *warm = [
            float(subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout)
            for _ in range(1 + repeats)
        ]
    return round(cold, 3), round(float(np.median(warm)), 3)
