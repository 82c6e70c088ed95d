"""The program itself: extras that are missing, help, notices to who waits, and how it ends."""

import subprocess
import sys

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


def test_a_missing_extra_is_named(run, tmp_path, monkeypatch):
    heavy = ("nnpp_edge.cli.export", "nnpp_edge.export", "nnpp_edge.training", "nnpp_edge.model")
    for name in [name for name in sys.modules if name.startswith(heavy)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    (tmp_path / "checkpoint.pt").write_bytes(b"any")
    run("export checkpoint.pt -o model.onnx").refused("nnpp-edge[train]")


def test_help_and_version_succeed_and_without_a_command_the_commands_are_listed(run):
    assert all(run(words).code == 0 for words in ("--version", "--help", "plan --help"))
    ended = run("")
    assert ended.code == 2 and all(name in ended.err for name in ("plan", "warmup"))


def test_ctrl_c_as_the_interpreter_ends_prints_nothing():
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False
    )
    assert ended.stdout.startswith("nnpp-edge") and ended.stderr == ""


def test_whoever_waits_is_told_without_a_terminal_too(run, monkeypatch):
    monkeypatch.setattr(notice, "tell", None)
    run("models")
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
