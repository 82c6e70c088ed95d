"""The wire: what is taken, what is refused and with which words, and where a stream is cut."""

import base64
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.robot.transports.incoming import Refusals
from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import Fault, WireError, decode, decode_output, encode
from nnpp_edge.runtime import (
    Counters,
    Goal,
    MapPatch,
    Origin,
    PathMessage,
    Pose,
    Status,
    StatusMessage,
)
from nnpp_edge.runtime.loop.connections import Mailbox


def same(a, b):
    """Two patches, cell by cell and bit by bit."""
    for name in ("elevation", "cost"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.row, a.col, a.keep_known, a.stamp) == (b.row, b.col, b.keep_known, b.stamp)


def test_inputs_come_back_as_they_were():
    for message in (Pose(3.25, -7.5, 12.5), Goal(3, 400), Goal(-1, 0, 1e9)):
        assert decode(encode(message)) == message
    values = np.array([[0.1, np.nan, np.inf], [1e-40, 3.4e38, 0.0]], np.float32)
    same(decode(encode(patch := MapPatch(-4, 9, cost=values, keep_known=True, stamp=2.5))), patch)
    same(decode(encode(patch := MapPatch(0, 0, elevation=-values))), patch)


def test_answers_come_back_as_they_were():
    path = np.array([[1, 2], [2, 3]], np.int32)
    whole = PathMessage(
        7,
        Status.OK,
        Origin.FULL,
        path,
        (1, 2),
        (2, 3),
        False,
        True,
        1.5,
        1.25,
        "auto",
        "why",
        4,
        0.5,
    )
    back = decode_output(encode(whole))
    np.testing.assert_array_equal(back.path, path)
    assert json.loads(encode(whole))["headings_deg"] == back.headings_deg.tolist() == [135.0, 135.0]
    assert back.path.dtype == np.int32
    assert replace(back, path=path).summary() == whole.summary()
    failed = PathMessage(8, Status.NO_PATH, Origin.NONE)
    assert json.loads(encode(failed))["cost"] is None
    assert json.loads(encode(failed))["headings_deg"] == []
    assert decode_output(encode(failed)).summary() == failed.summary()
    assert decode_output(encode(failed)).cost == math.inf
    line = replace(whole, waypoints=np.array([[1.0, 2.0], [2.25, 3.0]]), line_cost=1.25)
    back = decode_output(encode(line))
    assert back.waypoints.dtype == np.float64 and back.line_cost == 1.25
    np.testing.assert_array_equal(back.waypoints, line.waypoints)
    assert (
        json.loads(encode(line))["waypoints"]
        == line.summary()["waypoints"]
        == [[1.0, 2.0], [2.25, 3.0]]
    )
    for without in (whole, failed):
        assert not {"waypoints", "line_cost"} & (
            json.loads(encode(without)).keys() | without.summary().keys()
        )
    status = StatusMessage(
        9, Status.OK, "fine", Counters(ticks=9, drops={"x": 1}, tick_ms={"p50": 0.25})
    )
    assert decode_output(encode(status)) == status
    assert decode_output(encode(Fault("no", 3))) == Fault("no", 3)


def test_a_message_is_one_line_and_patches_may_be_written_by_hand():
    assert b"\n" not in encode(Fault("two\nlines")) + encode(
        MapPatch(0, 0, cost=np.zeros((50, 50)))
    )
    patch = decode(b'{"v":1,"type":"patch","row":2,"col":3,"elevation":[[1,2.5],[null,-4]]}')
    np.testing.assert_array_equal(patch.elevation, np.array([[1, 2.5], [np.nan, -4]], np.float32))
    assert patch.cost is None


def packed(shape, content):
    return {"shape": shape, "float32": base64.b64encode(content).decode()}


PATCH = {"type": "patch", "row": 0, "col": 0}
POSE = {"type": "pose", "row": 0, "col": 0}
LARGE = 1 << 20


def test_only_the_base64_of_a_message_may_be_large():
    small = b'"cost":{"shape":[1,1],"float32":"AAAAAA=="}'
    for content in (
        b'"cost":[[' + b",".join([b"0"] * LARGE) + b"]]",
        b'"cost":{"shape":[1' + b",1" * LARGE + b'],"float32":"AAAA"}',
        small + b" " * LARGE,
        small.replace(b":", b" " * LARGE + b":"),
        small + b',"elevation":{"shape":[1,1],"float32":"' + b"A" * LARGE + b'"}',
        small + b',"row":1' * LARGE,
        b'"stamp":1.' + b"1" * LARGE,
    ):
        with pytest.raises(
            WireError,
            match=r"at most 131072 bytes outside a patch's base64 values \(float32\), got",
        ):
            decode(b'{"type":"patch","row":0,"col":0,' + content + b"}")


def test_a_large_patch_comes_back_bit_by_bit():
    for side in (300, 301, 302):
        values = (
            np.random.default_rng(side).integers(0, 2**32, (side, side), np.uint32).view(np.float32)
        )
        message = encode(patch := MapPatch(1, 2, elevation=values))
        fields = json.loads(message)
        pretty = json.dumps(fields, indent=2)
        last = json.dumps({**fields, "elevation": fields.pop("elevation")})
        for written in (message, message.replace(b"/", b"\\/"), pretty.encode(), last.encode()):
            same(decode(written), patch)
        with pytest.raises(WireError, match="Invalid base64"):
            decode(message[:150_000] + b"!" + message[150_001:])


REFUSED = (
    (b"", "wanted a pose, goal or patch, got '' .*truncated"),
    (b"garbage", "got 'garbage' .*malformed"),
    (b"[1,2]", r"got '\[1,2\]' .*Expected `object`"),
    (b'{"type":"pose","row":0,"col":0,"\xff":1}', "utf-8"),
    (b"[" * 100_000, "Expected `object`"),
    (
        b'{"type":"patch","row":0,"col":0,"cost":' + b"[" * 100_000,
        r"cost\[0\]\[0\]: Expected `float | null`",
    ),
    (b'{"type":"pose","row":NaN,"col":0}', "malformed"),
    (b'{"type":"pose","row":' + b"9" * 9000 + b',"col":0}', "row: "),
    (POSE | {"row": 2.0**31 + 1}, "row: Expected `float` <= 2147483648.0"),
    ({"row": 1, "col": 1}, "missing required field `type`"),
    ({"type": "path"}, "type: Invalid value 'path'"),
    (POSE | {"v": 2}, "wanted version 1 of the messages"),
    (POSE | {"v": True}, "wanted version 1"),
    (POSE | {"col": True}, "col: Expected `float`, got `bool`"),
    (POSE | {"stamp": None}, "stamp: Expected `float`, got `null`"),
    (POSE | {"keep_known": True}, "unknown field `keep_known`"),
    ({"type": "pose", "row": 1}, "missing required field `col`"),
    ({"type": "goal", "row": 1.5, "col": 0}, "a goal's row must be a whole number"),
    (PATCH, "either elevation or cost"),
    (PATCH | {"row": 0.5, "cost": [[1]]}, "whole number"),
    (PATCH | {"cost": [[1]], "elevation": [[1]]}, "either elevation or cost"),
    (PATCH | {"cost": [[1]], "keep_known": 1}, "keep_known: Expected `bool`, got `int`"),
    (PATCH | {"cost": [[-1]]}, "at least 0"),
    (PATCH | {"cost": [[]]}, r"cost\[0\]: Expected `array` of length >= 1"),
    (PATCH | {"cost": [[1, 2], [3]]}, r"of one length, got \[1, 2\]"),
    (PATCH | {"cost": [[1, True]]}, "got `bool`"),
    (PATCH | {"cost": [[10**400]]}, "Number out of range"),
    (PATCH | {"cost": {"shape": [1, 1], "float32": "AAAA!AA="}}, "cost.float32: Invalid base64"),
    (PATCH | {"cost": packed([2, 2], b"1234")}, "cost has 4 bytes for 2 × 2 cells"),
    (PATCH | {"cost": packed([0, 2], b"")}, r"cost.shape\[0\]: Expected `int` >= 1"),
    (PATCH | {"cost": packed([10**9, 10**9], b"1234")}, "4 bytes for"),
    (PATCH | {"cost": packed([1, 1], b"1234") | {"more": 1}}, "unknown field `more`"),
)


def test_what_makes_no_sense_is_refused_in_one_line():
    for payload, words in REFUSED:
        with pytest.raises(WireError, match=words) as raised:
            decode(json.dumps(payload).encode() if isinstance(payload, dict) else payload)
        assert len(str(raised.value)) < 400
        assert "\n" not in str(raised.value)
    with pytest.raises(WireError, match="at most 100 bytes, got 200"):
        decode(b"x" * 200, 100)


def test_where_one_kind_is_wanted_the_type_may_be_left_out_and_no_other_may_come():
    assert decode(b'{"row":1,"col":2}', kind="goal") == Goal(1, 2)
    assert decode(b'{"type":"goal","row":1,"col":2}', kind="goal") == Goal(1, 2)
    with pytest.raises(WireError, match=r"wanted a goal, got .* .type: Invalid value 'pose'"):
        decode(encode(Pose(1, 2)), kind="goal")


def test_an_answer_that_is_none_is_refused():
    message = PathMessage(7, Status.OK, Origin.FULL, np.array([[1, 2]], np.int32), (1, 2), (1, 2))
    for change in (
        {"path": [[1]]},
        {"path": "x"},
        {"outcome": "FINE"},
        {"start": 5},
        {"path": []},
        {"tick": None},
    ):
        with pytest.raises(WireError, match="wanted an answer of the loop"):
            decode_output(json.dumps(json.loads(encode(message)) | change).encode())
    with pytest.raises(WireError, match="missing required field `counters`"):
        decode_output(b'{"type":"status","tick":1,"outcome":"OK","text":""}')


# --- lines


class Pieces(io.RawIOBase):
    """A stream that arrives in pieces of so many bytes."""

    def __init__(self, content, size):
        self.content = content
        self.size = size

    def readable(self):
        return True

    def readinto(self, buffer):
        piece = self.content[: self.size]
        self.content = self.content[self.size :]
        buffer[: len(piece)] = piece
        return len(piece)


def test_a_stream_is_cut_the_same_however_it_arrives_and_what_is_too_long_is_skipped():
    for size in (1, 3, 7, 30, 1000):
        stream = io.BufferedReader(Pieces(b'one\n\r\n  {"three": 3} \r\n\nfour', size))
        assert list(messages(stream)) == [b"one", b'{"three": 3}', b"four"]
        content = (
            b"a\n" + b"b" * 500 + b"\nc\n" + b"d" * 21 + b"\n" + b"e" * 20 + b"\n" + b"f" * 70000
        )
        first, long, c, longer, e, longest = messages(io.BufferedReader(Pieces(content, size)), 20)
        assert (first, c, e) == (b"a", b"c", b"e" * 20)
        assert all("at most 20 bytes" in str(error) for error in (long, longer, longest))


# --- the mailbox


def patch(value, side=2):
    return MapPatch(0, 0, cost=np.full((side, side), value))


def test_a_full_mailbox_drops_the_oldest_patches_and_ends_when_it_is_closed_and_empty():
    box = Mailbox(3)
    assert [box.put(patch(n), when_full="drop oldest") for n in range(5)] == [0, 0, 0, 1, 1]
    for col in range(4):
        box.put(Pose(0, col), when_full="drop oldest")
    box.put(Goal(5, 5), when_full="drop oldest")
    first, second, *rest = box.read()
    assert (first, second) == (Pose(0, 3), Goal(5, 5))
    assert [float(p.cost[0, 0]) for p in rest] == [2.0, 3.0, 4.0]
    assert box.drops == 2
    box.put(patch(1), when_full="wait")
    assert not box.ended
    box.close()
    assert not box.ended
    assert len(list(box.read())) == 1
    assert box.ended


def test_room_is_counted_in_cells_too_and_one_patch_always_fits():
    box = Mailbox(4, cells_as_one=25)
    assert box.put(patch(1, 20), when_full="wait") == 0
    assert box.put(patch(2, 10), when_full="drop oldest") == 1
    assert box.put(patch(3, 1), when_full="drop oldest") == 1
    assert [p.shape for p in box.read()] == [(1, 1)]


def test_refusals_are_counted_answered_and_logged_a_few_times(caplog):
    counted = []
    refusals = Refusals(counted.append)
    for n in range(1000):
        refusals.add(WireError(f"bad {n}"))
    assert counted == ["input"] * 1000
    assert len(caplog.records) == 5
    waiting = refusals.waiting()
    assert len(waiting) == 64 and waiting[-1] == Fault("bad 999", 1000) and not refusals.waiting()
