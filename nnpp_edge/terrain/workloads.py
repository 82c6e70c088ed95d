"""The standard workloads: by what rule a DEM becomes a cost map."""

from collections.abc import Iterable
from dataclasses import replace

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.rocks import MOST_COVER

SAFE = "safe"
SOFT = "soft"
BODY = "body"
_ROCKS = "body-rocks"


def workload(name: str, base: Traversability | None = None) -> Traversability:
    """The limits of a workload.

    ``safe`` makes φ_s a hard limit, of cells and of single steps, see `Traversability.safe`.
    ``soft`` is the paper's cost, without hard limits. ``limitN`` is φ_s = N°, and cells are
    impassable on which the plane fitted to their 3×3 patch is steeper. A single step between two
    cells' middles may be steeper than that.
    """
    base = base or Traversability()
    if name == SAFE:
        return Traversability.safe(**base.changed)
    if name == SOFT:
        return base
    if body_rocks(name) is not None:
        raise InvalidQueryError(
            f"workload {name!r} is a vehicle's: `nnpp-edge evaluate` and `profile` judge by it, "
            "no other command"
        )
    limit = _number(name, "limit")
    if not 0.0 < limit < 90.0:
        raise InvalidQueryError(
            f"workload must be 'safe', 'soft' or 'limitN' with N in (0, 90) degrees, got {name!r}"
        )
    return replace(base, slope_limit_deg=limit, hard_slope_deg=limit)


def body_rocks(name: str) -> float | None:
    """Share of the ground under rocks in the workloads of a vehicle; None for those of a point.

    ``body`` is the ground as it is, ``body-rocksN`` has rocks on N percent of it. InvalidQueryError
    for other N than 0 to 20.
    """
    if name == BODY:
        return 0.0
    if not name.startswith(_ROCKS):
        return None
    share = _number(name, _ROCKS) / 100.0
    most = 100 * MOST_COVER
    if not 0.0 <= share <= MOST_COVER:
        raise InvalidQueryError(
            f"workload must be 'body-rocksN' with N from 0 to {most:g} percent, got {name!r}"
        )
    return share


def of_bodies(names: Iterable[str]) -> list[str]:
    """The workloads of a vehicle among others; InvalidQueryError for a name that is none."""
    found = [name for name in names if body_rocks(name) is not None]
    for name in set(names) - set(found):
        workload(name)
    return found


def _number(name: str, prefix: str) -> float:
    """The number after a prefix; below 0 for another name."""
    try:
        return float(name.removeprefix(prefix)) if name.startswith(prefix) else -1.0
    except ValueError:
        return -1.0
