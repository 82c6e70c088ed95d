"""Messages over Zenoh. By default only programs on this machine are heard.

Below the prefix, ``patch``, ``pose`` and ``goal`` are listened to; ``path``, ``status`` and
``error`` are sent.
"""

import json
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, encode
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.loop.connections import Mailbox
from nnpp_edge.runtime.loop.messages import Output, PathMessage
from nnpp_edge.runtime.reading import refused_as

if TYPE_CHECKING:
    import zenoh

LOOPBACK = "tcp/127.0.0.1:7447"
PREFIX = "nnpp_edge"
TOPICS = ("patch", "pose", "goal")
_PATIENCE_S = 1.0
_CONFIGURATION = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # connections that say nothing are closed soon, and keep nobody else out meanwhile
    "transport/unicast/accept_timeout": 1000,
    "transport/unicast/accept_pending": 500,
    "transport/unicast/max_sessions": 100,
    # what is longer is dropped by Zenoh: it would keep up to 1 GB for a message
    "transport/link/rx/max_message_size": LIMIT_BYTES + (1 << 16),
}


class ZenohLink:
    """A Zenoh session without discovery: it listens at `endpoint` (``tcp/ADDRESS:PORT``, by default
    the loopback interface), or connects to a router or peer, again and again until that succeeds.

    `prefix` is the first part of all topics. InvalidQueryError where the session cannot be opened,
    or the prefix makes no topic; MissingExtraError without Zenoh.
    """

    def __init__(
        self, endpoint: str = LOOPBACK, *, connect: str | None = None, prefix: str = PREFIX
    ) -> None:
        zenoh = optional_module("zenoh", "a Zenoh session", "robot")
        if (
            not prefix
            or prefix != prefix.strip("/")
            or any(c in prefix for c in "*$?# ")
            or "//" in prefix
        ):
            raise InvalidQueryError(f"the prefix must be words joined by /, got {prefix!r}")
        self.zenoh = zenoh
        self.prefix = prefix
        config = zenoh.Config()
        listen, other = ([], [connect]) if connect else ([endpoint], [])
        where = f"go to {connect!r}" if connect else f"listen at {endpoint!r}"
        with refused_as(InvalidQueryError, f"Zenoh could not {where}"):
            for key, value in (
                _CONFIGURATION | {"listen/endpoints": listen, "connect/endpoints": other}
            ).items():
                config.insert_json5(key, json.dumps(value))
            self.session = zenoh.open(config)

    def close(self) -> None:
        """End the session, within a second."""
        thread = threading.Thread(
            target=self.session.close, name="nnpp-edge zenoh close", daemon=True
        )
        thread.start()
        thread.join(_PATIENCE_S)


class ZenohSource(MailboxSource):
    """Inputs from Zenoh's topics. If patches come faster than the loop reads them, the oldest are
    dropped.

    `count_error` is called with ``input dropped`` for each; messages that are refused are added to
    `refusals`. Zenoh's own thread decodes them, and receives no more meanwhile: they do not pile
    up, their senders wait.
    """

    def __init__(
        self,
        link: ZenohLink,
        refusals: Refusals,
        count_error: Callable[[str], None],
        *,
        limit: int = LIMIT_BYTES,
        mailbox: Mailbox | None = None,
    ) -> None:
        super().__init__(refusals, limit, mailbox)
        self._count_error = count_error
        directly = partial(link.zenoh.handlers.Callback, indirect=False)
        self._subscribers = [
            link.session.declare_subscriber(
                f"{link.prefix}/{topic}", directly(self._listener(topic))
            )
            for topic in TOPICS
        ]

    def _listener(self, topic: str) -> Callable[["zenoh.Sample"], None]:
        def heard(sample: "zenoh.Sample") -> None:
            with self._reading():
                for _ in range(self._take(sample.payload.to_bytes(), "drop oldest", topic)):
                    self._count_error("input dropped")

        return heard


class ZenohSink:
    """Sends answers to Zenoh's topics, refusals that wait first; Zenoh drops what listeners are too
    slow for.
    """

    name = "zenoh"

    def __init__(self, link: ZenohLink, refusals: Refusals | None = None) -> None:
        self._refusals = refusals
        as_json = link.zenoh.Encoding.APPLICATION_JSON
        drop = link.zenoh.CongestionControl.DROP
        declared = partial(
            link.session.declare_publisher, encoding=as_json, congestion_control=drop
        )
        self._publishers = {
            topic: declared(f"{link.prefix}/{topic}") for topic in ("path", "status", "error")
        }

    def publish(self, message: Output) -> None:
        """Send what waits and the answer."""
        for fault in self._refusals.waiting() if self._refusals else []:
            self._publishers["error"].put(encode(fault))
        topic = "path" if isinstance(message, PathMessage) else "status"
        self._publishers[topic].put(encode(message))
