"""Figures of processes of their own: the peak memory of one that plans once, and the start up to an
answer.
"""

import pickle
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np

from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.memory import peak_bytes

_PLAN_ONCE = """
import pickle, sys
from nnpp_edge.runtime import Planner
ground, query, method, model = pickle.load(sys.stdin.buffer)
plan = Planner(ground, model=model).plan(*query, method=method)
print(plan.status, flush=True)
if plan.ok:
    sys.stdin.read()
"""
_FIRST_TICK = """
import sys
from nnpp_edge.cli.main import main
sys.argv[1:] = "run --map sample:moon_highlands --rescale 20 --method".split() + sys.argv[1:]
main()
"""
_WARM_STARTS = 3
_DRIVE = b'{"type":"pose","row":90,"col":60}\n{"type":"goal","row":450,"col":470}\n'


def peak_memory_mb(case: Case, method: str, model: str) -> float | None:
    """Peak resident memory of import, load, map and one plan of its first query, in MB (10⁶ bytes);
    None where the kernel does not say.

    The map is read as costs, and with a vehicle as elevations. NnppEdgeError if the process fails;
    the message ends with the last line that it wrote.
    """
    given = pickle.dumps((case.standing, case.queries[0], method, model), 5)
    _, peak_mb = _first_answer(_PLAN_ONCE, method, given)
    return peak_mb or None


def start_up_s(method: str, model: str) -> float:
    """Seconds from a process's start to its first plan, on a map of 256²."""
    cost = np.random.default_rng(0).uniform(0.0, 0.5, (256, 256)).astype(np.float32)
    query = (5, 5), (250, 240)
    return _median_s(_PLAN_ONCE, method, pickle.dumps((Ground(cost), query, method, model), 5))


def first_tick_s(method: str) -> float:
    """Seconds from a process's start to the loop's first path, on a map of 512²."""
    return _median_s(_FIRST_TICK, method, _DRIVE)


def _median_s(code: str, method: str, given: bytes) -> float:
    """Median of three starts after one that fills the cache of kernels."""
    answers = [_first_answer(code, method, given) for _ in range(1 + _WARM_STARTS)]
    return float(np.median([seconds for seconds, _ in answers[1:]]))


def _first_answer(code: str, method: str, given: bytes) -> tuple[float, float]:
    """Seconds until a new process prints that it has a path, and its peak memory by then in MB."""
    command = [sys.executable, "-c", code, method]
    pipe = subprocess.PIPE
    began = time.perf_counter()
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None and process.stdout is not None
        with suppress(BrokenPipeError):
            process.stdin.write(given)
            process.stdin.flush()
        answer = b""
        for answer in process.stdout:  # while a busy machine's loop is late
            if b"OK" in answer:
                break
        took = time.perf_counter() - began
        peak = peak_bytes(process.pid)
        process.kill()
        said = process.communicate()[1].decode().strip().splitlines() or ["no word of why"]
    if b"OK" not in answer:
        raise NnppEdgeError(
            f"a process that was to plan once by {method} ended without a path: {said[-1]}"
        )
    return took, 1e-6 * peak
