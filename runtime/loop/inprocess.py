"""An input source and a sink for Python programs and tests."""

import sys
from collections import deque
from collections.abc import Iterator

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.loop.mailbox import Mailbox
from nnpp_edge.runtime.loop.messages import Input, InvalidMessageError, Output, PathMessage


class InProcessSource:
    """Inputs put by any thread, in a `Mailbox` of at most so many patches."""

    @checked(InvalidMessageError)
    def __init__(self, most_patches: int = 256) -> None:
        self._mailbox = Mailbox(most_patches, sys.maxsize)

    @property
    def refused(self) -> int:
        """Patches that were refused."""
        return self._mailbox.drops

    @checked(InvalidMessageError)
    def put(self, message: Input) -> bool:
        """Add an input; False if it is a patch and too many are waiting, so that the sender knows.

        InvalidMessageError for anything else than an input.
        """
        return not self._mailbox.put(message, when_full="refuse")

    def poll(self) -> Iterator[Input]:
        """Inputs since the last call."""
        return self._mailbox.read()


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
