"""Who waits is told for what, who gave a wrong place does not wait, and Ctrl-C at the end leaves no traceback."""

import subprocess
import sys

import numpy as np
import pytest

from nnpp_edge.cli import planning
from nnpp_edge.runtime import exercises
from nnpp_edge.runtime.compiled import notice

INTERRUPTED = """
import os, signal, sys, weakref

class Compiled: pass

def finalise():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):
        pass

kept = Compiled()
weakref.finalize(kept, finalise)
sys.argv = ["nnpp-edge", "--version"]
from nnpp_edge.cli.main import main
main()
"""


def test_ctrl_c_as_the_interpreter_ends_prints_nothing():
    ended = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert ended.stdout.startswith("nnpp-edge") and ended.stderr == ""


@pytest.fixture
def flat(tmp_path):
    """Flat ground of 80 × 90 cells, one of them unknown."""
    heights = np.zeros((80, 90), np.float32)
    heights[40, 40] = np.nan
    np.savez(tmp_path / "flat.npz", elevation_m=heights, cell_size_m=2.0)
    return tmp_path / "flat.npz"


def never(*_, **__):
    raise AssertionError("not to be called")


@pytest.mark.parametrize("limit", [(), ("--time-limit", "1")])
def test_a_place_off_the_map_is_refused_before_anything_is_computed(nnpp_edge, flat, monkeypatch, limit):
    monkeypatch.setattr(planning, "cost_of", never)
    for start, goal, words in (("5,5", "5,900", "goal (5, 900)"), ("-1,5", "70,80", "start (-1, 5)")):
        ended = nnpp_edge("plan", flat, "--start", start, "--goal", goal, *limit)
        ended.refused(f"{words} lies outside the map of 80 × 90 cells")


def test_a_blocked_place_is_refused_before_kernels_are_compiled_for_the_time_limit(nnpp_edge, flat, monkeypatch):
    monkeypatch.setattr(exercises, "exercise", never)
    ended = nnpp_edge("plan", flat, "--start", "40,40", "--goal", "70,80", "--time-limit", "1")
    ended.refused("start (40, 40) is impassable")


def test_whoever_waits_is_told_without_a_terminal_too(nnpp_edge, monkeypatch):
    monkeypatch.setattr(notice, "tell", None)
    nnpp_edge("models")
    assert notice.tell is not None


def test_what_takes_a_second_is_told_once_and_what_does_not_is_not(monkeypatch):
    heard = []
    monkeypatch.setattr(notice, "tell", heard.append)
    with notice.told_if_slow("a long wait"):
        pass
    monkeypatch.setattr(notice, "AFTER_S", 0.0)
    for _ in range(2):
        notice.begins("a wait").join()
    assert heard == ["a wait"]
