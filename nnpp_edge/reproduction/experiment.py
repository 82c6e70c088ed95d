"""Experiments: their inputs and results."""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case, large_enough, terrain_cases
from nnpp_edge.reproduction.findings import Finding
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.rows import Row, Rows
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAPS_TRIED = 20
"""For each that is wanted, before giving up on finding one with a path."""
BOTH = ("the paper's method", "ours")
PAPERS = ("the paper's method",)
"""Networks that take part in an experiment."""
CONTROLS_NOTE = (
    "*corridor*, the blocks nearest to the path that a search over the map averaged to blocks "
    "finds, as many as the "
    "network's region has, so that MM is the same (of ours `corridor` and `corridor-dstar`); "
    "*straight band*, as "
    "many blocks nearest to the line from start to goal; *shuffled weights*, the same network "
    "with the weights of "
    "each layer in a random order. Where a control meets a rule as well, the figure says nothing "
    "about the network"
)


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
        """The sizes that the terrain is large enough for, with a note on the others;
        InvalidQueryError if none is.
        """
        largest = max(min(dem.elevation.shape) for dem in self.terrain)
        if largest < min(sizes):
            raise InvalidQueryError(
                f"wanted terrain of at least {min(sizes)} cells a side, got {largest}"
            )
        if left_out := ", ".join(f"{size}²" for size in sizes if size > largest):
            self.notes.append(
                f"Left out, as the terrain is no more than {largest} cells a side: {left_out}."
            )
        return [size for size in sizes if size <= largest]

    def one_size(self, wanted: int) -> int:
        """The size, or the greatest of 128 and 64 that the terrain is large enough for."""
        if large_enough(self.terrain, wanted):
            return wanted
        return max(self.fitting((wanted, *(size for size in (128, 64) if size < wanted))))

    def cases(self, size: int, least_distance: float = LEAST_DISTANCE) -> Iterator[Case]:
        """Random crops of the terrain with queries, the paper's cost without hard limits; without
        end.
        """
        return terrain_cases(
            large_enough(self.terrain, size), SOFT, size, self.seed, least_distance
        )

    def maps(
        self, size: int, count: int, least: float = LEAST_DISTANCE
    ) -> Iterator[tuple[Case, Endpoints]]:
        """`count` random crops, each with one query that has a path; InvalidQueryError if too few
        have.
        """
        found = 0
        for case in islice(self.cases(size, least), MAPS_TRIED * count):
            planner = Planner(case.cost)
            query = next(
                (query for query in case.queries if planner.plan(*query, method="astar").ok), None
            )
            if query is not None:
                yield case, query
                found += 1
            if found == count:
                return
        raise InvalidQueryError(
            f"wanted {count} maps of {size} × {size} cells with a path, got {found}"
        )


class Result(NamedTuple):
    """All that an experiment hands back."""

    rows: Rows
    """Measurements, for programs."""
    by: Sequence[str]
    """Names by which rows are a line of the table for people."""
    findings: Sequence[Finding]
    picture: "Figure"
    table: Sequence[Row] | None = None
    """Rows of that table, the paper's among them, where not `rows`."""
    totals: bool = False
    """Whether the table has sums in place of means."""


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper, as we repeat it."""

    where: str
    """Where it stands in the paper."""
    title: str
    run: Callable[..., Result]
    """Of a `Context` and the settings, which are its keyword arguments; their defaults are those of
    a full run.
    """
    quick: Mapping[str, object]
    """Settings of a smoke run, where not the full one's."""
    networks: tuple[str, ...] = BOTH
    """Those that take part: what was made stays good when there is another one of the others."""

    def settings(self, *, quick: bool, queries: int | None = None) -> dict[str, object]:
        """All settings of a run, with the number of `queries` where it has one."""
        parameters = inspect.signature(self.run).parameters.values()
        full = {each.name: each.default for each in parameters if each.kind is each.KEYWORD_ONLY}
        own = {"queries": queries} if queries is not None and "queries" in full else {}
        return full | (dict(self.quick) if quick else {}) | own


def experiment(
    where: str, title: str, quick: Mapping[str, object], networks: tuple[str, ...] = BOTH
) -> Callable[[Callable[..., Result]], Experiment]:
    """Make a function an `Experiment`."""
    return lambda run: Experiment(where, title, run, quick, networks)
