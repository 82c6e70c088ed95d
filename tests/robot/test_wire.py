"""The wire: what is taken, what is refused and with which words, and where a stream is cut."""

import io
import json
import re
from dataclasses import asdict, replace

import numpy as np
import pytest

from nnpp_edge.robot.transports.incoming import Refusals
from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import Fault, WireError, decode, encode
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
from tests.tables import cases

VALUES = np.array([[0.1, np.nan, np.inf], [1e-40, 3.4e38, 0.0]], np.float32)
PATH = np.array([[1, 2], [2, 3]], np.int32)
ANSWER = PathMessage(
    7,
    Status.OK,
    Origin.FULL,
    PATH,
    (1, 2),
    (2, 3),
    degraded=True,
    cost=1.5,
    lower_bound=1.25,
    method="auto",
    choice="why",
    map_version=4,
    planning_ms=0.5,
)
LINE = replace(ANSWER, waypoints=np.array([[1.0, 2.0], [2.25, 3.0]]), line_cost=1.25)
FAILED = PathMessage(8, Status.NO_PATH, Origin.NONE)


def same(a, b):
    """Two patches, cell by cell and bit by bit."""
    for name in ("elevation", "cost"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.row, a.col, a.keep_known, a.stamp) == (b.row, b.col, b.keep_known, b.stamp)


@pytest.mark.parametrize(
    "patch",
    [
        MapPatch(-4, 9, cost=VALUES, keep_known=True, stamp=2.5),
        MapPatch(0, 0, elevation=-VALUES),
    ],
)
def test_patches_come_back_bit_by_bit_in_one_line(patch):
    assert b"\n" not in encode(patch)
    same(decode(encode(patch)), patch)


@pytest.mark.parametrize("answer", [ANSWER, LINE, FAILED])
def test_answers_are_written_as_they_are(answer):
    written = json.loads(encode(answer))
    assert written == {"v": 1, "type": "path"} | json.loads(json.dumps(answer.summary()))
    assert ({"waypoints", "line_cost"} <= written.keys()) == (answer is LINE)


def test_a_cost_that_is_not_known_is_null():
    assert json.loads(encode(FAILED))["cost"] is None


STATUS = StatusMessage(9, Status.OK, "fine", Counters(drops={"x": 1}, tick_ms={"a": 0.25}))


@pytest.mark.parametrize("message", [Pose(3.25, -7.5, 12.5), Goal(3, 400), Goal(-1, 0, 1e9, 45.0)])
def test_places_come_back_as_they_were_from_one_line(message):
    assert b"\n" not in encode(message)
    assert decode(encode(message)) == message


@pytest.mark.parametrize(
    ("kind", "message"), [("status", STATUS), ("error", Fault("two\nlines", 3))]
)
def test_other_answers_are_written_as_they_are_in_one_line(kind, message):
    assert b"\n" not in encode(message)
    assert json.loads(encode(message)) == {"v": 1, "type": kind} | asdict(message)


def test_patches_may_be_written_by_hand():
    patch = decode(b'{"v":1,"type":"patch","row":2,"col":3,"elevation":[[1,2.5],[null,-4]]}')
    np.testing.assert_array_equal(patch.elevation, np.array([[1, 2.5], [np.nan, -4]], np.float32))
    assert patch.cost is None


LARGE = 1 << 20
SMALL = b'"cost":{"shape":[1,1],"float32":"AAAAAA=="}'


@pytest.mark.parametrize(
    "content",
    [
        b'"cost":[[' + b",".join([b"0"] * LARGE) + b"]]",
        b'"cost":{"shape":[1' + b",1" * LARGE + b'],"float32":"AAAA"}',
        SMALL + b" " * LARGE,
        SMALL.replace(b":", b" " * LARGE + b":"),
        SMALL + b',"elevation":{"shape":[1,1],"float32":"' + b"A" * LARGE + b'"}',
        b'"stamp":1.' + b"1" * LARGE,
    ],
    ids=["list", "shape", "blanks", "blanks within", "second layer", "number"],
)
def test_only_the_base64_of_a_message_may_be_large(content):
    words = r"at most 131072 bytes outside a patch's base64 values \(float32\), got"
    with pytest.raises(WireError, match=words):
        decode(b'{"type":"patch","row":0,"col":0,' + content + b"}")


@pytest.mark.parametrize("side", [300, 301, 302])
def test_a_large_patch_comes_back_bit_by_bit_however_it_is_laid_out(side):
    bits = np.random.default_rng(side).integers(0, 2**32, (side, side), np.uint32)
    patch = MapPatch(1, 2, elevation=bits.view(np.float32))
    message = encode(patch)
    fields = json.loads(message)
    pretty = json.dumps(fields, indent=2)
    last = json.dumps({**fields, "elevation": fields.pop("elevation")})
    for written in (message, message.replace(b"/", b"\\/"), pretty.encode(), last.encode()):
        same(decode(written), patch)
    with pytest.raises(WireError, match="Invalid base64"):
        decode(message[:150_000] + b"!" + message[150_001:])


REFUSED = r"""
                                        | wanted a pose, goal or patch, got '' .*truncated
garbage                                 | got 'garbage' .*malformed
{"type":"pose","row":0,"col":0,"\xff":1} | (?i)utf-8
{"type":"path"}                         | type: Invalid value 'path'
{"type":"pose","row":2147483649,"col":0} | row: Expected `float` <= 2147483648.0
{"type":"pose","row":0,"col":0,"v":2}   | wanted version 1 of the messages
{"type":"pose","row":0,"col":true}      | col: Expected `float`, got `bool`
{"type":"pose","row":0,"col":0,"keep_known":true} | unknown field `keep_known`
{"type":"pose","row":1}                 | missing required field `col`
{"type":"goal","row":1.5,"col":0}       | a goal's row must be a whole number
{"type":"patch","row":0,"col":0}        | either elevation or cost
{"type":"patch","row":0.5,"col":0,"cost":[[1]]} | whole number
{"type":"patch","row":0,"col":0,"cost":[[-1]]} | at least 0
{"type":"patch","row":0,"col":0,"cost":[[]]} | cost\[0\]: Expected `array` of length >= 1
{"type":"patch","row":0,"col":0,"cost":[[1,2],[3]]} | of one length, got \[1, 2\]
{"type":"patch","row":0,"col":0,"cost":[[1e400]]} | Number out of range
{"type":"patch","row":0,"col":0,"cost":{"shape":[2,2],"float32":"MTIzNA=="}} | 4 bytes for 2 × 2 cells
{"type":"patch","row":0,"col":0,"cost":{"shape":[0,2],"float32":""}} | shape\[0\]: Expected `int` >= 1
{"type":"patch","row":0,"col":0,"cost":{"shape":[1,1],"float32":"MTIzNA==","more":1}} | unknown field `more`
"""
NESTED = b"[" * 100_000


def refusal(payload):
    with pytest.raises(WireError) as raised:
        decode(payload)
    assert len(str(raised.value)) < 400 and "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize(("payload", "words"), cases(REFUSED))
def test_what_makes_no_sense_is_refused_in_one_line(payload, words):
    assert re.search(words, refusal(payload.replace("\\xff", "\xff").encode("latin-1")))


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (NESTED, "Expected `object`"),
        (b'{"type":"patch","row":0,"col":0,"cost":' + NESTED, "cost[0][0]: Expected `float"),
        (b'{"type":"pose","row":' + b"9" * 9000 + b',"col":0}', "row: "),
    ],
    ids=["nested", "nested in a patch", "long number"],
)
def test_what_is_too_deep_or_too_long_is_refused_in_one_line(payload, words):
    assert words in refusal(payload)


def test_a_message_beyond_the_limit_is_refused():
    with pytest.raises(WireError, match="at most 100 bytes, got 200"):
        decode(b"x" * 200, 100)


def test_where_one_kind_is_wanted_the_type_may_be_left_out_and_no_other_may_come():
    assert decode(b'{"row":1,"col":2}', kind="goal") == Goal(1, 2)
    with pytest.raises(WireError, match=r"wanted a goal, got .* .type: Invalid value 'pose'"):
        decode(encode(Pose(1, 2)), kind="goal")


# --- lines


class Pieces(io.RawIOBase):
    """A stream that arrives in pieces of so many bytes."""

    def __init__(self, content, size):
        self.content = io.BytesIO(content)
        self.size = size

    def readable(self):
        return True

    def readinto(self, buffer):
        return self.content.readinto(memoryview(buffer)[: self.size])


@pytest.mark.parametrize("size", [1, 3, 7, 30, 1000])
def test_a_stream_is_cut_the_same_however_it_arrives_and_what_is_too_long_is_skipped(size):
    stream = io.BufferedReader(Pieces(b'one\n\r\n  {"three": 3} \r\n\nfour', size))
    assert list(messages(stream)) == [b"one", b'{"three": 3}', b"four"]
    lines = [b"a", b"b" * 500, b"c", b"d" * 21, b"e" * 20, b"f" * 70000]
    stream = io.BufferedReader(Pieces(b"\n".join(lines), size))
    for line, found in zip(lines, messages(stream, 20), strict=True):
        assert found == line[:21]


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
