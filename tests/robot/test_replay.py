"""Recordings: what goes in comes out, at its pace or as fast as can be, and a crash costs a line at
most.
"""

import json
import threading
import time
from contextlib import closing
from pathlib import Path
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
    InProcessSource,
    MapPatch,
    Navigator,
    NavigatorSettings,
    Pose,
)
from nnpp_edge.runtime.errors import OutputError
from tests.robot.conftest import free

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


def told(paths):
    """What a run came to, without its times."""
    return [
        (m.tick, m.outcome, m.origin, m.path.tolist(), m.cost, m.method, m.map_version)
        for m in paths
    ]


def recorded(path, *timed):
    """A file of these times and inputs."""
    with closing(RecordingFile(path, SHAPE)) as recorder:
        for at_s, message in timed:
            recorder.record(message, at_s)
    return recorder.path


@pytest.mark.parametrize("method", ["astar", "auto"])
def test_a_fast_replay_gives_the_same_answers_each_time(tmp_path, drive, method):
    path = scene(tmp_path / "scene.jsonl")
    runs = []
    for _ in range(2):
        navigator = Navigator(Ground(free()), NavigatorSettings(method=method))
        source = ReplaySource(path, shape=SHAPE, fast=True)
        runs.append(drive(navigator, source, rate_hz=0.5, paced=False))
    assert told(runs[0].paths) == told(runs[1].paths)
    assert (runs[0].counters.ticks, runs[0].counters.patches) == (40, 40)
    assert len({m.map_version for m in runs[0].paths}) == 40
    assert sum(m.ok for m in runs[0].paths) > 20


def test_inputs_come_at_the_recorded_pace(tmp_path):
    now = [50.0]
    source = ReplaySource(scene(tmp_path / "scene.jsonl", ticks=3), clock=lambda: now[0])
    assert source.messages == 7
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
    with closing(RecordedSource(source, [recorder.record], navigator.count_error)) as recorded:
        drive(navigator, recorded, rate_hz=1.0, paced=False, ends=source)
    recorder.close()
    was, now = (list(read_recording(path, SHAPE)) for path in (first, recorder.path))
    assert [encode(message) for _, message in now] == [encode(message) for _, message in was]
    batches = [sorted({at for at, _ in messages}) for messages in (was, now)]
    assert len(batches[0]) == len(batches[1]) == 10


def test_a_line_that_was_cut_off_is_left_out(tmp_path, caplog):
    path = scene(tmp_path / "scene.jsonl", ticks=5)
    whole = path.read_bytes()
    for cut in (1, 10, 60):
        path.write_bytes(whole[:-cut])
        assert ReplaySource(path).messages == (11 if cut == 1 else 10)
    assert "was cut off" in caplog.text


def test_at_full_speed_a_tick_gets_all_that_one_recorded_tick_got(tmp_path, drive):
    patches = [MapPatch(n % 40, 0, cost=np.full((1, 60), 0.1 + 0.001 * n)) for n in range(600)]
    path = recorded(
        tmp_path / "scene.jsonl", *((float(n // 200), patch) for n, patch in enumerate(patches))
    )
    ended = drive(
        Navigator(Ground(free())), ReplaySource(path, fast=True), rate_hz=2000.0, paced=False
    )
    assert [m.map_version for m in ended.paths] == [200, 400, 600]


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


POSE = '{"at":1,"type":"pose","row":1,"col":2}\n'


def test_what_is_no_recording_is_refused_at_the_begin(tmp_path):
    path = tmp_path / "scene.jsonl"
    for content, words in (
        ("garbage\n", "line 1: wanted a pose, goal or patch.*malformed"),
        (POSE + POSE.replace("1", "0.5"), r"line 2: at: wanted times that do not go back, got 0.5"),
        (
            '{"type":"pose","row":1,"col":2}\n',
            "line 1: at: wanted the seconds since the recording began, got none",
        ),
        ('{"at":true,"type":"pose","row":1,"col":2}\n', "at: Expected `float | null`, got `bool`"),
        ('{"at":-1,"type":"pose","row":1,"col":2}\n', "at: Expected `float` >= 0.0"),
        (
            POSE + "\n\n" + '{"at":2,"type":"pose","row":1}\n',
            "line 4: .* missing required field `col`",
        ),
        (
            '{"type":"recording","map":[1,2]}\n' + POSE,
            r"map of \[40, 60\] cells, got one of \[1, 2\]",
        ),
        ('{"v":9,"type":"recording"}\n', "version 1"),
        ("\0" * (18 << 20), "line 1: wanted a message of at most"),
    ):
        path.write_text(content)
        with pytest.raises(ReplayError, match=words) as raised:
            ReplaySource(path, shape=SHAPE)
        assert str(path) in str(raised.value)
    for path in (tmp_path / "none.jsonl", tmp_path):
        with pytest.raises(ReplayError, match="cannot be read"):
            ReplaySource(path)
    with pytest.raises(OutputError, match="could not be written"):
        RecordingFile(tmp_path / "no" / "folder.jsonl", SHAPE)


def test_large_patches_that_wait_for_a_slow_recorder_are_few(tmp_path):
    free = threading.Event()
    counted = []
    seen = []

    def stuck(message, at_s):
        free.wait(20.0)
        seen.append(message)

    patch = MapPatch(0, 0, cost=np.zeros((1000, 1000)))
    source = InProcessSource()
    recorded = RecordedSource(source, [stuck], counted.append)
    for _ in range(100):
        source.put(patch)
    assert len(list(recorded.poll())) == 100
    free.set()
    recorded.close()
    assert 10 <= len(seen) <= 20
    assert len(seen) + len(counted) == 100


def test_a_slow_recorder_is_waited_for_where_nothing_may_be_left_out(tmp_path):
    counted = []
    seen = []

    def slow(message, at_s):
        time.sleep(0.00005)
        seen.append(message)

    poses = [Pose(n, n) for n in range(5000)]
    passed = RecordedSource(SimpleNamespace(poll=lambda: poses), [slow], counted.append, wait=True)
    assert list(passed.poll()) == poses
    passed.close()
    assert (seen, counted) == (poses, [])


def test_a_recorder_that_fails_is_counted_and_the_inputs_come_nevertheless(tmp_path, caplog):
    def full(message, at_s):
        raise OSError("no space left")

    counted = []
    seen = []
    source = ReplaySource(scene(tmp_path / "scene.jsonl", ticks=4), fast=True)
    recorded = RecordedSource(
        source, [full, lambda message, at_s: seen.append(message)], counted.append
    )
    taken = []
    while not source.ended:
        taken += recorded.poll()
    recorded.close()
    assert len(taken) == len(seen) == 9
    assert counted == ["record"] * 9
    assert [record.getMessage() for record in caplog.records] == [
        "recording an input failed (no space left); more of the same is counted, not logged"
    ]
    assert not caplog.records[0].exc_info


class Full:
    """A file that takes so many lines whole, and of each further one the first ten bytes, or
    nothing.
    """

    def __init__(self, file, lines):
        self.file = file
        self.lines = lines
        self.close = file.close
        self.name = file.name

    def write(self, line):
        self.lines -= 1
        if self.lines < -1:
            raise OSError(28, "No space left on device")
        return self.file.write(line if self.lines >= 0 else line[:10])


def test_on_a_full_disk_nothing_follows_the_line_that_was_cut(tmp_path, monkeypatch):
    open_file = Path.open
    left = []
    for lines, kept in ((0, []), (2, [(0.0, Pose(1, 2))])):
        left.append(lines)
        with monkeypatch.context() as patched:
            patched.setattr(
                Path, "open", lambda *given, **options: Full(open_file(*given, **options), left[-1])
            )
            recorder = RecordingFile(tmp_path / f"scene{lines}.jsonl", SHAPE)
        for at_s, message in kept:
            recorder.record(message, at_s)
        for _ in range(2):  # for the recorder to tell, also where the disk was full from the start
            with pytest.raises(OSError, match=r"space|before"):
                recorder.record(Pose(3, 4), 0.1)
        recorder.close()
        assert list(read_recording(recorder.path)) == kept


def test_a_recording_is_plain_json(tmp_path):
    lines = scene(tmp_path / "scene.jsonl", ticks=1).read_text().splitlines()
    assert json.loads(lines[0]) == {"v": 1, "type": "recording", "map": [40, 60]}
    assert json.loads(lines[1]) == {
        "at": 0.0,
        "v": 1,
        "type": "goal",
        "row": 35,
        "col": 55,
        "stamp": 0.0,
    }
