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


class _Slices(Deadline):
    """The deadline of a call in slices: it never passes, but searches pause by it."""

    slice = NEVER

    def begin(self, slice: Deadline) -> None:
        """Work until then."""
        self.slice = slice
        self.until = slice.at

    def goes_on(self) -> bool:
        """True, after a pause if the slice is over."""
        if self.slice.passed:
            parent = getcurrent().parent
            assert parent is not None
            parent.switch(None)
        return True


class InSlices(Generic[R]):
    """A call, which is given a deadline that makes it pause, and works in one thread alone.

    Where this is dropped before the call has ended, the call lets go of all that it holds, once
    what it had to tidy up is done. So the call must not refer to what holds this.
    """

    def __init__(self, call: Callable[[Deadline], R]) -> None:
        self._slices = _Slices()
        self._greenlet = greenlet(call)
        self._thread = threading.get_ident()
        self._result: R | None = None

    @property
    def is_here(self) -> bool:
        """Whether this thread began it: no other can go on with it."""
        return self._thread == threading.get_ident()

    @property
    def ended(self) -> bool:
        """Whether the call has returned."""
        return self._result is not None

    def work(self, until: Deadline) -> R | None:
        """Go on until then: what the call returns, or None while it has not ended."""
        if self._result is None:
            self._slices.begin(until)
            self._greenlet.parent = getcurrent()
            self._result = cast(R | None, self._greenlet.switch(self._slices))
        return self._result

    def __del__(self) -> None:
        if self.is_here:
            self._greenlet.throw()
