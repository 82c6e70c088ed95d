"""A short run of each target, and proof that each oracle can fail."""

import dataclasses
import faulthandler
import mmap
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from nnpp_edge.runtime import Planner, Status
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.terrain import coordinates
from tests.fuzz import commands, elevations, messages, options, projections, runner, samples, sequences, weights
from tests.fuzz.children import Limits, run_forked
from tests.fuzz.commands import Command, Problem, judge
from tests.strategies import drawn

CASES = {
    "files": 20,
    "options": 12,
    "models": 16,
    "weights": 100,
    "messages": 60,
    "sequences": 60,
    "elevations": 60,
    "bodies": 30,
    "layers": 30,
    "lines": 30,
    "projections": 100,
    "limits": 12,
}
SEED = 1
pytestmark = pytest.mark.filterwarnings("ignore:the network .* was trained for omega")
UNHURRIED = settings(deadline=None, max_examples=40, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Samples that need no training."""
    folder = tmp_path_factory.mktemp("samples")
    assert run_forked(lambda: samples.make_light(folder) or 0, Limits(120.0, 120, 8 << 30)).code == 0
    return folder


@pytest.fixture(scope="module")
def tally(tmp_path_factory):
    """A short run of all targets."""
    folder = tmp_path_factory.mktemp("fuzz")
    return runner.run(base=SEED, most=CASES, workers=1, folder=folder, heavy=False)


@pytest.mark.slow
@pytest.mark.parametrize("target", CASES)
def test_a_few_cases_of_each_target_are_clean(target, tally):
    assert tally.cases[target] == CASES[target]
    found = [finding for finding in tally.findings if finding.target == target]
    assert not found, tally.text() + "\n" + found[0].problem.detail


@UNHURRIED
@given(drawn(lambda rng: weights.generate(rng, 12)))
def test_weights_of_any_size_are_planned_on(small, case):
    assert (problem := weights.check(case, small)) is None, problem.kind


@UNHURRIED
@given(drawn(lambda rng: elevations.generate(rng, 40)))
def test_costs_computed_where_a_search_looks_are_those_computed_at_once(small, case):
    assert (problem := elevations.check(case, small)) is None, problem.kind


@UNHURRIED
@given(drawn(messages.generate))
def test_whatever_comes_the_loop_answers(small, case):
    assert (problem := messages.check(case, small)) is None, problem.kind


@UNHURRIED
@given(drawn(projections.generate))
def test_slopes_and_lengths_are_those_of_the_ground(tmp_path_factory, case):
    assert (problem := projections.check(case, None, tmp_path_factory.mktemp("map"))) is None, problem.detail


def test_a_seed_makes_the_same_case_again(small):
    for target in runner.SHARES:
        told = [runner.describe(target, seed, small, heavy=False) for seed in (5, 5, 6)]
        assert told[0] == told[1] != told[2]


def test_no_two_workers_have_a_seed_in_common():
    one, other = (runner.seeds_of(3, worker, 2) for worker in range(2))
    assert not {next(one) for _ in range(50)} & {next(other) for _ in range(50)}


def test_every_command_has_a_base_and_its_words_are_known_to_click():
    assert set(options.names()) == set(options.BASES)
    for name, bases in options.BASES.items():
        known = {parameter.name for parameter in options.command_of(name).params}
        assert all(set(base) <= known for base in bases)


def test_an_option_is_drawn_without_being_listed():
    parameter = click.Option(["--new"], type=int)
    words = {options.draw_word(random.Random(seed), parameter, {}) for seed in range(60)}
    assert {"nan", "inf"} & words and any(word.isdigit() for word in words)


# --- each oracle can fail


def judged(command=None, code=0, out="", err="", before=None, after=None, **ended):
    """What is said of a command that ended so."""
    known = {"wall_s": 1.0, "peak_bytes": 0, "late": "", "interrupted": False} | ended
    facts = SimpleNamespace(code=code, out=out.encode(), err=err.encode(), **known)
    found = judge(command or Command(("plan",)), facts, before or {}, after or before or {})
    return "" if found is None else found.kind


def test_a_good_end_and_a_good_refusal_pass():
    assert judged(out="path") == ""
    assert judged(code=2, err="warning: odd cells\nplan: 5 %, 0.1 min\nerror: wanted x, got y\n") == ""
    assert judged(Command(("profile",)), code=3) == ""


@pytest.mark.parametrize(
    ("kind", "ended"),
    {
        "traceback": {"code": 1, "err": "Traceback (most recent call last):\nValueError: x\n"},
        "killed by signal 11": {"code": -11},
        "exit code 120": {"code": 120, "err": "error: x"},
        "exit code 2 without": {"code": 2, "err": "usage\n"},
        "more than one line": {"code": 2, "err": "what is that?\nerror: x\n"},
        "chatter": {"code": 2, "err": "libpng error: bad\nerror: x\n"},
        "exit code 1 in silence": {"code": 1},
        "hangs": {"code": -9, "late": "it took more than 60 s"},
        "takes 3.0 GB": {"peak_bytes": 3_000_000_000},
        "partial output": {"code": 2, "err": "error: x", "after": {"out/half.png": "1"}},
        "temporary file left": {"out": "done", "after": {"out/.map.npz.0a1b2c3d": "1"}},
        "input changed": {"before": {"in/dem.npz": "1"}, "after": {"in/dem.npz": "2"}},
        "device replaced": {"before": {"odd/full": "device 0o20000"}, "after": {"odd/full": "1"}},
        "old output changed": {
            "code": 2,
            "err": "error: x",
            "before": {"old/old.png": "1"},
            "after": {"old/old.png": "2"},
        },
        "no JSON": {"command": Command(("plan", "--json")), "out": '{"cost": NaN}'},
        "a path through what is forbidden": {"command": Command(("simulate", "--json")), "out": '{"forbidden": 1}'},
    }.items(),
)
def test_the_judge_of_commands_sees(kind, ended):
    assert judged(**ended).startswith(kind)


def test_a_patient_command_must_end_when_it_is_interrupted():
    patient = Command(("run",), patient=True)
    assert judged(patient, late="it took more than 4 s", interrupted=True, err="stopped") == ""
    assert judged(patient, code=-9, late="it took more than 4 s").startswith("cannot be interrupted")


def hungry():
    with mmap.mmap(-1, 60 << 20) as fresh:  # of the system: the heap may have room left that was resident before
        return fresh.write(b"x" * (60 << 20)) - (60 << 20)


def crashes():
    faulthandler.disable()  # its stack would look as if the tests themselves had crashed
    os.kill(os.getpid(), signal.SIGSEGV)


def deaf():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    time.sleep(60)
    return 0


@pytest.mark.parametrize(
    ("work", "wall_s", "shows"),
    [
        (lambda: time.sleep(60) or 0, 0.3, lambda ended: ended.late and ended.interrupted),
        (deaf, 0.3, lambda ended: ended.code == -signal.SIGKILL and not ended.interrupted),
        (crashes, 30.0, lambda ended: ended.code == -signal.SIGSEGV),
        (hungry, 30.0, lambda ended: ended.code == 0 and ended.peak_bytes > 50 << 20),
        (lambda: len(bytearray(4 << 30)), 30.0, lambda ended: b"MemoryError" in ended.err),
        (lambda: sys.exit(3), 30.0, lambda ended: b"SystemExit" in ended.err),
    ],
    ids=["sleeps", "will not stop", "crashes", "takes memory", "wants too much", "exits"],
)
def test_a_forked_process_is_watched(work, wall_s, shows, monkeypatch):
    monkeypatch.setattr("tests.fuzz.children.GRACE_S", 0.3)
    assert shows(run_forked(work, Limits(wall_s, cpu_s=5, memory_bytes=1 << 30)))


def test_a_process_that_computes_for_ever_is_ended():
    def spin():
        while True:
            pass

    assert "processor" in run_forked(spin, Limits(wall_s=30.0, cpu_s=1)).late


def test_a_full_disk_is_played(tmp_path):
    def write():
        (tmp_path / "file").write_bytes(b"x" * 1000)
        return 0

    assert b"File too large" in run_forked(write, Limits(file_bytes=100)).err


@pytest.mark.parametrize("kind", ["closed", "full", "broken"])
def test_streams_are_what_they_are_to_be(kind):
    def write():
        print("x", flush=True)
        return 0

    ended = run_forked(write, Limits(), streams=("null", kind, "pipe"))
    assert (ended.code, bool(ended.err)) == ((0, False) if kind == "closed" else (70, True))


def test_a_command_is_run_on_damaged_files_in_a_folder_of_its_own(small, tmp_path):
    words = ("plan", "in/dem.npz", "--start", "2,2", "--goal", "20,28", "--method", "astar")
    assert commands.check(Command(words), small, tmp_path / "here") is None
    assert commands.check(Command(words, {"in/dem.npz": b"PK\x03\x04"}), small, tmp_path / "here") is None
    assert (small / "dem.npz").stat().st_size > 100


class Wrong(Planner):
    """A planner with a fault."""

    def plan(self, start, goal, **options):
        plan = super().plan(start, goal, **options)
        return self.fault(plan) if plan.ok else plan


def with_fault(fault):
    return type("Faulty", (Wrong,), {"fault": lambda self, plan: SimpleNamespace(**{**vars(plan), **fault(plan)})})


@pytest.fixture
def wall():
    """Two cells beside a wall, the way around it long."""
    cost = np.full((9, 9), 1.0, np.float32)
    cost[:8, 4] = np.inf
    return weights.Case(cost, (0, 3), (0, 5), "length", False, 0.011, "astar", 0.0, 0, "wall")


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ("a path through what is forbidden", lambda plan: {"path": np.array([[0, 3], [0, 4], [0, 5]])}),
        ("a path with a leap", lambda plan: {"path": plan.path[[0, -1]]}),
        ("a path with other ends", lambda plan: {"path": plan.path[1:]}),
        ("a path that leaves the map", lambda plan: {"path": np.array([[0, 3], [-1, 4], [0, 5]])}),
        ("its cost is not its path's", lambda plan: {"cost": 1.01 * plan.cost}),
        ("its lower bound is above the optimum", lambda plan: {"lower_bound": 1.01 * plan.cost}),
        ("NO_PATH where there is a path", lambda plan: {"status": Status.NO_PATH}),
        ("100 expansions a cell", lambda plan: {"expansions": 8100}),
    ],
)
def test_the_judge_of_plans_sees(kind, fault, wall):
    assert weights.check(wall) is None
    found = weights.check(wall, None, with_fault(fault))
    assert found is not None and found.kind.startswith(kind)


def test_the_judge_of_plans_sees_a_detour(wall):
    class Detour(Planner):
        def __init__(self, cost, **settings):
            blocked = cost.copy()
            blocked[1:8, 4] = np.inf
            super().__init__(blocked, **settings)

    free = dataclasses.replace(wall, cost=np.full((9, 9), 1.0, np.float32), start=(4, 0), goal=(4, 8))
    assert weights.check(free) is None
    found = weights.check(free, None, Detour)
    assert found is not None and found.kind.startswith("not the optimum")


def test_the_judge_of_the_loop_sees_a_path_of_yesterdays_map():
    free = next(case for seed in range(99) if (case := messages.generate(random.Random(seed))).method == "astar")
    plain = {"by_heights": False, "logged": False, "seed": 3, "rows": 9, "cols": 9, "framing": "lines"}
    place = b'{"type":"pose","row":1,"col":1}\n{"type":"goal","row":7,"col":7}\n'
    clear = (
        b'{"type":"patch","row":0,"col":0,"cost":[' + b",".join([b"[" + b",".join([b"0.5"] * 9) + b"]"] * 9) + b"]}\n"
    )
    wall = b'{"type":"patch","row":4,"col":0,"cost":[[' + b",".join([b"1"] * 9) + b"]]}\n"
    steps = (("bytes", clear + place), ("tick", 1e9), ("bytes", wall), ("tick", 1e9))
    case = messages.Case(**{**vars(free), **plain, "steps": steps})
    assert messages.check(case) is None
    kept = []

    def yesterdays(navigator, deadline):
        kept.append(navigator.tick(deadline))
        return kept[0]

    found = messages.check(case, answer=yesterdays)
    assert found is not None and found.kind == "published: a path through what is forbidden"

    def raising(navigator, deadline):
        raise RuntimeError("no")

    assert messages.check(case, answer=raising).kind == "the loop raised"
    lost = messages.check(case, answer=lambda navigator, deadline: Navigator.tick(navigator, -1e9))
    assert lost is None  # late, but right


def test_an_interrupt_comes_where_a_signal_could_come():
    planner = Planner(np.full((20, 20), 0.5, np.float32))
    planner.plan((0, 0), (19, 19), method="astar")
    places = []
    for after in range(1, 400):
        with sequences.interrupting(after) as where:
            try:
                planner.plan((0, 0), (19, 19), method="astar")
            except KeyboardInterrupt:
                places += where
        if not where:
            break
    else:
        pytest.fail("the plan has no end")
    assert len(places) == after - 1 > 20
    assert any("astar.py" in place for place in places) and sys.gettrace() is None


def test_the_judge_of_sequences_sees_a_planner_that_forgets_a_patch(monkeypatch):
    cost = np.full((6, 6), 0.5, np.float32)
    wall = np.full((1, 6), np.inf, np.float32)
    case = sequences.Case(
        cost, "paper", True, "dstar", (), (("update", (3, 0, wall)), ("plan", ("dstar", np.inf, np.inf)))
    )
    assert sequences.check(case) is None
    monkeypatch.setattr("nnpp_edge.runtime.DynamicPlanner.update", lambda self, row, col, patch: 0)
    found = sequences.check(case)
    assert found is not None and found.kind.startswith("OK where there is no path")


@pytest.mark.parametrize(
    ("factor", "kind"),
    [((1.1, 1.0), "another slope"), ((1.0, 0.9), "another slope"), ((1.05, 1.05), "another slope"), ((1, 1), None)],
)
def test_the_judge_of_projections_sees_cells_of_another_size(monkeypatch, tmp_path, factor, kind):
    def wrong(*args, **options):
        return tuple(np.multiply(right(*args, **options), factor))

    case = projections.Case(
        "EPSG:3857", 10.0, 60.0, 20.0, 1.0, 0.0, 30, 30, 20.0, 45.0, 22.0, start=(2, 3), goal=(25, 20)
    )
    right = coordinates.cell_on_ground
    monkeypatch.setattr("nnpp_edge.terrain.dem.cell_on_ground", wrong)
    found = projections.check(case, None, tmp_path)
    assert (found.kind if found else None) == kind
    flat = dataclasses.replace(case, slope_deg=1e-6, limit_deg=5.0)
    monkeypatch.setattr(projections, "SLOPE_WITHIN", np.inf)
    assert (projections.check(flat, None, tmp_path) is None) == (kind is None)


def test_findings_are_told_with_their_seed_and_kept(tmp_path):
    finding = runner.Finding(
        "files", 7, Problem("traceback", 'File "/x/nnpp_edge/a.py", line 3, in read\nValueError: x')
    )
    runner.keep(tmp_path, finding)
    assert "--target files --seed 7" in (tmp_path / "files-7.txt").read_text()
    tally = runner.Tally(findings=[finding])
    tally.cases["files"] = 9
    assert (
        "1 × files: traceback | nnpp_edge/a.py:read | ValueError; again with --target files --seed 7" in tally.text()
    )


def test_a_case_that_crashes_or_hangs_ends_its_batch_and_is_found(monkeypatch, tmp_path):
    def check(target, seed, samples, folder, heavy=True):
        if seed == 3:
            crashes()
        return Problem("odd") if seed == 1 else None

    monkeypatch.setattr(runner, "check_case", check)
    count, found = runner.run_batch("weights", iter(range(9)), 9, tmp_path, tmp_path / "case" / "here")
    assert count == 3 and [(seed, problem.kind) for seed, problem in found] == [
        (1, "odd"),
        (3, "killed by signal 11: weights"),
    ]


def test_the_program_says_how_to_use_it():
    ended = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--seed", "1"], capture_output=True, text=True, cwd=Path.cwd()
    )
    assert ended.returncode == 2 and "--target" in ended.stderr
