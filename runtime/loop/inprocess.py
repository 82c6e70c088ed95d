"""An input source and a sink for Python programs and tests."""

import threading
from collections import deque
from collections.abc import Iterable

from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, Output, PathMessage, Pose


class InProcessSource:
    """Inputs put by any thread. Of poses and goals the newest counts; patches keep their order.

    Parameters
    ----------
    most_patches : int
        Most patches that wait; `put` refuses the next, so that the sender knows.
    """

    def __init__(self, most_patches: int = 256) -> None:
        self._lock = threading.Lock()
        self._patches: deque[MapPatch] = deque()
        self._most = most_patches
        self._pose: Pose | None = None
        self._goal: Goal | None = None
        self.refused = 0
        """Patches that were refused."""

    def put(self, message: Input) -> bool:
        """Add an input; False if it is a patch and too many are waiting."""
        with self._lock:
            if isinstance(message, Pose):
                self._pose = message
            elif isinstance(message, Goal):
                self._goal = message
            elif len(self._patches) >= self._most:
                self.refused += 1
                return False
            else:
                self._patches.append(message)
            return True

    def poll(self) -> Iterable[Input]:
        """What has come since the last call."""
        with self._lock:
            inputs: list[Input] = [*self._patches]
            inputs += [message for message in (self._pose, self._goal) if message is not None]
            self._patches.clear()
            self._pose = self._goal = None
        return inputs


class InProcessSink:
    """Keeps the newest messages."""

    name = "in-process"

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
