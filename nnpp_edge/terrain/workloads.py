"""The standard workloads: by what rule a DEM becomes a cost map."""

from dataclasses import replace

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import Traversability

SOFT = "soft"


def workload(name: str, base: Traversability | None = None) -> Traversability:
    """The limits of a workload.

    ``soft`` is the paper's cost, without hard limits. ``limitN`` is a rover that tilts over beyond N
    degrees: φ_s = N°, and steeper cells are impassable.
    """
    base = base or Traversability()
    if name == SOFT:
        return base
    try:
        limit = float(name.removeprefix("limit")) if name.startswith("limit") else 0.0
    except ValueError:
        limit = 0.0
    if not 0.0 < limit < 90.0:
        raise InvalidQueryError(f"workload must be 'soft' or 'limitN' with N in (0, 90) degrees, got {name!r}")
    return replace(base, slope_limit_deg=limit, hard_slope_deg=limit)
