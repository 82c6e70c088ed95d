"""Rivals timed side by side: warmed up, in turns whose order is drawn anew, by one clock."""

import gc
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")
Clock = Callable[[], float]
"""Seconds since any moment."""


@dataclass(frozen=True)
class Record(Generic[CaseT, ResultT]):
    """One rival's calls on one case, in the order in which they were made."""

    rival: str
    case: CaseT
    elapsed_s: tuple[float, ...]
    """Seconds of each call."""
    results: tuple[ResultT, ...]
    """The result of each call."""

    @property
    def median_s(self) -> float:
        """Median time of a call."""
        return float(np.median(self.elapsed_s))

    def quantile_s(self, share: float) -> float:
        """Time that this share of the calls stay below, such as 0.99; interpolated."""
        return float(np.quantile(self.elapsed_s, share))

    def middle(self) -> tuple[float, ResultT]:
        """Time and result of the call of middle time; of two calls the faster one."""
        ranked = sorted(range(len(self.elapsed_s)), key=self.elapsed_s.__getitem__)
        at = ranked[(len(ranked) - 1) // 2]
        return self.elapsed_s[at], self.results[at]


class Observer(Generic[ResultT]):
    """Notified before and after each timed call, outside the time that counts. Does nothing by itself."""

    def before(self, rival: str) -> None:
        """The rival's call follows."""

    def after(self, rival: str, elapsed_s: float, result: ResultT) -> None:
        """The call has ended."""


@dataclass
class Harness:
    """Times calls by a clock in seconds. Garbage is not collected meanwhile. `seed` draws the order of the turns."""

    seed: int = 0
    clock: Clock = time.perf_counter
    _rng: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Begin a sequence of orders."""
        self._rng = np.random.default_rng(self.seed)

    def timed(self, call: Callable[[], ResultT]) -> tuple[float, ResultT]:
        """Seconds that one call takes, and what it returns."""
        with _no_garbage_collection():
            began = self.clock()
            result = call()
            return self.clock() - began, result

    def measure(
        self,
        rivals: Mapping[str, Callable[[CaseT], ResultT]],
        cases: Iterable[CaseT],
        *,
        repeats: int = 1,
        once: Collection[str] = (),
        warm_up: Sequence[CaseT] = (),
        observer: Observer[ResultT] | None = None,
    ) -> Iterator[dict[str, Record[CaseT, ResultT]]]:
        """Let every rival, a function of a case, answer every case.

        Cases are taken one by one, when the records of the one before have been used. In each of `repeats` turns
        every rival is called once, in an order that is drawn anew; those in `once` take part in the first turn only.
        The cases of `warm_up` are answered before the clock starts.

        Yields
        ------
        dict of str to Record
            For each case the record of every rival, in the order of `rivals`.

        Notes
        -----
        What a rival raises ends the measurement: figures of the others would no longer be of the same cases.
        """
        observer = observer or Observer()
        for case in warm_up:
            for call in rivals.values():
                call(case)
        for case in cases:
            elapsed: dict[str, list[float]] = {name: [] for name in rivals}
            results: dict[str, list[ResultT]] = {name: [] for name in rivals}
            with _no_garbage_collection():
                for turn in range(repeats):
                    names = [name for name in rivals if turn == 0 or name not in once]
                    for at in self._rng.permutation(len(names)):
                        name, call = names[at], rivals[names[at]]
                        observer.before(name)
                        began = self.clock()
                        result = call(case)
                        seconds = self.clock() - began
                        observer.after(name, seconds, result)
                        elapsed[name].append(seconds)
                        results[name].append(result)
            yield {name: Record(name, case, tuple(elapsed[name]), tuple(results[name])) for name in rivals}


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    collected = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collected:
            gc.enable()
