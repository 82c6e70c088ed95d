"""The MCAP log: its ROS messages, its limit, and a disk that is full."""

import json
import logging
import math
import time
from contextlib import closing, suppress
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mcap_ros2")
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from nnpp_edge.robot.transports import mcap_log
from nnpp_edge.robot.transports.mcap_log import TOPICS, McapLog
from nnpp_edge.ros.maps import as_occupancy
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
HEIGHTS = np.array([[0, np.nan, 2], [3, 4, 5]], np.float32)
PATHS = ([(2, 3)], [(2, 3), (3, 3)], [(2, 3), (3, 3), (4, 4), (5, 4), (6, 5)])
TURNS_DEG = ([0.0], [90.0, 90.0], [90.0, 45.0, 90.0, 45.0, 45.0])
"""Headings along these, from columns to rows."""


def answer(cells, tick=1):
    path = np.array(cells, np.int32).reshape(-1, 2)
    if not len(path):
        return PathMessage(tick, Status.NO_PATH, Origin.NONE, reason="walled in")
    return PathMessage(tick, Status.OK, Origin.FULL, path, (1, 1), (2, 2), cost=3.5)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.mcap"


def read(path):
    """The messages of a finished file by topic, decoded with the schemas that it holds itself."""
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
            assert schema.name == TOPICS[channel.topic].replace("/", "/msg/")
            found.setdefault(channel.topic, []).append(message)
    return found


def read_unfinished(path):
    """What can be read of a file that just ends somewhere."""
    found = {}
    with path.open("rb") as file, suppress(McapError):  # here it ends
        reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message)
    return found


def ticks_of(found):
    return [json.loads(message.data)["tick"] for message in found["/answer"]]


def grid_of(message):
    return np.array(message.data, np.int8).reshape(message.info.height, message.info.width)


def xy(pose):
    return pose.position.x, pose.position.y


def test_inputs_and_answers_are_written_where_they_lie_in_metres(path):
    cost = np.linspace(0.0, 0.99, 20 * 31, dtype=np.float32).reshape(20, 31)
    cost[3, 4:6] = 1.0, np.inf
    cost[19, 30] = np.nan
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
    found = read(path)
    assert found.keys() == TOPICS.keys()

    (whole,) = found["/map"]
    np.testing.assert_array_equal(grid_of(whole), as_occupancy(cost))
    assert (whole.info.resolution, whole.header.frame_id) == (0.5, "map")
    (patch,) = found["/map_patch"]
    assert grid_of(patch).tolist() == [[50, -1, 100]]
    assert xy(patch.info.origin) == (2.5, 2.0)
    (heights,) = found["/elevation_patch"]
    assert xy(heights.info.pose) == (4.25, 0.0) and len(heights.data[0].data) == HEIGHTS.size

    (pose,) = found["/pose"]
    (goal,) = found["/goal"]
    assert (xy(pose.pose), xy(goal.pose)) == ((1.75, 1.125), (14.75, 9.25))
    assert abs(time.time() - pose.header.stamp.sec) < 60.0

    for cells, turns_deg, message in zip(PATHS, TURNS_DEG, found["/path"], strict=True):
        poses = [each.pose for each in message.poses]
        assert list(map(xy, poses)) == [(0.5 * col + 0.25, 0.5 * row + 0.25) for row, col in cells]
        turns = [2.0 * math.degrees(math.atan2(p.orientation.z, p.orientation.w)) for p in poses]
        assert turns == pytest.approx(turns_deg)

    answers = [json.loads(message.data) for message in found["/answer"]]
    assert [(a["tick"], a["outcome"], a["path"]) for a in answers] == [
        (number, "OK", number) for number in (1, 2, 5)
    ]
    assert not any("headings_deg" in a for a in answers)
    assert json.loads(found["/status"][0].data)["counters"]["ticks"] == 3


def test_a_path_that_only_shrank_is_not_written_again_and_a_lost_one_is(path):
    cells = [(n, n) for n in range(9)]
    with closing(McapLog(path, STATE)) as log:
        for each in ([], [], cells, cells[1:], cells[5:], cells[4:], [], cells):
            log.publish(answer(each))
    assert [len(message.poses) for message in read(path)["/path"]] == [0, 9, 5, 0, 9]


def test_a_log_fills_at_most_its_limit_and_keeps_the_newest(path, monkeypatch):
    monkeypatch.setattr(mcap_log, "_FLUSH_EVERY_S", 0.0)
    monkeypatch.setattr(mcap_log, "_LIMIT_BYTES", 0.12e6)
    rng = np.random.default_rng(0)
    with closing(McapLog(path, STATE)) as log:
        for tick in range(250):
            log.publish(answer(rng.integers(0, 1000, (50, 2)), tick))
    files = sorted(path.parent.iterdir())
    assert [f.name for f in files] == ["log.1.mcap", "log.mcap"]
    assert sum(f.stat().st_size for f in files) < 1.1 * 0.12e6
    first, second = map(read, files)
    begin, *_ = ticks = ticks_of(first) + ticks_of(second)
    assert ticks == list(range(begin, 250)) and begin > 0
    assert (len(first["/map"]), len(second["/map"]), log.lost) == (1, 1, 0)


def test_what_is_older_than_a_flush_can_be_read_of_a_log_without_an_end(path, monkeypatch):
    monkeypatch.setattr(mcap_log, "_FLUSH_EVERY_S", 0.0)
    with closing(McapLog(path, STATE)) as log:
        for tick in range(9):
            log.publish(answer([(tick, 1)], tick))
        killed = path.read_bytes()  # as it is where the process ends now
    path.write_bytes(killed)
    McapLog(path, STATE).close()
    assert path.read_bytes() == killed
    assert len(read(path.with_name("log-2.mcap"))["/map"]) == 1
    with pytest.raises(McapError):
        read(path)
    assert ticks_of(read_unfinished(path)) == list(range(9))


def test_a_full_disk_ends_the_log_with_one_warning_and_not_the_loop(
    path, monkeypatch, caplog, full_disk
):
    with full_disk(9000):
        log = McapLog(path, STATE)
    monkeypatch.setattr(mcap_log, "_FLUSH_EVERY_S", 0.0)
    nav = Navigator(Ground(flat(60, 60, 0.2)))
    goals = iter(range(40))
    source = SimpleNamespace(poll=lambda: [Pose(3, 3), Goal(50, next(goals))])
    with caplog.at_level(logging.WARNING):
        counters = Loop(nav, source, [log], rate_hz=200, queue=1000).run(40)
    assert (counters.ticks, counters.errors, counters.drops["mcap"]) == (40, {}, 0)
    assert 0 < log.lost < 80
    lost = log.lost
    log.record(Pose(1, 1))
    log.close()
    log.publish(answer([(1, 1)]))
    assert log.lost > lost
    assert len(read_unfinished(path)["/answer"]) > 3
    (warned,) = (r.getMessage() for r in caplog.records if "log" in r.getMessage())
    assert "No space left" in warned


def test_no_input_is_lost_for_want_of_an_answer(path):
    with closing(McapLog(path, STATE)) as log:
        begun = path.stat().st_size
        for n in range(3000):
            log.record(Pose(n, n))
        assert path.stat().st_size > begun, "not all wait in memory"
    assert (len(read(path)["/pose"]), log.lost) == (3000, 0)


def test_the_map_is_shown_again_while_heights_come(path, monkeypatch):
    monkeypatch.setattr(mcap_log, "_MAP_EVERY_S", 0.0)
    state = map_state(Ground.of_elevation(flat(20, 20), 1.0))
    patch = MapPatch(5, 5, elevation=np.array([[3.0]]))
    with closing(McapLog(path, state)) as log:
        log.publish(answer([]))
        state.update(5, 5, patch.elevation, layer="heights")
        log.record(patch)
        log.publish(answer([]))
        log.publish(answer([]))
    before, after = map(grid_of, read(path)["/map"])
    assert (before == 0).all() and after[5, 5] > 0
    np.testing.assert_array_equal(np.argwhere(after != before).min(axis=0), [4, 4])


def test_a_file_that_cannot_be_begun_is_refused(tmp_path):
    with pytest.raises(OutputError, match="could not be written"):
        McapLog(tmp_path / "missing" / "log.mcap", STATE)
