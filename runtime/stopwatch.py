"""How long each stage of a query takes."""

import time

from nnpp_edge.runtime.compiled.cache import preparing


class Stopwatch:
    """Milliseconds by stage, from the moment it is made.

    Kernels that have to be loaded or compiled on the way are a stage of their own, ``kernels``.
    """

    def __init__(self) -> None:
        self._began = self._stage_began = time.perf_counter()
        self._prepared_s = preparing.seconds
        self.timings_ms: dict[str, float] = {}
        """Milliseconds by stage, in the order in which the stages first ended."""

    def stage_ends(self, stage: str) -> None:
        """Add the time since the last stage ended to this one."""
        now = time.perf_counter()
        if preparing.seconds > self._prepared_s:
            self._add("kernels", preparing.seconds - self._prepared_s)
            self._stage_began += preparing.seconds - self._prepared_s
            self._prepared_s = preparing.seconds
        self._add(stage, now - self._stage_began)
        self._stage_began = now

    def total_ms(self) -> float:
        """Milliseconds since it was made."""
        return 1e3 * (time.perf_counter() - self._began)

    def _add(self, stage: str, seconds: float) -> None:
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * seconds
