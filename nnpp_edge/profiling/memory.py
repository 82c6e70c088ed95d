"""Peak memory of a process that plans once, measured in a process of its own."""

import subprocess
import sys

import numpy as np

from nnpp_edge.files import temporary_folder
from nnpp_edge.profiling.profile_maps import ProfileQuery
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import NnppEdgeError

_PLAN_ONCE = """
import sys
import numpy as np
from nnpp_edge.runtime import Planner
path, method, model, *cells = sys.argv[1:]
row, col, to_row, to_col = map(int, cells)
assert Planner(np.load(path), model=model).plan((row, col), (to_row, to_col), method=method).ok
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        print(line.split()[1])
"""
# VmHWM and not ru_maxrss: the latter begins, in a child, with what the parent held when it was started.


def peak_memory_mb(cost: Float2D, query: ProfileQuery, method: str, model: str) -> float | None:
    """Peak resident memory of import, load, map and one plan, in MB (10⁶ bytes); None where the kernel does not say.

    Raises
    ------
    NnppEdgeError
        The process failed; the message is the last line that it wrote.
    """
    with temporary_folder() as folder:
        path = folder / "cost.npy"
        np.save(path, cost)
        words = [str(path), method, str(model), *map(str, (*query.start, *query.goal))]
        command = [sys.executable, "-c", _PLAN_ONCE, *words]
        ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode:
        said = ended.stderr.strip().splitlines() or ["no word of why"]
        raise NnppEdgeError(f"peak memory of {method}: the process that plans once failed: {said[-1]}")
    return 1.024e-3 * int(ended.stdout) if ended.stdout.strip() else None
