"""Experiments: what each measures and says, and the inputs of all."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case, solvable, terrain_cases
from nnpp_edge.progress import THOUSANDTHS
from nnpp_edge.reproduction.findings import Finding
from nnpp_edge.reproduction.regions import NetworkPair
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BOTH = ("the paper's method", "ours")
"""The roles of the networks."""
_LEAST_SIZES = (128, 64)
"""In place of a larger one, where the terrain has no room for it."""


@dataclass(frozen=True)
class Context:
    """The inputs of every experiment, and what it leaves beside its rows."""

    terrain: Sequence[Dem]
    seed: int
    networks: NetworkPair
    advance: Callable[[int], None]
    """Called with the thousandths of the work that are done."""
    notes: list[str] = field(default_factory=list)
    """Whole sentences for the page."""
    scenes: "list[Callable[[Axes], object]]" = field(default_factory=list)
    """Each draws a map."""

    def fitting(self, sizes: Sequence[int]) -> list[int]:
        """The sizes that the terrain is large enough for, with a note on the others; where it is
        for none, the greatest of 128 and 64. InvalidQueryError if it is smaller.
        """
        largest = max(min(dem.shape) for dem in self.terrain)
        fitting = [size for size in sizes if size <= largest]
        fitting = fitting or [size for size in _LEAST_SIZES if size <= largest][:1]
        if not fitting:
            least = min(*sizes, *_LEAST_SIZES)
            raise InvalidQueryError(
                f"wanted terrain of at least {least} cells a side, got {largest}"
            )
        if left_out := ", ".join(f"{size}²" for size in sizes if size > largest):
            self.notes.append(
                f"Left out, as the terrain is no more than {largest} cells a side: {left_out}."
            )
        return fitting

    def maps(
        self,
        sizes: Sequence[int],
        count: int,
        least_distance: float = LEAST_DISTANCE,
        queries: int = 1,
    ) -> Iterator[tuple[int, Case]]:
        """For each size the numbers from 1 to `count`, each with a random crop and so many queries
        on it that have a path, of the paper's cost without hard limits.

        InvalidQueryError if too few crops have a path.
        """
        done = 0
        for size in sizes:
            cases = terrain_cases(self.terrain, SOFT, size, self.seed, least_distance)
            for number, case in enumerate(solvable(cases, count * queries, queries), 1):
                yield number, case
                done += 1
                self.advance(THOUSANDTHS * done // (count * len(sizes)))


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper, as we repeat it."""

    where: str
    """Its place in the paper."""
    title: str
    measure: Callable[..., Iterable[Row]]
    """From a `Context` and the settings, which are its keyword arguments."""
    by: Sequence[str]
    """Names by which rows are a line of the table for people."""
    findings: Callable[[Rows], Iterable[Finding]]
    """On the measured rows."""
    picture: Callable[[Rows], "Figure"] | None
    """Of the rows, the paper's among them; None where maps are drawn."""
    settings: Mapping[str, object]
    theirs: Sequence[Row] = ()
    """The paper's rows."""
    networks: tuple[str, ...] = BOTH
    """Those that take part."""
    totals: bool = False
    """Whether the table has sums in place of means."""

    def beside(self, rows: Rows) -> Rows:
        """The measured rows after the paper's of the same sizes."""
        sizes = {row.get("size") for row in rows}
        theirs = [row for row in self.theirs if row.get("size") in (None, *sizes)]
        return Rows([*theirs, *rows])
