"""Standard streams that are closed or full."""

import subprocess
import sys

from nnpp_edge.cli.text import tell

PROGRAM = f"{sys.executable} -m nnpp_edge.cli.main"
FULL = "No space left on device"


def shell(words):
    return subprocess.run(
        ["/bin/sh", "-c", f"{PROGRAM} {words}"], capture_output=True, text=True, timeout=120
    )


def test_what_cannot_be_printed_is_an_error_of_one_line():
    ended = shell("--version >/dev/full")
    assert ended.returncode == 2
    words = f"error: a file or standard output: could not be read or written ({FULL})"
    assert ended.stderr == f"{words}\n"


def test_commands_and_errors_keep_their_exit_code_where_nobody_can_read_them():
    for words, code in (
        ("--version >&-", 0),
        ("--version <&- >&- 2>&-", 0),
        ("fly 2>&-", 2),
        ("fly 2>/dev/full", 2),
    ):
        ended = shell(words)
        assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "")


def test_a_reader_who_leaves_ends_the_command_in_silence():
    assert shell("models --json | true").stderr == ""


def test_a_line_stays_a_line_whatever_a_name_holds(nnpp_edge, tmp_path):
    ended = nnpp_edge("costmap", tmp_path / "two\nlines\x1b[31m.npz", "-o", tmp_path / "cost.npy")
    ended.refused(r"two\nlines\x1b[31m.npz")
    assert ended.err.count("\n") == 1


def test_what_has_no_place_in_utf_8_is_written_out(capsys):
    tell(False, {}, lambda: "planner \ud800: faster")
    assert capsys.readouterr().out == "planner \\ud800: faster\n"
