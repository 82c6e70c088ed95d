"""Peak memory of a process that plans once, measured in a process of its own."""

import json
import subprocess
import sys
from dataclasses import asdict

import numpy as np

from nnpp_edge.files import temporary_folder
from nnpp_edge.profiling.ground import heights_of
from nnpp_edge.profiling.profile_maps import ProfileMap, ProfileQuery
from nnpp_edge.runtime.errors import NnppEdgeError

_PLAN_ONCE = """
import json, sys
import numpy as np
from nnpp_edge.runtime import Planner, Vehicle
path, method, model, body, *cells = sys.argv[1:]
row, col, to_row, to_col = map(int, cells)
if body:
    size, width, vehicle = json.loads(body)
    planner = Planner.of_elevation(
        np.load(path), size, cell_width_m=width, vehicle=Vehicle(**vehicle), model=model, warn=False
    )
else:
    planner = Planner(np.load(path), model=model)
assert planner.plan((row, col), (to_row, to_col), method=method).ok
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        print(line.split()[1])
"""
# VmHWM and not ru_maxrss: the latter begins, in a child, with what the parent held when it was started.


def peak_memory_mb(on_map: ProfileMap, query: ProfileQuery, method: str, model: str) -> float | None:
    """Peak resident memory of import, load, map and one plan, in MB (10⁶ bytes); None where the kernel does not say.

    The map is read as costs, and with a vehicle as elevations.

    Raises
    ------
    NnppEdgeError
        The process failed; the message is the last line that it wrote.
    """
    ground, body = on_map.ground, ""
    if ground.vehicle is not None:
        body = json.dumps((*ground.sides_m, asdict(ground.vehicle)))
    with temporary_folder() as folder:
        path = folder / "map.npy"
        np.save(path, heights_of(ground) if body else on_map.cost)
        words = [str(path), method, str(model), body, *map(str, (*query.start, *query.goal))]
        command = [sys.executable, "-c", _PLAN_ONCE, *words]
        ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode:
        said = ended.stderr.strip().splitlines() or ["no word of why"]
        raise NnppEdgeError(f"peak memory of {method}: the process that plans once failed: {said[-1]}")
    return 1.024e-3 * int(ended.stdout) if ended.stdout.strip() else None
