"""Planners that are measured beside each other, under the names that reports give them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState, map_state
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.tuning import LEARNED_CORRIDOR, WIDENED_CORRIDOR, CorridorWidth

EXACT = "astar"
"""The rival that all others are compared with."""


class CorridorAlone:
    """The corridor planner on a map of its own, whose first corridor has another width.

    Of the learned region's width it shows what is owed to the network, and what to narrow corridors
    alone.
    """

    def __init__(self, state: MapState, first: CorridorWidth) -> None:
        self._methods = Methods(state)
        self._widths = (first, WIDENED_CORRIDOR)

    def plan(self, start: Cell, goal: Cell, *, method: str, keep_regions: bool = False) -> Plan:
        """As `Planner.plan`; there is but one method. The first plan makes what it needs."""
        work = Work()
        state = self._methods.state
        checked = state.checked
        found = self._methods.corridor(Query(start, goal), work, widths=self._widths)
        plan = found.plan(DynamicMethod.CORRIDOR, work, state, checked, keep_regions=keep_regions)
        return replace(plan, planner=method)


FindsPlans = Planner | CorridorAlone


@dataclass(frozen=True)
class RivalPlanner:
    """A planner under its name in a report."""

    name: str
    method: Method
    model: NetworkModel | None = None
    """None: the default model, loaded only if it is needed."""
    width: CorridorWidth | None = None
    """Of the first corridor, instead of the usual one."""
    omega: float = PAPER_OMEGA
    corner_cutting: bool = True

    def plan(self, planner: FindsPlans, query: Endpoints, *, keep_regions: bool = False) -> Plan:
        """The answer of a planner of the rival's own."""
        return planner.plan(*query, method=self.method, keep_regions=keep_regions)

    def planner(self, ground: Ground, *, lazy: bool = True) -> FindsPlans:
        """A planner of its own for a map."""
        if self.width is not None:
            return CorridorAlone(
                map_state(ground, self.omega, self.corner_cutting, lazy=lazy), self.width
            )
        return Planner(
            ground,
            model=self.model or "edge",
            omega=self.omega,
            corner_cutting=self.corner_cutting,
            lazy=lazy,
        )

    def apart(self) -> "RivalPlanner":
        """With a network that no other planner uses: what that has been shown of a map is
        not kept.
        """
        return replace(self, model=self.model and self.model.share())


class OnMap:
    """Rivals on a map that stands, each as a function of a query."""

    def __init__(self, case: Case, rivals: Iterable[RivalPlanner], *, lazy: bool = True) -> None:
        self._ground = case.standing
        self._lazy = lazy
        self._rivals = {rival.name: rival for rival in rivals}
        self._planners = {name: self._planner(name) for name in self._rivals}
        self.calls = {name: partial(self.plan, name) for name in self._rivals}

    def plan(self, name: str, query: Endpoints, *, keep_regions: bool = False) -> Plan:
        """A rival's answer."""
        rival = self._rivals[name]
        return rival.plan(self._planners[name], query, keep_regions=keep_regions)

    def renew(self, name: str) -> None:
        """With a vehicle make a rival's planner anew, which then has checked no pose."""
        if self._ground.vehicle is not None and name in self._planners:
            self._planners[name] = self._planner(name)

    def _planner(self, name: str) -> FindsPlans:
        return self._rivals[name].planner(self._ground, lazy=self._lazy)


def exact_and(methods: Iterable[str], models: Mapping[str, NetworkModel]) -> list[RivalPlanner]:
    """Exact A*, and a rival for each other method; for ``nnpp`` one for each model.

    The first model's is called ``nnpp``, any other's ``nnpp:NAME``.
    """
    found = [RivalPlanner(EXACT, Method.ASTAR)]
    first = next(iter(models.values()), None)
    for method in dict.fromkeys(methods):
        if method == Method.NNPP:
            for at, (name, model) in enumerate(models.items()):
                found.append(RivalPlanner(f"nnpp:{name}" if at else "nnpp", Method.NNPP, model))
        elif method != EXACT:
            found.append(RivalPlanner(method, Method(method), first))
    return found


def controls() -> list[RivalPlanner]:
    """What has learned nothing, to be beaten by what has: a corridor with the learned region's
    narrow bands, and `edge` after three steps of training, whose region is the whole map.
    """
    return [
        RivalPlanner("corridor-narrow", Method.CORRIDOR, width=LEARNED_CORRIDOR),
        RivalPlanner("nnpp-untrained", Method.NNPP, NetworkModel("edge-untrained")),
    ]
