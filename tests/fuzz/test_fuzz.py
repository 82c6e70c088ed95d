"""A short run of each target, and proof that each oracle can fail."""

import faulthandler
import mmap
import os
import random
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import click
import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Status
from tests.fuzz import __main__ as runner
from tests.fuzz import commands, options, samples, weights
from tests.fuzz.cases import Place, Problem
from tests.fuzz.children import Limits, run_forked
from tests.fuzz.commands import Command

FAST = {
    "weights": 150,
    "messages": 60,
    "sequences": 100,
    "elevations": 60,
    "projections": 60,
    "layers": 40,
}
"""Those of bodies and lines are done by the runtime's tests."""
pytestmark = pytest.mark.filterwarnings(
    "ignore:the network .* was trained for omega", "ignore:nnpp goes by the price"
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Samples that need no training."""
    folder = tmp_path_factory.mktemp("fuzz")
    assert (
        run_forked(
            lambda: samples.make_light(folder / "samples") or 0, Limits(120.0, 120, 8 << 30)
        ).code
        == 0
    )
    return Place(folder / "samples", folder / "case" / "here")


@pytest.mark.slow
def test_a_few_cases_of_each_target_are_clean_in_processes_of_their_own(tmp_path):
    command = [sys.executable, "-m", "tests.fuzz", "--base", "1", "--minutes", "1.5"]
    env = os.environ | {"PYTHONPATH": samples.ROOT}
    ended = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert ended.returncode == 0 and "0 findings" in ended.stdout, ended.stdout + ended.stderr


@pytest.mark.parametrize("target", FAST)
def test_a_few_cases_are_clean(target, place):
    for seed in range(FAST[target]):
        problem = runner.check_case(target, seed, place)
        assert problem is None, f"--target {target} --seed {seed}: {problem.kind}\n{problem.detail}"


def test_a_seed_makes_the_same_case_again(place):
    for target in runner.SHARES:
        one, again, other = (repr(runner.case_of(target, seed, Place())) for seed in (5, 5, 6))
        assert one == again != other


def test_every_command_has_a_base_that_click_understands_and_an_option_is_drawn_without_being_listed():
    assert set(options.names()) == set(options.BASES)
    for name, bases in options.BASES.items():
        known = {word for parameter in options.command_of(name).params for word in parameter.opts}
        assert {word for base in bases for word in base.split() if word.startswith("-")} <= known
    parameter = click.Option(["--new"], type=int)
    words = {options.draw_values(random.Random(seed), parameter, [])[0] for seed in range(60)}
    assert {"nan", "inf"} & words and any(word.isdigit() for word in words)


# --- each oracle can fail


def judged(command=None, code=0, out="", err="", before=None, after=None, **ended):
    """The kind of problem of a command that ended so."""
    known = {"wall_s": 1.0, "peak_bytes": 0, "late": "", "interrupted": False} | ended
    facts = SimpleNamespace(code=code, out=out.encode(), err=err.encode(), **known)
    found = commands.judge(
        command or Command(("plan",)), facts, before or {}, after or before or {}
    )
    return "" if found is None else found.kind


def test_the_judge_of_commands_passes_what_is_right_and_sees_each_wrong():
    patient = Command(("run",), patient=True)
    late = "it took more than 4 s"
    assert judged(out="path") == ""
    assert (
        judged(code=2, err="warning: odd cells\nplan: 5 %, 0.1 min\nerror: wanted x, got y\n") == ""
    )
    assert judged(Command(("profile",)), code=3) == ""
    assert judged(patient, late=late, interrupted=True, err="stopped") == ""
    assert judged(patient, code=-9, late=late).startswith("cannot be interrupted")
    refused = {"code": 2, "err": "error: x"}
    json = {"command": Command(("simulate", "--json"))}
    for kind, ended in {
        "traceback": {"code": 1, "err": "Traceback (most recent call last):\nValueError: x\n"},
        "killed by signal 11": {"code": -11},
        "exit code 120": {"code": 120, "err": "error: x"},
        "exit code 2 without": {"code": 2, "err": "usage\n"},
        "more than one line": {"code": 2, "err": "what is that?\nerror: x\n"},
        "chatter": {"code": 2, "err": "libpng error: bad\nerror: x\n"},
        "exit code 1 in silence": {"code": 1},
        "hangs": {"code": -9, "late": late},
        "takes 3.0 GB": {"peak_bytes": 3_000_000_000},
        "partial output": {**refused, "after": {"out/half.png": "1"}},
        "temporary file left": {"out": "done", "after": {"out/.map.npz.0a1b2c3d": "1"}},
        "input changed": {"before": {"in/dem.npz": "1"}, "after": {"in/dem.npz": "2"}},
        "device replaced": {"before": {"odd/full": "device 0o20000"}, "after": {"odd/full": "1"}},
        "old output changed": {
            **refused,
            "before": {"old/old.png": "1"},
            "after": {"old/old.png": "2"},
        },
        "no JSON": {**json, "out": '{"cost": NaN}'},
        "a path through what is forbidden": {**json, "out": '{"forbidden": 1}'},
    }.items():
        assert judged(**ended).startswith(kind)


def hungry():
    with mmap.mmap(
        -1, 60 << 20
    ) as fresh:  # of the system: the heap may have room left that was resident before
        return fresh.write(b"x" * (60 << 20)) - (60 << 20)


def crashes():
    faulthandler.disable()  # its stack would look as if the tests themselves had crashed
    os.kill(os.getpid(), signal.SIGSEGV)


def deaf():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    time.sleep(60)
    return 0


def spins():
    while True:
        pass


def prints():
    print("x", flush=True)
    return 0


def test_a_forked_process_is_watched_and_its_streams_are_what_they_are_to_be(monkeypatch, tmp_path):
    monkeypatch.setattr("tests.fuzz.children.GRACE_S", 0.3)
    room = Limits(cpu_s=1, memory_bytes=1 << 30)
    for work, limits, shows in (
        (lambda: time.sleep(60) or 0, Limits(0.3), lambda ended: ended.late and ended.interrupted),
        (deaf, Limits(0.3), lambda ended: ended.code == -signal.SIGKILL and not ended.interrupted),
        (crashes, room, lambda ended: ended.code == -signal.SIGSEGV),
        (hungry, room, lambda ended: ended.code == 0 and ended.peak_bytes > 50 << 20),
        (lambda: len(bytearray(4 << 30)), room, lambda ended: b"MemoryError" in ended.err),
        (spins, room, lambda ended: "processor" in ended.late),
        (prints, room, lambda ended: (ended.code, ended.out) == (0, b"x\n")),
        (
            lambda: (tmp_path / "file").write_bytes(b"x" * 1000),
            Limits(file_bytes=100),
            lambda ended: b"File too large" in ended.err,
        ),
    ):
        assert shows(run_forked(work, limits))
    for kind, code in {"closed": 0, "full": 70, "broken": 70}.items():
        ended = run_forked(prints, room, streams=("null", kind, "pipe"))
        assert (ended.code, bool(ended.err)) == (code, bool(code))


def test_a_command_is_run_on_damaged_files_in_a_folder_of_its_own(place):
    words = ("plan", "in/dem.npz", "--start", "2,2", "--goal", "20,28", "--method", "astar")
    assert commands.check(Command(words), place) is None
    assert commands.check(Command(words, {"in/dem.npz": b"PK\x03\x04"}), place) is None
    assert len(place.sample("dem.npz")) > 100


@pytest.fixture
def wall():
    """Two cells beside a wall, the way around it long."""
    case = weights.generate(random.Random(1))
    cost = np.full((9, 9), 1.0, np.float32)
    cost[:8, 4] = np.inf
    ways = {
        "step_cost": "length",
        "corner_cutting": False,
        "method": "astar",
        "epsilon": 0.0,
        "landmarks": 0,
    }
    return case.but(cost=cost, start=(0, 3), goal=(0, 5), omega=0.011, **ways)


def test_the_judge_of_plans_sees_each_fault(wall):
    class Faulty(Planner):
        def plan(self, start, goal, **options):
            plan = super().plan(start, goal, **options)
            return SimpleNamespace(**{**vars(plan), **fault(plan)})

    assert weights.check(wall) is None
    for kind, fault in {
        "a path through what is forbidden": lambda plan: {
            "path": np.array([[0, 3], [0, 4], [0, 5]])
        },
        "a path with a leap": lambda plan: {"path": plan.path[[0, -1]]},
        "a path with other ends": lambda plan: {"path": plan.path[1:]},
        "a path that leaves the map": lambda plan: {"path": np.array([[0, 3], [-1, 4], [0, 5]])},
        "its cost is not its path's": lambda plan: {"cost": 1.01 * plan.cost},
        "its lower bound is above the optimum": lambda plan: {"lower_bound": 1.01 * plan.cost},
        "NO_PATH where there is a path": lambda plan: {"status": Status.NO_PATH},
        "100 expansions a cell": lambda plan: {"expansions": 8100},
    }.items():
        found = weights.check(wall, planner_type=Faulty)
        assert found is not None and found.kind.startswith(kind)

    class Detour(Planner):
        def __init__(self, cost, **settings):
            super().__init__(np.where(np.arange(9) == 4, wall.cost, cost), **settings)

    free = wall.but(cost=np.full((9, 9), 1.0, np.float32), start=(4, 0), goal=(4, 8))
    assert weights.check(free) is None
    found = weights.check(free, planner_type=Detour)
    assert found is not None and found.kind.startswith("not the optimum")


def test_what_a_batch_found_is_told_by_its_seed_and_a_crash_ends_it(monkeypatch, tmp_path):
    def check(target, seed, place):
        if seed == 3:
            crashes()
        return Problem("odd", "how") if seed == 1 else None

    monkeypatch.setattr(runner, "check_case", check)
    count, found = runner.run_batch("weights", range(9), Place(folder=tmp_path))
    assert (count, found[1], [*found]) == (4, "odd\nhow", [1, 3])
    assert found[3].startswith("killed by signal 11: weights")
