"""Latencies in fixed memory."""

import math
from collections.abc import Iterable

import numpy as np

_PER_OCTAVE = 16
_LEAST_S = 1e-6
_OCTAVES = 27
"""From 1 µs to 134 s."""


class Histogram:
    """Counts of durations in buckets that widen by 4.4 %: quantiles are that accurate, and memory stays 3.5 kB."""

    def __init__(self) -> None:
        self._counts = np.zeros(_PER_OCTAVE * _OCTAVES, np.int64)
        self.count = 0
        self.max_s = 0.0
        self.sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration; one below 1 µs counts as 1 µs."""
        self._counts[self._bucket(seconds)] += 1
        self.count += 1
        self.sum_s += seconds
        self.max_s = max(self.max_s, seconds)

    def quantile(self, share: float) -> float:
        """Seconds that this share (0 to 1) of the durations does not exceed, to 4.4 %; 0 if there are none."""
        if not self.count:
            return 0.0
        at = int(np.searchsorted(np.cumsum(self._counts), max(math.ceil(share * self.count), 1)))
        bound: float = _LEAST_S * 2.0 ** ((at + 1) / _PER_OCTAVE)
        return min(bound, self.max_s)

    def shorter(self, octaves: Iterable[int]) -> list[int]:
        """Exact number of durations below 1 µs × 2^n, for each of these n; last, the number of all."""
        counts = self._counts.copy()  # of one moment, also when another thread adds
        return [*(int(counts[: _PER_OCTAVE * n].sum()) for n in octaves), int(counts.sum())]

    @property
    def mean_s(self) -> float:
        """Seconds; 0 if there are none."""
        return self.sum_s / self.count if self.count else 0.0

    def summary_ms(self) -> dict[str, float]:
        """``p50``, ``p90``, ``p99``, ``max`` and ``mean`` in milliseconds."""
        seconds = {f"p{q}": self.quantile(q / 100.0) for q in (50, 90, 99)} | {"max": self.max_s, "mean": self.mean_s}
        return {name: 1e3 * value for name, value in seconds.items()}

    @staticmethod
    def _bucket(seconds: float) -> int:
        if not seconds > _LEAST_S:
            return 0
        return min(int(_PER_OCTAVE * math.log2(seconds / _LEAST_S)), _PER_OCTAVE * _OCTAVES - 1)
