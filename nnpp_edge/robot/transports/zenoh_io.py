"""Messages over Zenoh. By default only programs on this machine are heard.

Below the prefix, ``patch``, ``pose`` and ``goal`` are listened to; ``path``, ``status`` and
``error`` are sent.
"""

import json
import threading
from functools import partial
from typing import TYPE_CHECKING

from nnpp_edge.robot.transports.incoming import MailboxSource, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, encode
from nnpp_edge.robot.transports.wiring import Setup
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module
from nnpp_edge.runtime.loop.messages import Output, PathMessage
from nnpp_edge.runtime.loop.workers import CountError
from nnpp_edge.runtime.reading import refused_as

if TYPE_CHECKING:
    import zenoh

LOOPBACK = "tcp/127.0.0.1:7448"
"""Not Zenoh's own port, 7447: there ROS' router listens, rmw_zenohd."""
PREFIX = "nnpp_edge"
"""The first part of all topics."""
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

    InvalidQueryError where the session cannot be opened, MissingExtraError without Zenoh.
    """

    def __init__(self, endpoint: str = LOOPBACK, *, connect: str | None = None) -> None:
        self.zenoh = optional_module("zenoh", "a Zenoh session", "robot")
        place = "connect/endpoints" if connect else "listen/endpoints"
        values = _CONFIGURATION | {"listen/endpoints": []} | {place: [connect or endpoint]}
        config = self.zenoh.Config()
        where = f"go to {connect!r}" if connect else f"listen at {endpoint!r}"
        with refused_as(InvalidQueryError, f"Zenoh could not {where}"):
            for key, value in values.items():
                config.insert_json5(key, json.dumps(value))
            self.session = self.zenoh.open(config)

    @classmethod
    def open(cls, place: str, setup: Setup) -> "ZenohLink":
        """The session that both directions share; either may name its endpoint."""
        wiring = setup.wiring
        sent = {entry.name: endpoint for entry, endpoint in wiring.sinks}.get("zenoh")
        endpoint = place or sent or LOOPBACK
        return cls(endpoint, connect=wiring.zenoh_connect)

    def close(self) -> None:
        """End the session, within a second."""
        name = "nnpp-edge zenoh close"
        thread = threading.Thread(target=self.session.close, name=name, daemon=True)
        thread.start()
        thread.join(_PATIENCE_S)


class ZenohSource(MailboxSource):
    """Inputs from Zenoh's topics. If patches come faster than the loop reads them, the oldest are
    dropped.

    Each is counted as ``input dropped``; messages that are refused are added to `refusals`. Zenoh's
    own thread decodes them, and receives no more meanwhile: they do not pile up, their senders
    wait.
    """

    def __init__(self, link: ZenohLink, count_error: CountError) -> None:
        super().__init__(count_error)
        self.link = link
        self._subscribers = []
        for topic in ("patch", "pose", "goal"):
            handler = link.zenoh.handlers.Callback(partial(self._hear, topic), indirect=False)
            subscriber = link.session.declare_subscriber(f"{PREFIX}/{topic}", handler)
            self._subscribers.append(subscriber)

    @classmethod
    def open(cls, place: str, setup: Setup) -> "ZenohSource":
        return cls(ZenohLink.open(place, setup), setup.navigator.count_error)

    def close(self) -> None:
        """End the session."""
        self.link.close()

    def _hear(self, topic: str, sample: "zenoh.Sample") -> None:
        with self._reading():
            for _ in range(self._take(sample.payload.to_bytes(), "drop oldest", topic)):
                self.refusals.count_error("input dropped")


class ZenohSink:
    """Sends answers to Zenoh's topics, refusals that wait first; Zenoh drops what listeners are too
    slow for.
    """

    name = "zenoh"

    def __init__(self, link: ZenohLink, refusals: Refusals | None = None) -> None:
        self._link = link
        self._refusals = refusals
        self._publishers = {
            topic: link.session.declare_publisher(
                f"{PREFIX}/{topic}",
                encoding=link.zenoh.Encoding.APPLICATION_JSON,
                congestion_control=link.zenoh.CongestionControl.DROP,
            )
            for topic in ("path", "status", "error")
        }

    @classmethod
    def open(cls, place: str, setup: Setup) -> "ZenohSink":
        source = setup.source
        if isinstance(source, ZenohSource):
            return cls(source.link, source.refusals)
        return cls(ZenohLink.open(place, setup))

    def publish(self, message: Output) -> None:
        """Send what waits and the answer."""
        for fault in self._refusals.waiting() if self._refusals else []:
            self._publishers["error"].put(encode(fault))
        topic = "path" if isinstance(message, PathMessage) else "status"
        self._publishers[topic].put(encode(message))

    def close(self) -> None:
        """End the session."""
        self._link.close()
