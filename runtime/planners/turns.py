"""One call at a time: what a planner keeps is neither written by two threads at once nor left half written."""

import functools
from collections.abc import Callable
from threading import get_ident
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from nnpp_edge.runtime.errors import ConcurrentUseError, NnppEdgeError

P = ParamSpec("P")
R = TypeVar("R")


class Turns(dict[str, tuple[int]]):
    """The thread that is at work in a planner, and whether a call was broken off.

    A call that ends with an error of ours has changed nothing or finished what it changed. Any other exception, such
    as a KeyboardInterrupt, may have come between two steps that belong together.
    """

    broken_off = False
    """Whether what the planner keeps may be half written."""

    def not_first(self, mine: tuple[int]) -> None:
        """Somebody is at work: refuse another thread. This one was broken off before it could say so."""
        if self.get("thread", mine) != mine:
            raise ConcurrentUseError(
                "wanted one call at a time, got one while another thread's is at work: give each thread a planner of "
                "its own (and make a planner anew whose call was broken off in another thread)"
            )
        self.broken_off = True


class TakesTurns(Protocol):
    """A planner."""

    @property
    def _turns(self) -> Turns: ...

    def _begin_anew(self) -> None:
        """Make anew from the map's weights all that may be half written."""


S = TypeVar("S", bound=TakesTurns)


def one_at_a_time(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """A planner's method that is refused while a call of another thread is at work.

    After a call that was broken off the planner begins anew first. Such methods must not call one another.
    """

    @functools.wraps(method)
    def guarded(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        turns, mine = self._turns, (get_ident(),)
        if turns.setdefault("thread", mine) is not mine:  # one step, which nothing can come between
            turns.not_first(mine)
        try:
            if turns.broken_off:
                self._begin_anew()
                turns.broken_off = False
            return method(self, *args, **kwargs)
        except NnppEdgeError:
            raise
        except BaseException:
            turns.broken_off = True
            raise
        finally:
            turns.clear()

    return guarded
