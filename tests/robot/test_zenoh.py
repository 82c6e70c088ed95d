"""Zenoh: another session sends and listens; garbage, floods and listeners that sleep change nothing
for the loop.
"""

import json
import re
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("zenoh")

from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.robot.transports.zenoh_io import LOOPBACK, ZenohLink, ZenohSink, ZenohSource
from nnpp_edge.runtime import Goal, Ground, Loop, MapPatch, Navigator, Pose
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.connections import InProcessSource, Mailbox
from nnpp_edge.runtime.memory import rss_bytes
from tests.robot.conftest import free, wait_until

ROOT = Path(__file__).parents[2]


def free_endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def link():
    """A session that another one can reach."""
    with closing(ZenohLink(endpoint := free_endpoint())) as link:
        link.endpoint = endpoint
        yield link


class Peer:
    """Another session: `send` has it publish, `heard` is what it received."""

    def __init__(self, endpoint):
        self.heard = []
        self._link = ZenohLink(connect=endpoint)
        self._link.session.declare_subscriber("nnpp_edge/**", self._hear)
        self.close = self._link.close

    def _hear(self, sample):
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes()))

    def send(self, topic, payload):
        block = self._link.zenoh.CongestionControl.BLOCK
        self._link.session.put(f"nnpp_edge/{topic}", payload, congestion_control=block)

    def of(self, topic):
        return [json.loads(text) for key, text in self.heard if key == f"nnpp_edge/{topic}"]


@pytest.fixture
def peer(link):
    """Connected to the session."""
    with closing(Peer(link.endpoint)) as peer:
        yield peer


@pytest.fixture
def listening(link, navigator, peer, make_mailbox):
    """A source with a mailbox of this kind that the other session has found."""

    def start(mailbox):
        make_mailbox(mailbox)
        source = ZenohSource(link, navigator.count_error)

        def known():
            peer.send("goal", encode(Goal(0, 0)))
            return source.ended or list(source.poll())

        wait_until(known)
        return source

    return start


def test_a_path_goes_to_and_fro_between_two_sessions_and_what_makes_no_sense_is_answered(
    link,
    peer,
    navigator,
    drive,
    make_mailbox,
    monkeypatch,
):
    mailbox = Mailbox()
    make_mailbox(lambda: mailbox)
    monkeypatch.setattr(ZenohSource, "limit", 1000)
    ended = []
    source = ZenohSource(link, navigator.count_error)
    sink = ZenohSink(link, source.refusals)
    thread = threading.Thread(target=lambda: ended.append(drive(navigator, source, [sink])))
    bad = [
        ("pose", "garbage", "JSON is malformed"),
        ("pose", encode(Goal(1, 1)), "type: Invalid value 'goal'"),
        ("goal", '{"row":1.5,"col":2}', "whole number"),
        ("patch", '{"row":0,"col":0,"cost":[[-1]]}', "at least 0"),
        ("patch", "x" * 2000, "at most 1000 bytes, got 2000"),
    ]
    thread.start()
    try:
        wait_until(lambda: peer.of("path"))
        for topic, payload, _ in bad:
            peer.send(topic, payload)
        wait_until(lambda: len(peer.of("error")) == len(bad))
        peer.send("pose", '{"row":5,"col":5}')
        peer.send("goal", encode(Goal(35, 55)))
        wait_until(lambda: peer.of("path")[-1]["path"])
        peer.send("patch", encode(MapPatch(10, 0, cost=np.full((1, 59), np.inf))))
        wait_until(lambda: peer.of("path")[-1]["map_version"] == 1)
    finally:
        mailbox.close()
        thread.join(10.0)
    assert [col for row, col in peer.of("path")[-1]["path"] if row == 10] == [59]
    faults = peer.of("error")
    assert [fault["count"] for fault in faults] == [1, 2, 3, 4, 5]
    for _, _, words in bad:  # topics are heard in no certain order
        assert sum(words in fault["error"] for fault in faults) == 1
    assert ended[0].counters.errors == {"input": 5}
    assert ended[0].counters.drops == {"zenoh": 0, "in-process": 0}


def test_of_a_flood_the_newest_are_kept_and_the_rest_is_counted(peer, navigator, listening):
    source = listening(partial(Mailbox, 10))
    for n in range(1000):
        peer.send("patch", encode(MapPatch(0, 0, cost=np.full((1, 1), n))))
        if n == 500:
            peer.send("pose", encode(Pose(1, 1)))
    wait_until(lambda: navigator.counters().errors.get("input dropped", 0) == 990)
    first, *patches = (message for message in source.poll() if not isinstance(message, Goal))
    assert first == Pose(1, 1)  # nothing that waited held it up
    assert [float(m.cost[0, 0]) for m in patches] == list(range(990, 1000))


def test_large_messages_that_wait_do_not_pile_up(peer, listening):
    free = threading.Event()
    sent = []

    class Busy(Mailbox):
        def put(self, message, *, when_full):
            if isinstance(message, MapPatch):
                free.wait(30.0)
            return super().put(message, when_full=when_full)

    source = listening(Busy)
    patch = encode(MapPatch(0, 0, cost=np.zeros((1000, 1000))))
    before = rss_bytes()

    def send():
        for _ in range(40):
            sent.append(peer.send("patch", patch))

    sender = threading.Thread(target=send)
    sender.start()
    stood = -1
    while sender.is_alive() and stood < len(sent):  # until nothing more is taken
        stood = len(sent)
        sender.join(0.6)
    grown = rss_bytes() - before
    waits = sender.is_alive()
    free.set()
    sender.join(30.0)
    assert waits and not source.ended
    assert grown < 24 * len(patch)  # some of it in this test's own hands


def test_a_listener_that_runs_out_of_memory_is_a_failure(listening):
    class Full(Mailbox):
        def put(self, message, *, when_full):
            raise MemoryError

    assert listening(Full).failure.startswith("MemoryError")


def test_connections_that_say_nothing_keep_nobody_out(link, navigator):
    source = ZenohSource(link, navigator.count_error)
    host, port = link.endpoint.removeprefix("tcp/").split(":")
    taken = []

    def heard():
        peer.send("goal", encode(Goal(1, 1)))
        return taken.extend(source.poll()) or taken

    with ExitStack() as silent:
        for _ in range(300):
            silent.enter_context(socket.create_connection((host, int(port))))
        peer = silent.enter_context(closing(Peer(link.endpoint)))
        wait_until(heard, 6.0)


SLEEPER = """
import os, signal, sys
from nnpp_edge.robot.transports.zenoh_io import ZenohLink

link = ZenohLink(connect=sys.argv[1])
link.session.declare_subscriber("nnpp_edge/**", print)
print("listening", flush=True)
os.kill(os.getpid(), signal.SIGSTOP)
"""


def test_a_listener_that_sleeps_holds_nobody_up(link, navigator):
    navigator.offer(Pose(5, 5))
    navigator.offer(Goal(35, 55))
    sink = ZenohSink(link)
    loop = Loop(navigator, InProcessSource(), [sink], rate_hz=10.0, queue=10_000, paced=False)
    command = [sys.executable, "-c", SLEEPER, link.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as sleeper:
        assert sleeper.stdout.readline() == b"listening\n"
        counters = loop.run(1000)
        sleeper.kill()
    assert counters.ticks == 1000
    assert counters.tick_ms["max"] < 1000.0
    assert "sink zenoh" not in counters.errors


def test_a_session_that_cannot_be_opened_is_refused_in_one_line(link):
    with pytest.raises(InvalidQueryError, match="could not listen at 'tcp") as raised:
        ZenohLink(link.endpoint)
    assert "\n" not in str(raised.value)


def test_it_may_go_to_another_instead_of_listening(link, navigator):
    heard = []
    subscriber = link.session.declare_subscriber(
        "nnpp_edge/path",
        lambda s: heard.append(s.payload.to_bytes()),
    )
    with closing(ZenohLink(connect=link.endpoint)) as other:
        sink = ZenohSink(other)
        message = navigator.tick()
        wait_until(lambda: sink.publish(message) or heard)
    assert json.loads(heard[0])["outcome"] == "NO_POSE"
    subscriber.undeclare()


@pytest.mark.slow
def test_the_client_in_the_documentation_receives_a_path_as_it_stands():
    text = (ROOT / "docs/messages.md").read_text()
    client = re.search(r"```python\n(import json\n\nimport zenoh\n.*?)```", text, re.DOTALL)[1]
    endpoint = free_endpoint()
    assert LOOPBACK in client
    command = [sys.executable, "-c", client.replace(LOOPBACK, endpoint)]
    navigator = Navigator(Ground(free((80, 90))), "astar")
    with closing(ZenohLink(endpoint)) as link:
        source = ZenohSource(link, navigator.count_error)
        loop = Loop(navigator, source, [ZenohSink(link)], rate_hz=100.0)
        thread = threading.Thread(target=loop.run)
        thread.start()
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=10.0)
        finally:
            loop.stop()
            thread.join()
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "66 cells\n", "")
