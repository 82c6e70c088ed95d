"""Planners that are measured beside each other, under the names that reports give them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.planner import Planner

EXACT = "astar"
"""The rival that all others are compared with."""
FIRST_SOURCES = (Source.MAP, Source.REGION)
"""Where a path comes from that was found before any region was widened."""


@dataclass(frozen=True)
class RivalPlanner:
    """A planner under its name in a report."""

    name: str
    method: Method
    model: NetworkModel | None = None
    """None: the default model, loaded only if it is needed."""

    def planner(self, cost: Float2D) -> Planner:
        """A planner of its own for a map."""
        return Planner(cost, model=self.model or "edge")


def call_on(planner: Planner, method: str) -> Callable[[Endpoints], Plan]:
    """The planner as a function of start and goal."""
    return lambda query: planner.plan(*query, method=method)


def exact_and(methods: Iterable[str], models: Mapping[str, NetworkModel]) -> list[RivalPlanner]:
    """Exact A*, and a rival for each other method; for ``nnpp`` one for each model.

    The first model's is called ``nnpp``, any other's ``nnpp:NAME``.
    """
    found = [RivalPlanner(EXACT, Method.ASTAR)]
    for method in dict.fromkeys(methods):
        if method == Method.NNPP:
            for at, (name, model) in enumerate(models.items()):
                found.append(RivalPlanner(f"nnpp:{name}" if at else "nnpp", Method.NNPP, model))
        elif method != EXACT:
            found.append(RivalPlanner(method, Method(method), next(iter(models.values()), None)))
    return found
