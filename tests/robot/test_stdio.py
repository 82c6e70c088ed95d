"""Standard input and output: nothing that comes or does not come stops the loop."""

import json
import os
import threading
import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.robot.transports.stdio import StdioSink, StdioSource
from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.runtime import Goal, MapPatch, Origin, PathMessage, Pose, Status
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.loop.connections import Mailbox
from tests.robot.conftest import wait_until

POSE = encode(Pose(5, 5))
GOAL = encode(Goal(35, 55))


def pipe(*, kept=False):
    """Both ends; a file may be closed twice. The reading end may be `kept` open."""
    read, write = os.pipe()
    ends = (os.fdopen(read, "rb", closefd=not kept), os.fdopen(write, "wb"))
    return SimpleNamespace(read=ends[0], write=ends[1])


@pytest.fixture
def incoming():
    """To the loop: a thread may still wait at the reading end."""
    found = pipe(kept=True)
    with found.write:
        yield found


@pytest.fixture
def outgoing():
    """From the loop."""
    found = pipe()
    with found.read, found.write:
        yield found


def send(pipe, *messages):
    """Write and close from a thread of its own, as another process would; the thread."""

    def write():
        with pipe.write:
            pipe.write.write(b"\n".join([*messages, b""]))

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    return thread


def received(pipe):
    """What was written to a pipe that nobody writes to any more."""
    pipe.write.close()
    return [json.loads(message) for message in pipe.read]


def test_garbage_is_answered_line_by_line_and_ends_nothing(
    incoming, outgoing, navigator, drive, monkeypatch
):
    monkeypatch.setattr(StdioSource, "limit", 2000)
    source = StdioSource(navigator.count_error, descriptor=incoming.read.fileno())
    sink = StdioSink(source.refusals, descriptor=outgoing.write.fileno())
    bad = (b"\x00\xff garbage", b'{"type":"pose"}', b"x" * 300_000, b'{"type":"goal","row":')
    send(incoming, POSE, *bad, GOAL)
    ended = drive(navigator, source, [sink])
    answers = received(outgoing)
    faults = [m for m in answers if m["type"] == "error"]
    assert [fault["count"] for fault in faults] == [1, 2, 3, 4]
    wanted = ("JSON is malformed", "field `row`", "at most 2000 bytes", "truncated")
    assert all(words in fault["error"] for words, fault in zip(wanted, faults, strict=True))
    assert ended.counters.errors == {"input": 4}
    assert ended.paths[-1].ok


def test_a_sender_that_is_too_fast_waits(incoming, navigator, drive, make_mailbox):
    patches = [MapPatch(0, n, cost=np.full((40, 40), n)) for n in range(100)]
    make_mailbox(partial(Mailbox, 4))
    source = StdioSource(navigator.count_error, descriptor=incoming.read.fileno())
    ended = drive(navigator, source, ticks=10)
    assert ended.counters.ticks == 10, "the loop goes on while nothing comes"
    thread = send(incoming, *map(encode, patches))
    thread.join(0.2)
    assert thread.is_alive() and not source.ended
    taken = []
    wait_until(lambda: taken.extend(source.poll()) or source.ended)
    assert [patch.col for patch in taken] == list(range(100))


def test_a_reader_that_has_gone_is_told_once(outgoing):
    sink = StdioSink(descriptor=outgoing.write.fileno())
    outgoing.read.close()
    message = PathMessage(1, Status.NO_POSE, Origin.NONE)
    with pytest.raises(OutputError, match="closed by its reader"):
        sink.publish(message)
    sink.publish(message)


def test_descriptors_that_do_not_block_are_waited_for(incoming, outgoing, navigator):
    os.set_blocking(incoming.read.fileno(), False)
    os.set_blocking(outgoing.write.fileno(), False)
    source = StdioSource(navigator.count_error, descriptor=incoming.read.fileno())
    time.sleep(0.05)  # the reader finds nothing, and must wait
    send(incoming, POSE)
    found = []
    wait_until(lambda: found.extend(source.poll()) or found)
    assert found == [Pose(5, 5)]
    path = np.zeros((20_000, 2), np.int32)
    message = PathMessage(1, Status.OK, Origin.FULL, path)
    sink = StdioSink(descriptor=outgoing.write.fileno())
    writer = threading.Thread(target=sink.publish, args=(message,))
    writer.start()
    assert len(json.loads(outgoing.read.readline())["path"]) == 20_000
    writer.join(5.0)
