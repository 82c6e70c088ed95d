"""What runs beside a loaded run."""

import os
import sys
import time
from pathlib import Path

import pytest

from nnpp_edge.profiling.contention import running
from nnpp_edge.profiling.profile_file import Contention, ProfileError, read_profile
from tests.robot.conftest import wait_until


def children():
    """Numbers of this process's children."""
    listed = Path(f"/proc/self/task/{os.getpid()}/children")
    return {int(each) for each in listed.read_text().split()}


def processor_s(process):
    """Processor time that a process has used, in clock ticks."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def test_busy_threads_work_on_their_cores_and_end_with_the_block():
    core, before = max(os.sched_getaffinity(0)), os.sched_getaffinity(0)
    others = children()
    with running(Contention(threads=2), [core]) as ended_early:
        started = children() - others
        assert len(started) == 2 and os.sched_getaffinity(0) == before
        assert all(os.sched_getaffinity(each) == {core} for each in started)
        wait_until(lambda: min(map(processor_s, started)) > 5, 20.0)
        assert ended_early() == []
    assert children() == others


def test_a_command_that_ends_early_is_told_of_and_its_children_end_too(tmp_path):
    with running(Contention(command=(sys.executable, "-c", "raise SystemExit(4)")), [0]) as ended_early:
        wait_until(lambda: ended_early() != [], 20.0)
        (line,) = ended_early()
        assert "ended before the loaded run did, with exit code 4" in line
    number = tmp_path / "number"
    with running(
        Contention(command=("sh", "-c", f"sleep 60 & echo $! > {number}.new; mv {number}.new {number}; wait")), []
    ):
        wait_until(number.exists, 20.0)
    wait_until(lambda: ended(int(number.read_text())), 20.0)


def ended(process):
    """Whether a process has ended, waited for or not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_the_block_ends_what_runs_beside_when_it_fails():
    others = children()
    with pytest.raises(ZeroDivisionError), running(Contention(threads=1), [0]):
        time.sleep(1 / 0)
    assert children() == others


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("threads = 2\ncommand = 'ls'", ["contention", "threads or a command, not both"]),
        ("threads = -1", ["contention.threads", "of at least 0"]),
        ("thread = 1", ["contention.thread is unknown", "threads, command, cores"]),
        ("cores = [0, 0]", ["contention", "cores", "different values"]),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(tmp_path, table, words):
    (tmp_path / "p.toml").write_text(f"[contention]\n{table}\n")
    with pytest.raises(ProfileError) as caught:
        read_profile(tmp_path / "p.toml")
    assert all(word in str(caught.value) for word in words), caught.value


def test_a_command_may_be_a_word_alone_and_must_be_there(tmp_path):
    (tmp_path / "p.toml").write_text("[contention]\ncommand = 'no-such-program'\n")
    contention = read_profile(tmp_path / "p.toml").contention
    assert contention.command == ("no-such-program",) and contention.words == "no-such-program"
    with pytest.raises(ProfileError, match="'no-such-program'"):
        contention.check()
    assert not read_profile("quick").contention.wanted
