"""The MCAP log: its ROS messages, its limit, and a disk that is full."""

import json
import logging
import math
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mcap_ros2")
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from nnpp_edge.robot.transports import mcap_log
from nnpp_edge.robot.transports.mcap_log import TOPICS, McapLog
from nnpp_edge.runtime import (
    Counters,
    Goal,
    Ground,
    Loop,
    MapPatch,
    Navigator,
    Origin,
    PathMessage,
    Pose,
    StatusMessage,
)
from nnpp_edge.runtime.errors import OutputError, Status
from nnpp_edge.runtime.map.state import map_state
from tests.strategies import flat

STATE = map_state(Ground(flat(5, 5, 0.2)))


def answer(cells, tick=1):
    path = np.array(cells, np.int32).reshape(-1, 2)
    if not len(path):
        return PathMessage(tick, Status.NO_PATH, Origin.NONE, reason="walled in")
    return PathMessage(tick, Status.OK, Origin.FULL, path, (1, 1), (2, 2), cost=3.5)


def read(path):
    """Everything in a finished file, by topic, decoded with the schemas that the file
    itself holds.
    """
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, raw, message in reader.iter_decoded_messages():
            assert channel.message_encoding == "cdr"
            found.setdefault(channel.topic, []).append(
                SimpleNamespace(schema=schema, raw=raw, message=message)
            )
    return found


def read_unfinished(path):
    """What can be read of a file that just ends somewhere, as docs/run.md says."""
    text = (Path(__file__).parents[2] / "docs" / "run.md").read_text()
    code = text.partition("<!-- only shown: it needs a log -->\n```python\n")[2].partition("```")[0]
    names = {}
    exec(code.replace('"drive.mcap"', repr(str(path))), names)
    found = {}
    for topic, message in names["found"]:
        found.setdefault(topic, []).append(message)
    return found


def grid_of(message):
    return np.array(message.data, np.int8).reshape(message.info.height, message.info.width)


def xy(pose):
    return pose.position.x, pose.position.y


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A map of half metres, one input of each kind and answers, by topic."""
    cost = np.linspace(0.0, 0.99, 20 * 31, dtype=np.float32).reshape(20, 31)
    cost[3, 4:6] = 1.0, np.inf
    cost[19, 30] = np.nan
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    state = map_state(Ground(cost, cell_size_m=0.5), tell_unknown=True)
    with closing(McapLog(path, state)) as log:
        log.record(Pose(2.25, 3.5, stamp=7.0))
        log.record(Goal(18, 29))
        log.record(MapPatch(4, 5, cost=np.array([[0.5, np.nan, 2.0]])))
        log.record(MapPatch(-1, 7, elevation=HEIGHTS))
        for cells in PATHS:
            log.publish(answer(cells, tick=len(cells)))
        log.publish(StatusMessage(3, Status.OK, "OK by full", Counters(ticks=3)))
    assert log.lost == 0
    return cost, read(path)


HEIGHTS = np.array([[0, np.nan, 2], [3, 4, 5]], np.float32)
PATHS = ([(2, 3)], [(2, 3), (3, 3)], [(2, 3), (3, 3), (4, 4), (5, 4), (6, 5)])


def test_every_topic_holds_messages_of_its_type(log):
    _, found = log
    kinds = {topic: {m.schema.name for m in messages} for topic, messages in found.items()}
    assert kinds == {topic: {kind.replace("/", "/msg/")} for topic, kind in TOPICS.items()}
    assert found["/map"][0].schema.encoding == "ros2msg"


def test_costs_are_occupancies_where_they_lie(log):
    cost, found = log
    (whole,) = (m.message for m in found["/map"])
    expected = np.where(cost < 1.0, np.minimum(np.rint(cost * np.float32(100.0)), 98.0), 100.0)
    expected[19, 30] = -1
    np.testing.assert_array_equal(grid_of(whole), expected.astype(np.int8))
    assert (whole.info.resolution, whole.header.frame_id) == (0.5, "map")
    (patch,) = (m.message for m in found["/map_patch"])
    assert grid_of(patch).tolist() == [[50, -1, 100]]
    assert xy(patch.info.origin) == (2.5, 2.0)
    (heights,) = (m.message for m in found["/elevation_patch"])
    assert xy(heights.info.pose) == (4.25, 0.0) and len(heights.data[0].data) == HEIGHTS.size


def test_pose_and_goal_are_places_in_metres(log):
    (pose,) = log[1]["/pose"]
    (goal,) = log[1]["/goal"]
    assert xy(pose.message.pose) == (1.75, 1.125)
    assert xy(goal.message.pose) == (14.75, 9.25)
    assert abs(time.time() - pose.message.header.stamp.sec) < 60.0


def test_a_path_is_poses_in_metres_that_head_for_the_next(log):
    wanted = ([0.0], [90.0, 90.0], [90.0, 45.0, 90.0, 45.0, 45.0])  # from columns to rows
    for cells, headings, found in zip(PATHS, wanted, log[1]["/path"], strict=True):
        poses = [each.pose for each in found.message.poses]
        assert list(map(xy, poses)) == [(0.5 * col + 0.25, 0.5 * row + 0.25) for row, col in cells]
        turns = [2.0 * math.degrees(math.atan2(p.orientation.z, p.orientation.w)) for p in poses]
        assert turns == pytest.approx(headings)


def test_answers_and_status_are_json_without_what_other_topics_hold(log):
    answers = [json.loads(m.message.data) for m in log[1]["/answer"]]
    assert [(a["tick"], a["outcome"], a["path"]) for a in answers] == [
        (number, "OK", number) for number in (1, 2, 5)
    ]
    assert not any("headings_deg" in a for a in answers)
    assert json.loads(log[1]["/status"][0].message.data)["counters"]["ticks"] == 3


def test_a_path_that_only_shrank_is_not_written_again_and_a_lost_one_is(tmp_path):
    cells = [(n, n) for n in range(9)]
    with closing(McapLog(tmp_path / "log.mcap", STATE)) as log:
        for path in ([], [], cells, cells[1:], cells[5:], cells[4:], [], cells):
            log.publish(answer(path))
    lengths = [len(m.message.poses) for m in read(tmp_path / "log.mcap")["/path"]]
    assert lengths == [0, 9, 5, 0, 9]


def test_a_log_fills_at_most_its_limit_and_keeps_the_newest(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_log, "_FLUSH_EVERY_S", 0.0)
    monkeypatch.setattr(mcap_log, "_LIMIT_BYTES", 0.12e6)
    rng = np.random.default_rng(0)
    state = map_state(Ground(flat(20, 20, 0.2)))
    with closing(McapLog(tmp_path / "log.mcap", state)) as log:
        for tick in range(250):
            log.publish(answer(rng.integers(0, 1000, (50, 2)), tick))
    files = sorted(tmp_path.iterdir())
    assert [f.name for f in files] == ["log.1.mcap", "log.mcap"]
    assert sum(f.stat().st_size for f in files) < 1.1 * 0.12e6
    ticks = [[json.loads(m.message.data)["tick"] for m in read(f)["/answer"]] for f in files]
    assert ticks[0][0] > 0
    assert [*ticks[0], *ticks[1]] == list(range(ticks[0][0], 250))
    assert all(len(read(f)["/map"]) == 1 for f in files)
    assert log.lost == 0


WRITER = """
import itertools, sys, time
from pathlib import Path
from nnpp_edge.robot.transports import mcap_log
from nnpp_edge.runtime.loop.messages import Pose
from tests.robot.test_mcap_log import STATE, answer
mcap_log._FLUSH_EVERY_S = 0.1
log = mcap_log.McapLog(Path(sys.argv[1]), STATE)
for tick in itertools.count():
    log.record(Pose(tick % 7, 2))
    log.publish(answer([(tick * n % 97, tick * n % 89) for n in range(40)], tick))
    print(tick, time.monotonic(), flush=True)
    time.sleep(0.005)
"""


def test_what_was_written_before_a_kill_can_be_read(tmp_path):
    command = [sys.executable, "-c", WRITER, str(tmp_path / "log.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline().split()]
        while float(lines[-1][1]) - float(lines[0][1]) < 0.4:
            lines.append(process.stdout.readline().split())
        process.send_signal(signal.SIGKILL)
        lines += [
            line.split() for line in process.stdout.read().splitlines() if len(line.split()) == 2
        ]
    killed = (tmp_path / "log.mcap").read_bytes()
    McapLog(tmp_path / "log.mcap", STATE).close()
    assert (tmp_path / "log.mcap").read_bytes() == killed
    assert len(read(tmp_path / "log-2.mcap")["/map"]) == 1
    with pytest.raises(McapError):
        read(tmp_path / "log.mcap")
    found = read_unfinished(tmp_path / "log.mcap")
    ticks = [json.loads(m.data)["tick"] for m in found["/answer"]]
    assert ticks == list(range(len(ticks)))
    assert len(found["/pose"]) >= len(ticks) - 1
    died = float(lines[-1][1])
    older = [int(tick) for tick, at in lines if float(at) < died - 0.2]
    assert older and ticks[-1] >= older[-1], "what is older than a flush must be there"


class FullDisk:
    """A file that has room for so many bytes."""

    def __init__(self, file, room):
        self.file = file
        self.room = room

    def write(self, data):
        if self.file.tell() + len(data) > self.room:
            raise OSError(28, "No space left on device")
        return self.file.write(data)

    def __getattr__(self, name):
        return getattr(self.file, name)


def test_a_full_disk_ends_the_log_with_one_warning_and_not_the_loop(tmp_path, monkeypatch, caplog):
    open_file = Path.open

    def open_full(path, *words, **options):
        file = open_file(path, *words, **options)
        return FullDisk(file, 9000) if path.suffix == ".mcap" else file

    monkeypatch.setattr(Path, "open", open_full)
    log = McapLog(tmp_path / "log.mcap", STATE)
    monkeypatch.undo()
    monkeypatch.setattr(mcap_log, "_FLUSH_EVERY_S", 0.0)
    nav = Navigator(Ground(flat(60, 60, 0.2)))
    goals = iter(range(40))
    source = SimpleNamespace(poll=lambda: [Pose(3, 3), Goal(50, next(goals))])
    with caplog.at_level(logging.WARNING):
        counters = Loop(nav, source, [log], rate_hz=200, queue=1000).run(40)
    assert (counters.ticks, counters.errors, counters.drops["mcap"]) == (40, {}, 0)
    warned = [r.getMessage() for r in caplog.records if "log" in r.getMessage()]
    assert len(warned) == 1 and "No space left" in warned[0]
    assert 0 < log.lost < 80
    lost = log.lost
    log.record(Pose(1, 1))
    log.close()
    log.publish(answer([(1, 1)]))
    assert log.lost > lost
    assert len(read_unfinished(tmp_path / "log.mcap")["/answer"]) > 3
    assert len([r for r in caplog.records if "log" in r.getMessage()]) == 1


def test_no_input_is_lost_for_want_of_an_answer(tmp_path):
    path = tmp_path / "log.mcap"
    with closing(McapLog(path, STATE)) as log:
        begun = path.stat().st_size
        for n in range(3000):
            log.record(Pose(n, n))
        assert path.stat().st_size > begun, "not all wait in memory"
    assert len(read(path)["/pose"]) == 3000
    assert log.lost == 0


def test_the_map_is_shown_again_while_heights_come(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_log, "_MAP_EVERY_S", 0.0)
    state = map_state(Ground.of_elevation(flat(20, 20), 1.0))
    patch = MapPatch(5, 5, elevation=np.array([[3.0]]))
    with closing(McapLog(tmp_path / "log.mcap", state)) as log:
        log.publish(answer([]))
        state.update(5, 5, patch.elevation, layer="heights")
        log.record(patch)
        log.publish(answer([]))
        log.publish(answer([]))
    before, after = (grid_of(m.message) for m in read(tmp_path / "log.mcap")["/map"])
    assert (before == 0).all()
    assert after[5, 5] > 0
    np.testing.assert_array_equal(np.argwhere(after != before).min(axis=0), [4, 4])


def test_a_file_that_cannot_be_begun_is_refused(tmp_path):
    with pytest.raises(OutputError, match="could not be written"):
        McapLog(tmp_path / "missing" / "log.mcap", STATE)
