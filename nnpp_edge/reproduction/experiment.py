"""Experiments: their inputs and results."""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case, large_enough, terrain_cases
from nnpp_edge.reproduction.findings import Finding
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAPS_TRIED = 20
"""For each that is wanted, before giving up on finding one with a path."""


@dataclass(frozen=True)
class Context:
    """Means of every experiment."""

    terrain: Sequence[Dem]
    seed: int
    networks: Networks
    advance: Callable[[int], None] = lambda done: None
    notes: list[str] = field(default_factory=list)
    """Whole sentences for the page."""

    def progress(self, share: float) -> None:
        """So much of the work is done."""
        self.advance(int(1000 * share))

    def fitting(self, sizes: Sequence[int]) -> list[int]:
        """The sizes that the terrain is large enough for, with a note on the others; InvalidQueryError if none is."""
        largest = max(min(dem.elevation.shape) for dem in self.terrain)
        if largest < min(sizes):
            raise InvalidQueryError(f"wanted terrain of at least {min(sizes)} cells a side, got {largest}")
        if left_out := ", ".join(f"{size}²" for size in sizes if size > largest):
            self.notes.append(f"Left out, as the terrain is no more than {largest} cells a side: {left_out}.")
        return [size for size in sizes if size <= largest]

    def one_size(self, wanted: int) -> int:
        """The size, or the greatest of 128 and 64 that the terrain is large enough for."""
        if any(min(dem.elevation.shape) >= wanted for dem in self.terrain):
            return wanted
        return max(self.fitting((wanted, *(size for size in (128, 64) if size < wanted))))

    def cases(self, size: int, least_distance: float = LEAST_DISTANCE) -> Iterator[Case]:
        """Random crops of the terrain with queries, the paper's cost without hard limits; without end."""
        return terrain_cases(large_enough(self.terrain, size), SOFT, size, self.seed, least_distance)

    def maps(self, size: int, count: int, least: float = LEAST_DISTANCE) -> Iterator[tuple[Case, Endpoints]]:
        """`count` random crops, each with one query that has a path; InvalidQueryError if too few have."""
        found = 0
        for case in islice(self.cases(size, least), MAPS_TRIED * count):
            planner = Planner(case.cost)
            query = next((query for query in case.queries if planner.plan(*query, method="astar").ok), None)
            if query is not None:
                yield case, query
                found += 1
            if found == count:
                return
        raise InvalidQueryError(f"wanted {count} maps of {size} × {size} cells with a path, got {found}")


@dataclass(frozen=True)
class Result:
    """All that an experiment hands back."""

    summary: str
    """Markdown tables for people: ours beside the paper's."""
    rows: Rows
    """Measurements, for programs."""
    findings: Sequence[Finding]
    picture: "Figure"
    networks: str | None = None
    """Which networks took part, and where; by default both, or none where the experiment asks none."""
    controls: str | None = None


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper, as we repeat it."""

    where: str
    """Where it stands in the paper."""
    title: str
    run: Callable[..., Result]
    """Of a `Context` and the settings, which are its keyword arguments; their defaults are those of a full run."""
    quick: Mapping[str, object]
    """Settings of a smoke run, where not the full one's."""
    asks_networks: bool
    """Whether a network that is handed in takes part: else what was made stays good when there is another one."""

    def settings(self, *, quick: bool, **wanted: object) -> dict[str, object]:
        """All settings of a run, with those `wanted` that it has and that are not None."""
        parameters = inspect.signature(self.run).parameters.values()
        full = {each.name: each.default for each in parameters if each.kind is each.KEYWORD_ONLY}
        own = {name: value for name, value in wanted.items() if name in full and value is not None}
        return full | (dict(self.quick) if quick else {}) | own


def experiment(
    where: str, title: str, quick: Mapping[str, object], *, asks_networks: bool = True
) -> Callable[[Callable[..., Result]], Experiment]:
    """Make a function an `Experiment`."""
    return lambda run: Experiment(where, title, run, quick, asks_networks)
