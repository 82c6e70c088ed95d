"""Figures of processes of their own: the peak memory of one that plans once, and the time to its first plan."""

import json
import os
import subprocess
import sys
from dataclasses import asdict

import numpy as np

from nnpp_edge.files import temporary_folder
from nnpp_edge.profiling.profile_maps import ProfileMap
from nnpp_edge.profiling.suites import heights_of
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import NnppEdgeError

_PLAN_ONCE = """
import json, sys
import numpy as np
from nnpp_edge.runtime import Planner, Vehicle
path, method, model, body, ends = sys.argv[1:]
if body:
    size, width, vehicle = json.loads(body)
    planner = Planner.of_elevation(
        np.load(path), size, cell_width_m=width, vehicle=Vehicle(**vehicle), model=model, warn=False
    )
else:
    planner = Planner(np.load(path), model=model)
assert planner.plan(*map(tuple, json.loads(ends)), method=method).ok
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


def peak_memory_mb(on_map: ProfileMap, query: Endpoints, method: str, model: str) -> float | None:
    """Peak resident memory of import, load, map and one plan, in MB (10⁶ bytes); None where the kernel does not say.

    The map is read as costs, and with a vehicle as elevations. NnppEdgeError if the process fails; the message ends
    with the last line that it wrote.
    """
    ground, body = on_map.ground, ""
    if ground.vehicle is not None:
        body = json.dumps((*ground.sides_m, asdict(ground.vehicle)))
    with temporary_folder() as folder:
        path = folder / "map.npy"
        np.save(path, heights_of(ground) if body else on_map.cost)
        command = [sys.executable, "-c", _PLAN_ONCE, str(path), method, model, body, json.dumps(query)]
        ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode:
        said = ended.stderr.strip().splitlines() or ["no word of why"]
        raise NnppEdgeError(f"peak memory of {method}: the process that plans once failed: {said[-1]}")
    return 1.024e-3 * int(ended.stdout) if ended.stdout.strip() else None


def start_up_s(method: str, repeats: int = 3) -> tuple[float, float]:
    """Seconds from import to the first plan on a map of 256², from an empty cache of kernels and from a full one.

    The empty cache is met once, the full one `repeats` times, of which the median counts.
    """
    with temporary_folder() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)}
        command = [sys.executable, "-c", _FIRST_PLAN, method]
        cold, *warm = [
            float(subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout)
            for _ in range(1 + repeats)
        ]
    return round(cold, 3), round(float(np.median(warm)), 3)
