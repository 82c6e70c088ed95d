"""A short run of each target, and proof that each oracle can fail."""

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

from nnpp_edge.cli.main import COMMANDS
from tests.fuzz import __main__ as runner
from tests.fuzz import commands, options, samples
from tests.fuzz.cases import Finding, Place
from tests.fuzz.children import ROOMY, Ended, Limits, run_forked
from tests.fuzz.commands import Command
from tests.strategies import flat
from tests.worlds import World

ROOT = str(Path(__file__).parents[2])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Samples that need no training."""
    folder = tmp_path_factory.mktemp("fuzz")
    assert run_forked(lambda: samples.make_light(folder / "samples"), ROOMY).code == 0
    return Place(folder / "samples", folder / "case" / "here")


@pytest.mark.slow
def test_a_few_cases_of_each_target_are_clean_in_processes_of_their_own(tmp_path):
    command = [sys.executable, "-m", "tests.fuzz", "--short"]
    env = os.environ | {"PYTHONPATH": ROOT}
    ended = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert ended.returncode == 0 and "0 findings" in ended.stdout, ended.stdout + ended.stderr


def test_every_command_has_a_base_that_click_understands_and_an_option_is_drawn_without_being_listed():
    groups = [each for each in COMMANDS if isinstance(options.command_of(each), click.Group)]
    inner = {f"{name} {word}" for name in groups for word in options.command_of(name).commands}
    assert set(options.BASES) == {*COMMANDS, *inner} - {"view", "ros"}, "but for servers"
    for name, bases in options.BASES.items():
        known = {word for parameter in options.command_of(name).params for word in parameter.opts}
        assert {word for base in bases for word in base.split() if word.startswith("-")} <= known
    parameter = click.Option(["--new"], type=int)
    words = {options.draw_values(random.Random(seed), parameter, [])[0] for seed in range(60)}
    assert {"nan", "inf"} & words and any(word.isdigit() for word in words)


# --- each oracle can fail


LATE = "it took more than 4 s"
JUDGED = {
    "": [
        {"out": "path"},
        {"code": 2, "err": "warning: odd cells\nplan: 5 %, 0.1 min\nerror: wanted x, got y\n"},
        {"words": ("profile",), "code": 3},
        {"patient": True, "late": LATE, "interrupted": True, "err": "stopped"},
    ],
    "cannot be interrupted": [{"patient": True, "code": -9, "late": LATE}],
    "traceback": [{"code": 1, "err": "Traceback (most recent call last):\nValueError: x\n"}],
    "killed by signal 11": [{"code": -11}],
    "exit code 120": [{"code": 120, "err": "error: x"}],
    "exit code 0 after an error": [{"err": "error: x"}],
    "exit code 2 without": [{"code": 2, "err": "usage\n"}],
    "more than one line": [{"code": 2, "err": "what is that?\nerror: x\n"}],
    "chatter": [{"code": 2, "err": "libpng error: bad\nerror: x\n"}],
    "exit code 1 in silence": [{"code": 1}],
    "hangs": [{"code": -9, "late": LATE}],
    "takes 3.0 GB": [{"peak_bytes": 3_000_000_000}],
    "partial output": [{"code": 2, "err": "error: x", "after": {"out/half.png": "1"}}],
    "temporary file left": [{"out": "done", "after": {"out/.map.npz.0a1b2c3d": "1"}}],
    "input changed": [{"before": {"in/a": "1"}, "after": {"in/a": "2"}}],
    "device replaced": [{"before": {"odd/full": "device 0"}, "after": {"odd/full": "1"}}],
    "old output changed": [
        {"code": 2, "err": "error: x", "before": {"old/a": "1"}, "after": {"old/a": "2"}}
    ],
    "no JSON": [{"words": ("simulate", "--json"), "out": '{"cost": NaN}'}],
    "a path through what is forbidden": [
        {"words": ("simulate", "--json"), "out": '{"forbidden": 1}'}
    ],
}


def judged(words=("plan",), *, patient=False, before=None, after=None, **ended):
    """What the judge says of a command that ended so."""
    command = Command(words, patient=patient)
    return commands.judge(command, Ended(**ended), before or {}, after or before or {})


@pytest.mark.parametrize("kind", JUDGED)
def test_the_judge_of_commands_passes_what_is_right_and_sees_each_wrong(kind):
    for case in JUDGED[kind]:
        found = judged(**case)
        assert found.startswith(kind) if kind else not found


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


def spins():
    while True:
        pass


WATCHED = {
    "late": (lambda: time.sleep(60), lambda ended: ended.late and ended.interrupted),
    "deaf": (deaf, lambda ended: ended.code == -signal.SIGKILL and not ended.interrupted),
    "crashed": (crashes, lambda ended: ended.code == -signal.SIGSEGV),
    "hungry": (hungry, lambda ended: ended.code == 0 and ended.peak_bytes > 50 << 20),
    "starved": (lambda: len(bytearray(4 << 30)), lambda ended: "MemoryError" in ended.err),
    "spins": (spins, lambda ended: "processor" in ended.late),
    "prints": (lambda: print("x"), lambda ended: (ended.code, ended.out) == (0, "x\n")),
    "exits": (lambda: sys.exit(3), lambda ended: ended.code == 3),
    "full": (
        lambda: Path("file").write_bytes(b"x" * 1000),
        lambda ended: ended.code == 1 and "File too large" in ended.err,
    ),
}


@pytest.mark.parametrize("name", WATCHED)
def test_a_forked_process_is_watched(monkeypatch, tmp_path, name):
    monkeypatch.setattr("tests.fuzz.children.GRACE_S", 0.3)
    monkeypatch.chdir(tmp_path)
    work, shows = WATCHED[name]
    wall_s = 0.3 if name in ("late", "deaf") else 60.0
    limits = Limits(wall_s, cpu_s=1, memory_bytes=1 << 30, file_bytes=100)
    assert shows(run_forked(work, limits))


def test_a_command_is_run_on_damaged_files_in_a_folder_of_its_own(place, monkeypatch):
    words = ("plan", "in/dem.npz", "--start", "2,2", "--goal", "20,28", "--method", "astar")
    commands.check(Command(words), place)
    commands.check(Command(words, {"in/dem.npz": b"PK\x03\x04"}), place)
    monkeypatch.setattr(commands, "judge", lambda *_: "odd")
    with pytest.raises(Finding, match=r"(?s)odd: plan\n.*error: in/dem\.npz"):
        commands.check(Command(words, {"in/dem.npz": b"PK\x03\x04"}), place)


def faulty(path=((0, 3), (0, 4), (0, 5)), cost=2.0, lower_bound=2.0, ok=True):
    """A plan, straight by default."""
    return SimpleNamespace(walked=np.array(path), cost=cost, lower_bound=lower_bound, ok=ok)


@pytest.mark.parametrize(
    "fault",
    [
        {"path": [(0, 3), (0, 5)]},
        {"path": [(0, 3), (-1, 4), (0, 5)], "cost": 2.0**1.5},
        {"path": [(0, 3), (1, 3), (1, 4), (1, 5), (0, 5)], "cost": 4.0},
        {"path": [(0, 3), (8, 4), (0, 5)]},
        {"cost": 17.0},
        {"lower_bound": 99.0},
        {"ok": False},
    ],
)
def test_the_judge_of_plans_sees_each_fault(fault):
    told = flat(9, 9, 1.0)
    told[8, 4] = np.inf
    world = World(np.random.default_rng(0), (None, told), (1.0, 1.0), step_cost="length")
    optimum = world.optimum((0, 3), (0, 5))
    world.judge(faulty(), optimum, 0.0)
    with pytest.raises(AssertionError):
        world.judge(faulty(**fault), optimum, 0.0)


def test_what_a_batch_found_is_told_by_its_seed_and_a_crash_ends_it(monkeypatch, tmp_path):
    def check(target, seed, place):
        if seed == 1:
            raise Finding("odd", "how")
        if seed == 3:
            crashes()

    monkeypatch.setattr(runner, "do_case", check)
    count, found = runner.run_batch("sequences", range(9), 60.0, Place(tmp_path))
    assert (count, [*found]) == (4, [1, 3])
    assert found[1].startswith("odd\nTraceback") and found[1].endswith("odd\nhow")
    assert found[3].startswith("killed by signal 11: sequences")
