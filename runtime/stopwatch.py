"""How long each stage of a query takes."""

import time


class Stopwatch:
    """Milliseconds by stage, from the moment it is made."""

    def __init__(self) -> None:
        self._began = self._stage_began = time.perf_counter()
        self.timings_ms: dict[str, float] = {}
        """Milliseconds by stage, in the order in which the stages first ended."""

    def stage_ends(self, stage: str) -> None:
        """Add the time since the last stage ended to this one."""
        now = time.perf_counter()
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * (now - self._stage_began)
        self._stage_began = now

    def total_ms(self) -> float:
        """Milliseconds since it was made."""
        return 1e3 * (time.perf_counter() - self._began)
