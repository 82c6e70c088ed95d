"""Experiments: their inputs and results."""

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case, large_enough, terrain_cases
from nnpp_edge.progress import THOUSANDTHS
from nnpp_edge.reproduction.findings import Finding
from nnpp_edge.reproduction.regions import NetworkPair
from nnpp_edge.reproduction.rows import Row, Rows
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MadeT = TypeVar("MadeT")
MAPS_TRIED = 20
"""Maps that are tried for each that is wanted with a path."""
BOTH = ("the paper's method", "ours")
"""The roles of the networks."""


@dataclass(frozen=True)
class Context:
    """The inputs of every experiment."""

    terrain: Sequence[Dem]
    seed: int
    networks: NetworkPair
    advance: Callable[[int], None]
    """Called with the thousandths of the work that are done."""
    notes: list[str] = field(default_factory=list)
    """Whole sentences for the page."""

    def progress(self, share: float) -> None:
        """Report the share of the work that is done."""
        self.advance(int(THOUSANDTHS * share))

    def fitting(self, sizes: Sequence[int]) -> list[int]:
        """The sizes that the terrain is large enough for, with a note on the others.

        InvalidQueryError if there is none.
        """
        largest = max(min(dem.shape) for dem in self.terrain)
        fitting = [size for size in sizes if size <= largest]
        if not fitting:
            raise InvalidQueryError(
                f"wanted terrain of at least {min(sizes)} cells a side, got {largest}"
            )
        if len(fitting) < len(sizes):
            left_out = ", ".join(f"{size}²" for size in sizes if size > largest)
            self.notes.append(
                f"Left out, as the terrain is no more than {largest} cells a side: {left_out}."
            )
        return fitting

    def one_size(self, wanted: int) -> int:
        """The size, or the greatest of 128 and 64 that the terrain is large enough for."""
        return max(self.fitting([size for size in (64, 128, wanted) if size <= wanted]))

    def crops(
        self,
        size: int,
        count: int,
        least_distance: float,
        make: Callable[[int, Case], MadeT | None],
    ) -> Iterator[MadeT]:
        """Random crops of the terrain with queries that are so far apart, the paper's cost without
        hard limits: what `make` makes of a crop's number and the crop, until `count` are not None.

        InvalidQueryError if too few are.
        """
        fitting = large_enough(self.terrain, size)
        cases = terrain_cases(fitting, SOFT, size, self.seed, least_distance)
        tried = enumerate(islice(cases, MAPS_TRIED * count))
        made = (made for number, case in tried if (made := make(number, case)) is not None)
        found = 0
        for found, each in enumerate(islice(made, count), 1):
            yield each
        if found < count:
            raise InvalidQueryError(
                f"wanted {count} maps of {size} × {size} cells with a path, got {found}"
            )

    def maps(
        self, sizes: Sequence[int], count: int, least_distance: float = LEAST_DISTANCE
    ) -> Iterator[tuple[int, Case, Endpoints]]:
        """For each size the numbers from 1 to `count`, each with a random crop and a query on it
        that has a path. Progress is reported by the area done.

        InvalidQueryError if too few crops have a path.
        """
        area = count * sum(size**2 for size in sizes)
        done = 0
        for size in sizes:
            crops = self.crops(size, count, least_distance, _with_path)
            for number, (case, query) in enumerate(crops, 1):
                yield number, case, query
                done += size**2
                self.progress(done / area)


def _with_path(number: int, case: Case) -> tuple[Case, Endpoints] | None:
    """A map and the first of its queries that has a path."""
    planner = Planner(case.cost)
    for query in case.queries:
        if planner.plan(*query, method="astar").ok:
            return case, query
    return None


class Result(NamedTuple):
    """All that an experiment hands back."""

    rows: Rows
    """Measurements, for programs."""
    by: Sequence[str]
    """Names by which rows are a line of the table for people."""
    findings: Iterable[Finding]
    picture: "Figure"
    table: Sequence[Row] = ()
    """Rows of that table, the paper's among them; empty where they are `rows`."""
    totals: bool = False
    """Whether the table has sums in place of means."""


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper, as we repeat it."""

    where: str
    """Its place in the paper."""
    title: str
    run: Callable[..., Result]
    """From a `Context` and the settings, which are its keyword arguments; their defaults are those
    of a full run.
    """
    quick: Mapping[str, object]
    """Settings of a quick run, where they differ from a full one's."""
    networks: tuple[str, ...] = BOTH
    """Those that take part: a change of another network does not repeat the experiment."""

    def settings(self, *, quick: bool, queries: int | None) -> dict[str, object]:
        """All settings of a run, with the number of `queries` where it has one."""
        parameters = inspect.signature(self.run).parameters.values()
        found = {each.name: each.default for each in parameters if each.kind is each.KEYWORD_ONLY}
        if quick:
            found |= self.quick
        if queries is not None and "queries" in found:
            found["queries"] = queries
        return found
