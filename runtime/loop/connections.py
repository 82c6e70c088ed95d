"""Where inputs of the loop come from and where its answers go; both within one program."""

import sys
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Protocol, runtime_checkable

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.loop.messages import (
    Goal,
    Input,
    InvalidMessageError,
    MapPatch,
    Output,
    PathMessage,
    Pose,
)
from nnpp_edge.runtime.loop.workers import BoundedQueue, WhenFull


@runtime_checkable
class InputSource(Protocol):
    """Source of inputs."""

    def poll(self) -> Iterable[Input]:
        """Inputs since the last call; never waits. An iterable that is not read to its end is read
        on in the next.
        """


@runtime_checkable
class Sink(Protocol):
    """Receiver of answers. Each sink has its own thread and may be slow.

    A sink may have an attribute ``lost``: the number of messages that it took and could not keep.
    It is reported in `Counters.lost`.
    """

    name: str

    def publish(self, message: Output) -> None:
        """Send the message on. If it raises, that is counted, and the next message is tried."""


@runtime_checkable
class Recorder(Protocol):
    """Receiver of the inputs that the loop reads, such as a log. Each recorder has its own
    thread and may be slow.
    """

    def record(self, message: Input, at_s: float) -> None:
        """Take an input that was read so many seconds after the first tick began. If it raises,
        that is counted, and the next input is tried.
        """


class Transport(Protocol):
    """Connection of the loop to the outside, which `nnpp-edge run` opens and closes.

    A transport is an `InputSource` (then an `Incoming`), a `Sink`, a `Recorder`, or several of
    them. Those that `nnpp-edge run` knows are `TRANSPORTS` in `nnpp_edge.robot.transports`.
    """

    def close(self) -> None:
        """Write what waits, and give files and connections back. Called once, after the last
        tick.
        """


@runtime_checkable
class Incoming(InputSource, Transport, Protocol):
    """A source of inputs that can end or fail."""

    failure: str
    """Why nothing more can be read, in one line; empty while all is well."""

    @property
    def ended(self) -> bool:
        """Whether nothing waits and nothing more will come."""


class Mailbox:
    """Inputs that wait for the loop. Of poses and goals the newest is kept; patches keep their
    order. For any thread.

    At most so many patches wait; one counts once more for each `cells_as_one` cells.
    """

    def __init__(self, most: int = 256, cells_as_one: int = 1 << 16) -> None:
        self._newest: dict[type, Pose | Goal] = {}
        self._patches = BoundedQueue[MapPatch](
            most, lambda patch: 1 + patch.shape[0] * patch.shape[1] // cells_as_one
        )
        self.close = self._patches.close

    def put(self, message: Input, *, when_full: WhenFull) -> int:
        """Add a message. The number of patches dropped for it; 1 also where it was
        refused itself.
        """
        if isinstance(message, MapPatch):
            return self._patches.put(message, when_full)
        self._newest[type(message)] = message
        return 0

    def read(self) -> Iterator[Input]:
        """The waiting inputs, one by one; pose and goal first, so that patches cannot
        hold them up.
        """
        while (
            message := self._newest.pop(Pose, None)
            or self._newest.pop(Goal, None)
            or self._patches.take()
        ):
            yield message

    @property
    def drops(self) -> int:
        """Patches that were dropped or refused for lack of room."""
        return self._patches.drops

    @property
    def ended(self) -> bool:
        """Whether nothing waits, and nothing more will come."""
        return self._patches.closed and not self._patches and not self._newest


class InProcessSource:
    """Inputs put by any thread, in a `Mailbox` of at most so many patches."""

    @checked(InvalidMessageError)
    def __init__(self, most_patches: int = 256) -> None:
        self._mailbox = Mailbox(most_patches, sys.maxsize)
        self.poll = self._mailbox.read
        """Inputs since the last call."""

    @property
    def refused(self) -> int:
        """Patches that were refused."""
        return self._mailbox.drops

    @checked(InvalidMessageError)
    def put(self, message: Input) -> bool:
        """Add an input; False for a patch where too many wait. InvalidMessageError for what is no
        input.
        """
        return not self._mailbox.put(message, when_full="refuse")


class InProcessSink:
    """Keeps the newest messages."""

    name = "in-process"

    @checked(InvalidMessageError)
    def __init__(self, most: int = 1) -> None:
        self.messages: deque[Output] = deque(maxlen=most)
        """Newest last."""

    def publish(self, message: Output) -> None:
        """Keep it."""
        self.messages.append(message)

    @property
    def path(self) -> PathMessage | None:
        """The newest path message."""
        return next((m for m in reversed(self.messages) if isinstance(m, PathMessage)), None)
