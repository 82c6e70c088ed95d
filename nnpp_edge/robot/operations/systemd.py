"""Notifications to systemd (sd_notify): ready, alive, status, stopping. By the standard library
alone.
"""

import logging
import math
import os
import socket
import time

from nnpp_edge.runtime.loop.messages import Output, StatusMessage

_LOG = logging.getLogger(__name__)
_LONGEST_STATUS = 200


class Notifier:
    """Notifies the service manager, to which it is a sink; without one, every call does nothing.

    No call raises or waits: a notification that cannot be sent is dropped, with a warning the first
    time.

    Of the environment it reads ``NOTIFY_SOCKET`` (a path, or ``@`` and an abstract name),
    ``WATCHDOG_USEC`` and ``WATCHDOG_PID``.
    """

    name = "systemd"

    def __init__(self) -> None:
        self._last = -math.inf
        self._warned = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        name = os.environ.get("NOTIFY_SOCKET", "")
        usable = len(name) > 1 and name[0] in "/@"
        self._address = os.fsencode(name) if usable else b""
        if name.startswith("@"):  # an abstract name
            self._address = self._address.replace(b"@", b"\0", 1)
        self.watchdog_s = _watchdog_s() if usable else None
        """Seconds without `alive` after which the manager acts; None if it does not watch this
        process.
        """

    def ready(self) -> None:
        """The loop is about to start."""
        self._send("READY=1")

    def alive(self) -> None:
        """The planning loop has ended a tick: sent at most every half of the watchdog's time."""
        now = time.monotonic()
        if self.watchdog_s is not None and now - self._last >= 0.5 * self.watchdog_s:
            self._last = now
            self._send("WATCHDOG=1")

    def publish(self, message: Output) -> None:
        """Of a status message a line of at most 200 characters for ``systemctl status``."""
        if isinstance(message, StatusMessage):
            line = " ".join(message.text.split())
            self._send("STATUS=" + line[:_LONGEST_STATUS])

    def stopping(self) -> None:
        """The process is about to end."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket: nothing more is sent."""
        self._address = b""
        self._socket.close()

    def _send(self, text: str) -> None:
        if not self._address:
            return
        try:
            self._socket.sendto(text.encode(errors="replace"), self._address)
        except OSError as error:
            if not self._warned:
                _LOG.warning("the service manager cannot be notified: %s", error.strerror or error)
            self._warned = True


def _watchdog_s() -> float | None:
    """The watchdog's time; None if there is no watchdog, or it watches another process."""
    own = str(os.getpid())
    microseconds = os.environ.get("WATCHDOG_USEC", "")
    if (os.environ.get("WATCHDOG_PID") or own) != own or not microseconds.isdecimal():
        return None
    return 1e-6 * int(microseconds) or None
