"""Latencies in fixed memory."""

import math
from collections.abc import Iterable

import numpy as np

_PER_OCTAVE = 16
_LEAST_S = 1e-6
_OCTAVES = 27
"""From 1 µs to 134 s."""


class Histogram:
    """Counts of durations in buckets that widen by 4.4 %: quantiles are right to that, in 3.5 kB for ever."""

    def __init__(self) -> None:
        self._counts = np.zeros(_PER_OCTAVE * _OCTAVES, np.int64)
        self.count = 0
        self.max_s = 0.0
        self.sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Book a duration; below 1 µs it counts as that."""
        self._counts[self._bucket(seconds)] += 1
        self.count += 1
        self.sum_s += seconds
        self.max_s = max(self.max_s, seconds)

    def quantile(self, share: float) -> float:
        """Seconds that this share of the durations does not exceed, to 4.4 %; 0 without any."""
        if not self.count:
            return 0.0
        at = int(np.searchsorted(np.cumsum(self._counts), max(math.ceil(share * self.count), 1)))
        return min(_LEAST_S * 2.0 ** ((at + 1) / _PER_OCTAVE), self.max_s)

    def shorter(self, octaves: Iterable[int]) -> list[int]:
        """How many durations were shorter than 1 µs × 2^n, exactly, for each of these n; last, how many in all."""
        counts = self._counts.copy()  # of one moment, whichever thread asks
        return [*(int(counts[: _PER_OCTAVE * n].sum()) for n in octaves), int(counts.sum())]

    @property
    def mean_s(self) -> float:
        """Seconds; 0 without any."""
        return self.sum_s / self.count if self.count else 0.0

    def summary_ms(self) -> dict[str, float]:
        """``p50``, ``p90``, ``p99``, ``max`` and ``mean`` in milliseconds."""
        told = {f"p{q}": self.quantile(q / 100.0) for q in (50, 90, 99)}
        return {name: 1e3 * s for name, s in (told | {"max": self.max_s, "mean": self.mean_s}).items()}

    @staticmethod
    def _bucket(seconds: float) -> int:
        if not seconds > _LEAST_S:
            return 0
        return min(int(_PER_OCTAVE * math.log2(seconds / _LEAST_S)), _PER_OCTAVE * _OCTAVES - 1)
