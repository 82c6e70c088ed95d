"""Messages over Zenoh. By default only programs on this machine are heard.

Below the prefix, ``patch``, ``pose`` and ``goal`` are listened to; ``path``, ``status`` and ``error`` are sent.
"""

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from nnpp_edge.robot.transports.mailbox import Mailbox, Refusals
from nnpp_edge.robot.transports.wire import LIMIT_BYTES, Fault, WireError, encode, input_of, parse
from nnpp_edge.runtime.errors import InvalidQueryError, MissingExtraError
from nnpp_edge.runtime.loop.messages import Input, Output, PathMessage

LOOPBACK = "tcp/127.0.0.1:7447"
PREFIX = "nnpp_edge"
TOPICS = ("patch", "pose", "goal")
_MOST_FAULTS = 64
_PATIENCE_S = 1.0


class ZenohLink:
    """A session. It looks for nobody: it waits at one address, or goes to one.

    Parameters
    ----------
    endpoint : str
        Where to listen, as Zenoh writes it: ``tcp/ADDRESS:PORT``. By default the loopback interface.
    connect : str
        Go to this router or peer instead of listening. It is tried again until it answers.
    prefix : str
        First part of all topics.

    Raises
    ------
    MissingExtraError
        Zenoh is not installed.
    InvalidQueryError
        The session cannot be opened, or the prefix makes no topic.
    """

    def __init__(self, endpoint: str = LOOPBACK, *, connect: str | None = None, prefix: str = PREFIX) -> None:
        try:
            import zenoh
        except ModuleNotFoundError as error:
            raise MissingExtraError("Zenoh is not installed: pip install 'nnpp-edge[robot]'") from error
        if not prefix or prefix != prefix.strip("/") or any(c in prefix for c in "*$?# ") or "//" in prefix:
            raise InvalidQueryError(f"the prefix must be words joined by /, got {prefix!r}")
        self.zenoh, self.prefix = zenoh, prefix
        config = zenoh.Config()
        listen, other = ([], [connect]) if connect else ([endpoint], [])
        try:
            for key, value in (
                ("mode", "peer"),
                ("listen/endpoints", listen),
                ("connect/endpoints", other),
                ("scouting/multicast/enabled", False),
                ("scouting/gossip/enabled", False),
            ):
                config.insert_json5(key, json.dumps(value))
            self.session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            reason = " ".join(str(error).split())[:200]
            where = f"go to {connect!r}" if connect else f"listen at {endpoint!r}"
            raise InvalidQueryError(f"Zenoh could not {where} ({reason})") from error

    def close(self) -> None:
        """End the session, within a second."""
        thread = threading.Thread(target=self.session.close, name="nnpp-edge zenoh close", daemon=True)
        thread.start()
        thread.join(_PATIENCE_S)


class ZenohSource:
    """Inputs from Zenoh's topics. Patches that come faster than the loop takes them push out the oldest.

    Parameters
    ----------
    link : ZenohLink
        The session.
    refusals : Refusals
        Told of each message that makes no sense.
    count_error : callable
        Told ``input dropped`` for each patch that was pushed out.
    limit : int
        Bytes of a message.
    mailbox : Mailbox
        What waits at most.
    """

    ended = False

    def __init__(
        self, link: ZenohLink, refusals: Refusals, count_error: Callable[[str], None], *,
        limit: int = LIMIT_BYTES, mailbox: Mailbox | None = None,
    ) -> None:  # fmt: skip
        self._refusals, self._count_error, self._limit = refusals, count_error, limit
        self._mailbox = mailbox or Mailbox()
        self._subscribers = [
            link.session.declare_subscriber(f"{link.prefix}/{topic}", self._listener(topic)) for topic in TOPICS
        ]

    def poll(self) -> Iterator[Input]:
        """What has come since the last call."""
        return self._mailbox.take()

    def _listener(self, topic: str) -> Callable[[Any], None]:
        def heard(sample: Any) -> None:
            try:
                message = self._decoded(topic, sample.payload)
            except WireError as error:
                self._refusals.add(error)
                return
            for _ in range(self._mailbox.put(message, wait=False)):
                self._count_error("input dropped")

        return heard

    def _decoded(self, topic: str, payload: Any) -> Input:
        if len(payload) > self._limit:
            raise WireError(f"{topic}: wanted a message of at most {self._limit} bytes, got {len(payload)}")
        told = parse(payload.to_bytes(), self._limit)
        if told.setdefault("type", topic) != topic:
            raise WireError(f"type: wanted {topic!r}, as the topic is, got {str(told['type'])[:40]!r}")
        return input_of(told)


class ZenohSink:
    """Sends each answer to Zenoh's topics. Messages for listeners that do not keep up are dropped by Zenoh.

    Parameters
    ----------
    link : ZenohLink
        The session.
    """

    name = "zenoh"

    def __init__(self, link: ZenohLink) -> None:
        drop = link.zenoh.CongestionControl.DROP
        self._publishers = {
            topic: link.session.declare_publisher(
                f"{link.prefix}/{topic}", encoding=link.zenoh.Encoding.APPLICATION_JSON, congestion_control=drop
            )
            for topic in ("path", "status", "error")
        }
        self._faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)

    def answer(self, fault: Fault) -> None:
        """Send a fault with the next answer; does not wait. Of many the newest are kept: `Fault.count` tells."""
        self._faults.append(fault)

    def publish(self, message: Output) -> None:
        """Send the faults that wait, and the answer."""
        while self._faults:
            self._publishers["error"].put(encode(self._faults.popleft()))
        topic = "path" if isinstance(message, PathMessage) else "status"
        self._publishers[topic].put(encode(message))
