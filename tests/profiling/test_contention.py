"""What runs beside a loaded run."""

import os
import sys
import time
from pathlib import Path

import pytest

from nnpp_edge.profiling.contention import check, running
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


def test_busy_threads_work_and_end_with_the_block_also_when_it_fails():
    others = children()
    with pytest.raises(ZeroDivisionError), running(Contention(threads=2)) as ended_early:
        started = children() - others
        assert len(started) == 2
        wait_until(lambda: min(map(processor_s, started)) > 5, 20.0)
        assert ended_early() == []
        time.sleep(1 / 0)
    assert children() == others


def test_a_command_that_ends_early_is_told_of_and_its_children_end_too(tmp_path):
    with running(Contention(command=(sys.executable, "-c", "raise SystemExit(4)"))) as ended_early:
        wait_until(lambda: ended_early() != [], 20.0)
        (line,) = ended_early()
        assert "ended before the loaded run did, with exit code 4" in line
    number = tmp_path / "number"
    words = f"sleep 60 & echo $! > {number}.new; mv {number}.new {number}; wait"
    with running(Contention(command=("sh", "-c", words))):
        wait_until(number.exists, 20.0)
    wait_until(lambda: ended(int(number.read_text())), 20.0)


def ended(process):
    """Whether a process has ended, waited for or not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_table_that_makes_no_sense_or_a_program_that_is_not_there_is_refused(tmp_path):
    profile = tmp_path / "p.toml"
    for table, words in (("threads = -1", "contention.threads: Expected .* got -1"), ("thread = 1", "field thread")):
        profile.write_text(f"[contention]\n{table}\n")
        with pytest.raises(ProfileError, match=words):
            read_profile(profile)
    profile.write_text("[contention]\ncommand = ['no-such-program', '-v']\n")
    contention = read_profile(profile).contention
    assert contention.words == "no-such-program -v" and not read_profile("quick").contention.words
    with pytest.raises(ProfileError, match="'no-such-program'"):
        check(contention)
