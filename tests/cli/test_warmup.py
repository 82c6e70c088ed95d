"""`nnpp-edge warmup`: it compiles every kernel, once, and plans find what it compiled."""

import json
import os
import subprocess
import sys

from nnpp_edge.runtime.compiled.places import OWN

PLAN_EVERYTHING = """
import numpy as np
from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle, traversability_cost
from nnpp_edge.runtime.search.dstar_lite import DStarLite

rng, methods = np.random.default_rng(3), ("astar", "corridor", "nnpp", "auto")
for shape in ((30, 30), (1, 60), (260, 230), (600, 530), (1100, 60)):
    dem = np.cumsum(rng.normal(0.0, 0.05, shape), axis=1).astype(np.float32)
    cost = traversability_cost(dem, 1.0, warn=False)
    cost = np.minimum(cost, np.float32(0.9))
    frozen = cost.copy()
    frozen.flags.writeable = False
    start, goal = (0, 0), (shape[0] - 1, shape[1] - 1)
    for weights in (cost + np.float32(0.01), frozen.astype(np.float64) + 0.01, frozen):
        for step_cost, cutting in (("paper", False), ("paper", True), ("length", False), ("length", True)):
            planner = Planner(np.maximum(weights, 1e-3), step_cost=step_cost, corner_cutting=cutting)
            for method in methods:
                assert planner.plan(start, goal, method=method).ok and planner.plan(start, start, method=method).ok
                planner.plan(start, goal, method=method, time_limit_s=0.0)
            planner.update(0, 2, np.full((1, 3), np.inf))
            for method in methods[:3]:
                planner.plan(start, goal, method=method, time_limit_s=30.0)
            search = DStarLite(planner.state, goal)
            search.plan(start)
            planner.update(0, 1, np.full((1, 2), 0.7))
            search.plan((0, 1))
    vehicle, inner = Vehicle(2.2, 2.2, 1.0, max_tilt_deg=60.0), ((9, 9), (shape[0] - 10, shape[1] - 10))
    for body, ends in ((None, (start, goal)), (vehicle, inner)) if min(shape) > 1 else ():
        more = {"method": "dstar", "vehicle": body, "step_cost": "linear"}
        planner = DynamicPlanner.of_elevation(dem, 1.0, ends[1], **more)
        planner.move(ends[0])
        for method in ("dstar", "corridor-dstar", "nnpp"):
            planner.replan(method=method)
            planner.update_elevation(0, 2, dem[:3, 3:5])
            planner.standing()
        if body is not None:
            planner.state.grid.robot.moves.poses.standing()
assert Planner(frozen).plan(start, goal).ok
"""

FOLDER = "from nnpp_edge.runtime.compiled import places; print(places.OWN)"
WARM_UP = "from nnpp_edge.cli.main import main; import sys; sys.argv[0] = 'nnpp-edge'; main()"
TOLD_OF_COMPILING = """
from nnpp_edge.runtime.compiled import notice
heard = []
notice.tell, notice.AFTER_S = heard.append, 0.0
from nnpp_edge.runtime.kernels.expansion import octile
from nnpp_edge.runtime.kernels.threshold import lowered
octile(1, 2, 3, 4, 1.0, 1.4)
lowered(3, 0.5)
print(heard)
"""

VERSIONS = """
import importlib, inspect, json, pkgutil
import nnpp_edge.runtime.kernels
from nnpp_edge.runtime import warmup

def kernels():
    found = {}
    for info in pkgutil.walk_packages(nnpp_edge.runtime.kernels.__path__, "nnpp_edge.runtime.kernels."):
        for name, value in vars(importlib.import_module(info.name)).items():
            if hasattr(value, "py_func") and (value.py_func.__module__ == info.name or value.py_func.__closure__):
                found[f"{info.name}.{name}"] = value
                for cell in value.py_func.__closure__ or ():  # of helpers made for a search
                    if hasattr(inner := cell.cell_contents, "py_func") and inner.py_func.__closure__:
                        found[f"{info.name}.{name}.{inner.py_func.__name__}"] = inner
    return found

def versions():
    return {name: sorted(map(str, kernel.signatures)) for name, kernel in kernels().items()}

def calls(kernel):
    names, f = {id(value): name for name, value in kernels().items()}, inspect.unwrap(kernel.py_func)
    seen = [f.__globals__.get(name) for name in f.__code__.co_names]
    seen += [cell.cell_contents for cell in f.__closure__ or ()]
    return [names[id(each)] for each in seen if hasattr(each, "py_func")]

warmup.exercise()
warm = versions()
exec('''%s''')
told = {name: calls(kernel) for name, kernel in kernels().items()}
print(json.dumps({"after warm-up": warm, "after plans": versions(), "calls": told}))
"""

FOLDERS = ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "TMPDIR")


def environment(**changes):
    """Our environment without any word about folders but those in `changes`."""
    return {k: v for k, v in os.environ.items() if k not in FOLDERS} | {
        k: str(v) for k, v in changes.items()
    }


def python(code, *words, **changes):
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        env=environment(**changes),
        capture_output=True,
        text=True,
    )


def test_all_that_a_warm_up_compiled_is_found_by_the_next():
    here = {name: os.environ[name] for name in FOLDERS if name in os.environ}
    told = {"compiled": 1}
    while told["compiled"]:  # mostly it was done before the tests
        before = told["compiled"]
        told = json.loads(python(WARM_UP, "warmup", "--json", **here).stdout)
        assert told["compiled"] == 0 or before == 1
    assert told["folder"] == str(OWN)
    assert told["kernels"] <= 75 and told["kernels"] <= told["signatures"] <= 120


def test_who_waits_for_the_compiler_is_told_once(tmp_path):
    cold, warm = (python(TOLD_OF_COMPILING, XDG_CACHE_HOME=tmp_path).stdout for _ in range(2))
    assert cold.count("compiling for this processor") == cold.count("nnpp-edge warmup") == 1
    assert warm == "[]\n"


def test_a_warm_up_has_every_kernel_of_the_runtime_and_after_it_no_plan_compiles_anything():
    ended = subprocess.run(
        [sys.executable, "-c", VERSIONS % PLAN_EVERYTHING],
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["after plans"] == found["after warm-up"]
    calls = found["calls"]
    warm = waiting = {name for name, there in found["after warm-up"].items() if there}
    assert len(calls) > 20 and len(warm) > 20
    while waiting:  # those that warm ones call are compiled with them
        waiting = {called for name in waiting for called in calls[name]} - warm
        warm |= waiting
    assert calls.keys() - warm == set()


def test_a_folder_that_others_may_write_to_is_passed_over_and_without_a_home_the_temporary_one_serves(
    tmp_path,
):
    base = tmp_path / "xdg" / "nnpp-edge"
    base.mkdir(parents=True)
    base.chmod(0o770)
    for ended, folder in (
        (
            python(FOLDER, XDG_CACHE_HOME=tmp_path / "xdg", HOME=tmp_path / "home"),
            "home/.cache/nnpp-edge",
        ),
        (python(FOLDER, TMPDIR=tmp_path), f"nnpp-edge-{os.geteuid()}"),
    ):
        assert ended.stdout.startswith(str(tmp_path / folder)) and ended.stderr == ""
    assert not list(base.iterdir())


def test_a_warm_up_without_a_folder_to_keep_kernels_in_fails_in_one_line(tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("")
    ended = python(WARM_UP, "warmup", NUMBA_CACHE_DIR=taken)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("error: ") and ended.stderr.count("\n") == 1
