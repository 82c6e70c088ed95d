import logging
import os
import secrets
import socket
from contextlib import ExitStack, closing, suppress

import pytest

from nnpp_edge.robot.operations.systemd import Notifier
from nnpp_edge.runtime import Counters, Status, StatusMessage


class Clock:
    now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture
def manager(tmp_path):
    """Sockets as systemd's by their names, a path and an abstract one."""
    with ExitStack() as stack:
        found = {}
        for name in (str(tmp_path / "notify"), f"@nnpp-edge-{secrets.token_hex(8)}"):
            found[name] = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            found[name].bind("\0" + name[1:] if name[0] == "@" else name)
        yield found


@pytest.fixture
def notify():
    """Make notifiers; their sockets are closed at the end."""
    with ExitStack() as stack:
        yield lambda *words, **options: stack.enter_context(closing(Notifier(*words, **options)))


def status(text):
    return StatusMessage(1, Status.OK, text, Counters())


def waiting(receiver):
    """All that was sent."""
    receiver.setblocking(False)
    words = []
    with suppress(BlockingIOError):
        while True:
            words.append(receiver.recv(4096).decode())
    return words


def test_the_manager_hears_each_word(manager, monkeypatch, notify):
    for name, receiver in manager.items():
        notifier = notify({"NOTIFY_SOCKET": name})
        assert notifier.ready() and notifier.stopping()
        assert not notifier.alive(), "nobody asked for a watchdog"
        notifier.close()
        assert not notifier.ready()
        assert waiting(receiver) == ["READY=1", "STOPPING=1"]
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    assert notify().ready(), "the environment is where it looks by default"
    assert waiting(receiver) == ["READY=1"]


def test_the_watchdog_hears_at_most_twice_in_its_time_if_it_is_ours(manager, notify):
    name, receiver = next(iter(manager.items()))
    clock = Clock()
    own = {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}
    notifier = notify({"NOTIFY_SOCKET": name, **own}, clock=clock)
    assert notifier.watchdog_s == 2.0
    sent = []
    for tick in range(50):
        clock.now = 50.0 + 0.1 * tick
        if notifier.alive():
            sent.append(tick)
    assert sent == [0, 10, 20, 30, 40]
    assert waiting(receiver) == ["WATCHDOG=1"] * 5
    unusable = ({"WATCHDOG_USEC": word} for word in ("0", "-5", "soon"))
    for other in (
        {**own, "WATCHDOG_PID": str(os.getpid() + 1)},
        {**own, "WATCHDOG_PID": "me"},
        {},
        *unusable,
    ):
        notifier = notify({"NOTIFY_SOCKET": name, **other})
        assert notifier.watchdog_s is None
        assert not notifier.alive()
        assert notifier.ready()
        assert waiting(receiver) == ["READY=1"]


def test_a_status_is_one_line(manager, notify):
    name, receiver = next(iter(manager.items()))
    lines = {
        "two\nlines\tand \x00\x1b[31m more": "two lines and [31m more",
        "READY=1\nSTOPPING=1": "READY=1 STOPPING=1",
        "größer als 2 %": "größer als 2 %",
        "x" * 5000: "x" * 200,
        "a\u2028b\ud800c": "a b c",
        "": "",
    }
    for text, line in lines.items():
        notify({"NOTIFY_SOCKET": name}).publish(status(text))
        assert waiting(receiver) == ["STATUS=" + line]


def test_without_a_manager_nothing_happens(notify):
    for name in ("", "notify", "@", "vsock:2:1234"):
        notifier = notify({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1000"})
        assert notifier.watchdog_s is None
        assert not (notifier.ready() or notifier.alive() or notifier.stopping())


def test_a_manager_that_went_away_or_does_not_read_is_warned_of_once(tmp_path, caplog, notify):
    notifier = notify({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    with caplog.at_level(logging.WARNING):
        assert not notifier.ready()
        notifier.publish(status("x"))
    assert len(caplog.records) == 1
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "full"))
        notifier = notify({"NOTIFY_SOCKET": str(tmp_path / "full")})
        answers = [notifier.ready() for _ in range(5000)]  # never waits for the reader
    assert answers[0] and not answers[-1]
