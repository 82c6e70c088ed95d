"""Recordings: what goes in comes out, at its pace or as fast as can be, and a crash costs a line at
most.
"""

import threading
import time
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.robot.transports.recording import (
    RecordedSource,
    RecordingFile,
    ReplayError,
    ReplaySource,
    read_recording,
)
from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.runtime import (
    Goal,
    Ground,
    MapPatch,
    Navigator,
    Pose,
)
from nnpp_edge.runtime.errors import OutputError
from tests.robot.conftest import free
from tests.tables import cases

SHAPE = (40, 60)


def scene(path, ticks=40, seed=0):
    """A drive with obstacles that come and go, recorded at 10 Hz."""
    rng = np.random.default_rng(seed)
    timed = [(0.0, Goal(35, 55))]
    for n in range(ticks):
        row, col = (int(x) for x in rng.integers(0, 38, 2))
        patch = MapPatch(row, col, cost=np.full((6, 4), rng.choice([0.1, 0.9, np.inf])))
        timed += [(0.1 * n, Pose(5 + 0.5 * n, 5 + n)), (0.1 * n, patch)]
    return recorded(path, *timed)


def recorded(path, *timed):
    """A file of these times and inputs."""
    with closing(RecordingFile(path, SHAPE)) as recorder:
        for at_s, message in timed:
            recorder.record(message, at_s)
    return recorder.path


@pytest.mark.parametrize("method", ["astar", "auto"])
def test_a_fast_replay_gives_the_same_answers_each_time(tmp_path, drive, method):
    path = scene(tmp_path / "scene.jsonl")

    def run():
        navigator = Navigator(Ground(free()), method=method)
        source = ReplaySource(path, shape=SHAPE, fast=True)
        paths = drive(navigator, source, rate_hz=0.5, paced=False).paths
        return [m.summary() | {"planning_ms": 0.0} for m in paths]

    first = run()
    assert first == run()
    assert [m["map_version"] for m in first] == list(range(1, 41))
    assert sum(m["outcome"] == "OK" for m in first) > 20


def test_inputs_come_at_the_recorded_pace(tmp_path, monkeypatch):
    now = [50.0]
    source = ReplaySource(scene(tmp_path / "scene.jsonl", ticks=3))
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    assert [type(m) for m in source.poll()] == [Goal, Pose, MapPatch]
    now[0] += 0.05
    assert not list(source.poll())
    now[0] += 0.06
    assert [type(m) for m in source.poll()] == [Pose, MapPatch]
    assert not source.ended
    now[0] += 10.0
    assert len(list(source.poll())) == 2
    assert source.ended
    assert not list(source.poll())


def test_a_recording_of_a_replay_is_the_replay(tmp_path, drive, navigator):
    first = scene(tmp_path / "scene.jsonl", ticks=10)
    recorder = RecordingFile(tmp_path / "again.jsonl", SHAPE)
    source = ReplaySource(first, fast=True)
    with closing(RecordedSource(source, [recorder], navigator.count_error)) as recorded:
        drive(navigator, recorded, rate_hz=1.0, paced=False, ends=source)
    recorder.close()
    was = list(read_recording(first, SHAPE))
    now = list(read_recording(recorder.path, SHAPE))
    assert [encode(message) for _, message in now] == [encode(message) for _, message in was]
    assert len({at for at, _ in now}) == 10, "one time for each tick"


def test_what_came_is_in_the_file_at_once_and_the_next_recording_has_one_of_its_own(tmp_path):
    poses = [Pose(n, n) for n in range(9)]
    with closing(RecordingFile(tmp_path / "scene.jsonl", SHAPE)) as recorder:
        for at_s, pose in enumerate(poses):
            recorder.record(pose, at_s)
        assert list(read_recording(recorder.path, SHAPE)) == list(enumerate(poses))
    path = recorded(tmp_path / "scene.jsonl")
    assert path.name == "scene-2.jsonl" and len(list(read_recording(recorder.path))) == 9


@pytest.mark.parametrize(("cut", "kept"), [(1, 11), (10, 10), (60, 10)])
def test_a_line_that_was_cut_off_is_left_out(tmp_path, caplog, cut, kept):
    path = scene(tmp_path / "scene.jsonl", ticks=5)
    path.write_bytes(path.read_bytes()[:-cut])
    assert len(list(read_recording(path))) == kept
    assert ("was cut off" in caplog.text) == (kept == 10)


def test_a_recording_that_is_damaged_while_it_is_played_is_a_failure(tmp_path):
    path = scene(tmp_path / "scene.jsonl", ticks=500)
    source = ReplaySource(path, fast=True)
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(size // 2)
        file.write(b"garbage\n" * (size // 16))
    for _ in range(500):
        list(source.poll())
    assert source.ended
    assert "wanted a pose, goal or patch" in source.failure


POSE = '{"at":1,"type":"pose","row":1,"col":2}'


REFUSED = r"""
garbage                                          | line 1: wanted a pose, goal or patch.*malformed
POSE\n{"at":0.5,"type":"pose","row":1,"col":2}   | line 2: at: wanted times that do not go back, got
{"type":"pose","row":1,"col":2}                  | line 1: at: wanted the seconds since .* began, got none
{"at":-1,"type":"pose","row":1,"col":2}          | at: Expected `float` >= 0.0
POSE\n\n\n{"at":2,"type":"pose","row":1}         | line 4: .* missing required field `col`
{"type":"recording","map":[1,2]}\nPOSE           | map of \[40, 60\] cells, got one of \[1, 2\]
{"v":9,"type":"recording"}                       | version 1
LONG                                             | line 1: wanted a message of at most
"""


@pytest.mark.parametrize(("content", "words"), cases(REFUSED))
def test_what_is_no_recording_is_refused_at_the_begin(tmp_path, content, words):
    path = tmp_path / "scene.jsonl"
    path.write_text(content.replace("POSE", POSE).replace("LONG", "x" * (18 << 20)) + "\n")
    with pytest.raises(ReplayError, match=words) as raised:
        ReplaySource(path, shape=SHAPE)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize("name", ["none.jsonl", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, name):
    with pytest.raises(ReplayError, match="cannot be read"):
        ReplaySource(tmp_path / name)


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(OutputError, match="could not be written"):
        RecordingFile(tmp_path / "no" / "folder.jsonl", SHAPE)


class Kept:
    """A recorder that keeps what it is given, and first does something else."""

    def __init__(self, first=lambda: None):
        self.first = first
        self.seen = []

    def record(self, message, at_s):
        self.first()
        self.seen.append(message)


def test_large_patches_that_wait_for_a_slow_recorder_are_few():
    free = threading.Event()
    counted = []
    stuck = Kept(lambda: free.wait(20.0))
    patches = [MapPatch(0, 0, cost=np.zeros((1000, 1000)))] * 100
    source = SimpleNamespace(poll=lambda: patches)
    recorded = RecordedSource(source, [stuck], counted.append)
    assert list(recorded.poll()) == patches
    free.set()
    recorded.close()
    assert 10 <= len(stuck.seen) <= 20
    assert len(stuck.seen) + len(counted) == 100


def test_a_slow_recorder_is_waited_for_where_nothing_may_be_left_out():
    counted = []
    slow = Kept(lambda: time.sleep(0.00005))
    poses = [Pose(n, n) for n in range(5000)]
    passed = RecordedSource(SimpleNamespace(poll=lambda: poses), [slow], counted.append, wait=True)
    assert list(passed.poll()) == poses
    passed.close()
    assert (slow.seen, counted) == (poses, [])


def test_a_recorder_that_fails_is_counted_and_the_inputs_come_nevertheless(caplog):
    def fail():
        raise OSError("no space left")

    counted = []
    works = Kept()
    poses = [Pose(n, n) for n in range(9)]
    source = SimpleNamespace(poll=lambda: poses)
    recorded = RecordedSource(source, [Kept(fail), works], counted.append)
    assert list(recorded.poll()) == poses
    recorded.close()
    assert works.seen == poses
    assert counted == ["record"] * 9
    assert [record.getMessage() for record in caplog.records] == [
        "recording an input failed (no space left); more of the same is counted, not logged"
    ]
    assert not caplog.records[0].exc_info


@pytest.mark.parametrize("kept", [[], [(0.0, Pose(1, 2))]])
def test_on_a_full_disk_nothing_follows_the_line_that_was_cut(tmp_path, full_disk, kept):
    whole = recorded(tmp_path / "whole.jsonl", *kept).stat().st_size if kept else 0
    with full_disk(whole + 10):
        recorder = RecordingFile(tmp_path / "scene.jsonl", SHAPE)
    for at_s, message in kept:
        recorder.record(message, at_s)
    for _ in range(2):  # for the recorder to tell, also where the disk was full from the start
        with pytest.raises(OSError, match=r"space|before"):
            recorder.record(Pose(3, 4), 0.1)
    recorder.close()
    assert list(read_recording(recorder.path)) == kept
