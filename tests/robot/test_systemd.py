import logging
import os
import secrets
import socket
from contextlib import ExitStack

import pytest

from nnpp_edge.robot.operations.systemd import Notifier


class Clock:
    now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A socket as systemd's, and its name."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@nnpp-edge-{secrets.token_hex(8)}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind("\0" + name[1:] if name[0] == "@" else name)
        receiver.settimeout(2.0)
        yield receiver, name


@pytest.fixture
def notify():
    """Make notifiers; their sockets are closed at the end."""
    with ExitStack() as stack:
        yield lambda *words, **options: stack.enter_context(Notifier(*words, **options))


def waiting(receiver):
    """All that was sent."""
    receiver.setblocking(False)
    words = []
    try:
        while True:
            words.append(receiver.recv(4096).decode())
    except BlockingIOError:
        return words


def test_the_manager_hears_each_word(manager, notify):
    receiver, name = manager
    notifier = notify({"NOTIFY_SOCKET": name})
    assert notifier.enabled
    assert notifier.ready() and notifier.status("3 ticks") and notifier.stopping()
    assert not notifier.alive(), "nobody asked for a watchdog"
    notifier.close()
    assert notifier.ready()
    assert waiting(receiver) == ["READY=1", "STATUS=3 ticks", "STOPPING=1", "READY=1"]


def test_the_watchdog_hears_at_most_twice_in_its_time(manager, notify):
    receiver, name = manager
    clock = Clock()
    environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}
    notifier = notify(environment, clock=clock)
    assert notifier.watchdog_s == 2.0
    sent = []
    for tick in range(50):
        clock.now = 50.0 + 0.1 * tick
        if notifier.alive():
            sent.append(tick)
    assert sent == [0, 10, 20, 30, 40]
    assert waiting(receiver) == ["WATCHDOG=1"] * 5


def test_a_watchdog_that_is_not_ours_hears_nothing(manager, notify):
    receiver, name = manager
    others = {"WATCHDOG_PID": str(os.getpid() + 1), "WATCHDOG_USEC": "2000000"}
    unusable = {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "me"}
    for environment in (others, unusable, {}, *({"WATCHDOG_USEC": word} for word in ("0", "-5", "soon"))):
        notifier = notify({"NOTIFY_SOCKET": name, **environment})
        assert notifier.watchdog_s is None
        assert not notifier.alive()
        assert notifier.ready()
        assert waiting(receiver) == ["READY=1"]


def test_a_status_is_one_line(manager, notify):
    receiver, name = manager
    lines = {
        "two\nlines\tand \x00\x1b[31m more": "two lines and [31m more",
        "READY=1\nSTOPPING=1": "READY=1 STOPPING=1",
        "größer als 2 %": "größer als 2 %",
        "x" * 5000: "x" * 200,
        "a\u2028b\ud800c": "a b c",
        "": "",
    }
    for text, line in lines.items():
        assert notify({"NOTIFY_SOCKET": name}).status(text)
        assert waiting(receiver) == ["STATUS=" + line]


@pytest.mark.parametrize("name", ["", "notify", "@", "vsock:2:1234"])
def test_without_a_manager_nothing_happens(name, notify):
    notifier = notify({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1000"})
    assert not notifier.enabled
    assert notifier.watchdog_s is None
    assert not (notifier.ready() or notifier.alive() or notifier.status("x") or notifier.stopping())


def test_a_manager_that_went_away_or_does_not_read_is_warned_of_once(tmp_path, caplog, notify):
    notifier = notify({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    with caplog.at_level(logging.WARNING):
        assert not notifier.ready()
        assert not notifier.status("x")
    assert len(caplog.records) == 1
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "full"))
        notifier = notify({"NOTIFY_SOCKET": str(tmp_path / "full")})
        answers = [notifier.status("x" * 200) for _ in range(5000)]  # never waits for the reader
    assert answers[0] and not answers[-1]


def test_the_environment_is_where_it_looks_by_default(manager, monkeypatch, notify):
    receiver, name = manager
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    assert notify().ready()
    assert waiting(receiver) == ["READY=1"]
