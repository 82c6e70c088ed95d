"""A call that is worked at in slices of time, with pauses between them in which the map may change.

Its searches stop where a slice ends, in the middle of what they do, and go on there in the next
one. So no code on the way to them has to know of it. What a search finds on a map that changes
meanwhile is to be checked on the newest.
"""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar, cast

from greenlet import getcurrent, greenlet

from nnpp_edge.runtime.deadline import NEVER, Deadline

R = TypeVar("R")


class InSlices(Deadline, Generic[R]):
    """A call, which is given this as its deadline: it never passes, but searches pause by it.

    It is worked at by the thread that made it, and `stop` is to be called unless it has ended.
    """

    def __init__(self, call: Callable[[Deadline], R]) -> None:
        super().__init__()
        self._slice = NEVER
        self._greenlet = greenlet(call)
        self._thread = threading.get_ident()

    @property
    def is_here(self) -> bool:
        """Whether this thread began it: no other can go on with it."""
        return self._thread == threading.get_ident()

    def work(self, until: Deadline) -> R | None:
        """Go on until then: what the call returns, or None while it has not ended."""
        self._slice = until
        self._greenlet.parent = getcurrent()
        return cast(R | None, self._greenlet.switch(self))

    def stop(self) -> None:
        """Let go of the call; what it had to tidy up is done, by its thread."""
        if self.is_here:
            self._greenlet.throw()

    @property
    def until(self) -> float:
        """When the slice ends."""
        return self._slice.at

    def goes_on(self) -> bool:
        """True, after a pause if the slice is over."""
        if self._slice.passed:
            assert self._greenlet.parent is not None
            self._greenlet.parent.switch(None)
        return True
