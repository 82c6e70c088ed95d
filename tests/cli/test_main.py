"""The program itself: extras that are missing, help, notices to who waits, and how it ends."""

import sys
import threading

from nnpp_edge.progress import bar
from nnpp_edge.runtime.compiled import notice
from nnpp_edge.runtime.errors import INSTALL


def test_a_missing_extra_is_named_and_why_a_package_that_is_there_fails(run, tmp_path, monkeypatch):
    heavy = ("nnpp_edge.cli.export", "nnpp_edge.export", "nnpp_edge.training", "nnpp_edge.model")
    for name in [name for name in sys.modules if name.startswith(heavy)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    (tmp_path / "checkpoint.pt").write_bytes(b"any")
    run("export checkpoint.pt -o model.onnx").refused(INSTALL.format("train"))

    def broken(_):
        raise ImportError("libcudart.so.12:\ncannot open", name="torch._C")

    monkeypatch.setattr("nnpp_edge.cli.main.import_module", broken)
    words = "torch, which is installed but cannot be imported (libcudart.so.12: cannot open)"
    run("models").refused(words)


def test_help_and_version_succeed_and_without_a_command_the_commands_are_listed(run):
    assert all(run(words).code == 0 for words in ("--version", "--help", "plan --help"))
    ended = run("")
    assert ended.code == 2 and all(name in ended.err for name in ("plan", "warmup"))


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


def test_a_log_is_told_how_much_is_done_and_since_when(monkeypatch, capsys):
    clock = iter([0.0, 600.0, 606.0])
    monkeypatch.setattr("nnpp_edge.progress.time.monotonic", lambda: next(clock))
    with bar("compare", 100) as advance:
        advance(10)
        advance(20)
    assert capsys.readouterr().err.splitlines()[-1] == "compare: 20 %, 10.1 min"


def test_who_waits_longer_is_told_again_with_the_time(monkeypatch):
    heard = []
    enough = threading.Event()

    def tell(line):
        heard.append(line)
        if len(heard) == 3:
            enough.set()

    monkeypatch.setattr(notice, "tell", tell)
    monkeypatch.setattr(notice, "AFTER_S", 0.01)
    with notice.told_if_slow("a long wait"):
        assert enough.wait(5.0)
    assert heard[0] == "a long wait" and heard[2] == "a long wait: 0.04 s so far"
