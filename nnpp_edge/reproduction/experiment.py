"""What an experiment is, and what it is given."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case, large_enough, terrain_cases
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.report import Result
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

NAMES = ("table1", "fig6", "fig7", "fig8", "table2", "fig9", "fig11", "fig12", "fig14", "table3", "table4", "fig13")
"""All experiments, in the order in which they run. Each is the module of that name in this package."""
MAPS_TRIED = 20
"""Maps tried for each that is wanted, before giving up on finding one with a path."""


@dataclass(frozen=True)
class Context:
    """What every experiment works with."""

    terrain: Sequence[Dem]
    seed: int
    networks: Networks
    work: Path
    """Folder for what an experiment that is interrupted goes on from; removed once it is done."""
    dataset: Path | None = None
    """Training set for the experiments that train; without it they make one from the terrain."""

    def fitting(self, sizes: Sequence[int]) -> tuple[tuple[int, ...], list[str]]:
        """The sizes that the terrain is large enough for, and a note on the others.

        Raises
        ------
        InvalidQueryError
            It is too small for all of them.
        """
        largest = max(min(dem.elevation.shape) for dem in self.terrain)
        fit = tuple(size for size in sizes if size <= largest)
        if not fit:
            raise InvalidQueryError(f"wanted terrain of at least {min(sizes)} cells a side, got {largest}")
        left_out = [f"{size}²" for size in sizes if size > largest]
        note = f"Left out, as the terrain is no more than {largest} cells a side: {', '.join(left_out)}."
        return fit, [note] if left_out else []

    def one_size(self, wanted: int) -> tuple[int, list[str]]:
        """The size, or the greatest of 128 and 64 that the terrain is large enough for, and a note on it."""
        sizes, notes = self.fitting((wanted, 128, 64))
        size = max(sizes)
        return size, notes if size < wanted else []

    def cases(self, size: int, least_distance: float = LEAST_DISTANCE) -> Iterator[Case]:
        """Random crops of the terrain with queries, the paper's cost without hard limits; without end."""
        return terrain_cases(large_enough(self.terrain, size), SOFT, size, self.seed, least_distance)

    def maps(self, size: int, count: int) -> Iterator[tuple[Case, Endpoints]]:
        """`count` random crops, each with one query that has a path; InvalidQueryError if too few have."""
        found = 0
        for case in islice(self.cases(size), MAPS_TRIED * count):
            planner = Planner(case.cost)
            query = next((query for query in case.queries if planner.plan(*query, method="astar").ok), None)
            if query is not None:
                yield case, query
                found += 1
            if found == count:
                return
        raise InvalidQueryError(f"wanted {count} maps of {size} × {size} cells with a path, got {found}")


OnProgress = Callable[[float], None]
"""Called with the share of the work that is done."""
SettingsT = TypeVar("SettingsT", bound="DataclassInstance")


@dataclass(frozen=True)
class Experiment(Generic[SettingsT]):
    """An experiment of the paper, as we repeat it. Its module holds one under the name ``EXPERIMENT``."""

    where: str
    """Where it stands in the paper."""
    title: str
    run: Callable[[Context, SettingsT, OnProgress], Result]
    full: SettingsT
    """Its settings, a frozen dataclass."""
    quick: SettingsT
    """The same for a smoke run."""
    asks_networks: bool = True
    """Whether a network that is handed in takes part: else what was made stays good when there is another one."""


def find_experiment(name: str) -> "Experiment[DataclassInstance] | None":
    """The experiment of that name; None where this version of the toolkit lacks it.

    Raises
    ------
    InvalidQueryError
        There is no experiment of that name.
    """
    if name not in NAMES:
        raise InvalidQueryError(f"experiment must be one of {', '.join(NAMES)}, got {name!r}")
    module = f"{__package__}.{name}"
    if find_spec(module) is None:
        return None
    found: Experiment[DataclassInstance] = import_module(module).EXPERIMENT
    return found
