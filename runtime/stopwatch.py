"""How long each stage of a query takes."""

import time


class Preparing:
    """The time that this process has spent on loading or compiling kernels, each of which may need
    others.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        """Of those that are ready."""
        self._begun = 0
        self._began_s = 0.0

    def begins(self) -> None:
        """A kernel is looked for."""
        if self._begun == 0:
            self._began_s = time.perf_counter()
        self._begun += 1

    def ends(self) -> None:
        """It is ready."""
        self._begun -= 1
        if self._begun == 0:
            self.seconds += time.perf_counter() - self._began_s


preparing = Preparing()


class Work:
    """Time and expansions of a query so far: milliseconds by stage, from the moment it is made.

    Kernels that have to be loaded or compiled on the way are a stage of their own, ``kernels``.
    """

    def __init__(self) -> None:
        self._began = self._stage_began = self._paused_at = time.perf_counter()
        self._prepared_s = preparing.seconds
        self.timings_ms: dict[str, float] = {}
        """Milliseconds by stage, in the order in which the stages first ended."""
        self.expansions = 0
        """Cells expanded, at all levels."""

    def stage_ends(self, stage: str, expansions: int = 0) -> None:
        """Add the time since the last stage ended to this one, which expanded so many cells."""
        self.expansions += expansions
        now = time.perf_counter()
        prepared_s = preparing.seconds - self._prepared_s
        if prepared_s > 0.0:
            self._add("kernels", prepared_s)
            self._stage_began += prepared_s
            self._prepared_s = preparing.seconds
        self._add(stage, now - self._stage_began)
        self._stage_began = now

    def pauses(self) -> None:
        """Do not count the time from now on."""
        self._paused_at = time.perf_counter()

    def resumes(self) -> None:
        """Count again."""
        paused_s = time.perf_counter() - self._paused_at
        self._began += paused_s
        self._stage_began += paused_s

    def total_ms(self) -> float:
        """Milliseconds since it was made."""
        return 1e3 * (time.perf_counter() - self._began)

    def _add(self, stage: str, seconds: float) -> None:
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * seconds
