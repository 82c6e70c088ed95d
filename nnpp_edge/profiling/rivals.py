"""Planners that are measured beside each other, under the names that reports give them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from nnpp_edge.profiling.quantities import EXACT
from nnpp_edge.profiling.suites import Case
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.tuning import LEARNED_CORRIDOR, WIDENED_CORRIDOR, CorridorWidth

Answers = Callable[..., Plan]
"""A rival on one map: its plan for a query; `keep_regions` as of `Planner.plan`."""


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

    def on(self, ground: Ground, *, lazy: bool = True) -> Answers:
        """A planner of its own for a map."""
        if self.width is not None:
            state = map_state(ground, self.omega, self.corner_cutting, lazy=lazy)
            return partial(_in_corridor, Methods(state), self.width)
        planner = Planner(
            ground,
            model=self.model or "edge",
            omega=self.omega,
            corner_cutting=self.corner_cutting,
            lazy=lazy,
        )
        return partial(planned, planner, self.method)


def planned(planner: Planner, method: str, query: Endpoints, *, keep_regions: bool = False) -> Plan:
    """The answer of a planner by a method."""
    return planner.plan(*query, method=method, keep_regions=keep_regions)


def _in_corridor(
    methods: Methods, width: CorridorWidth, query: Endpoints, *, keep_regions: bool = False
) -> Plan:
    """The corridor's answer, whose first corridor has another width: of the learned region's width
    it shows what is owed to the network, and what to narrow corridors alone.
    """
    work = Work()
    found = methods.corridor(Query(*query), work, widths=(width, WIDENED_CORRIDOR))
    return found.plan(DynamicMethod.CORRIDOR, work, methods.state, keep_regions=keep_regions)


class OnMap:
    """Rivals on a map that stands: `calls` has their answers by name."""

    def __init__(self, case: Case, rivals: Iterable[RivalPlanner], *, lazy: bool = True) -> None:
        ground = case.standing
        self._of_body = ground.vehicle is not None
        self._makers = {rival.name: partial(rival.on, ground, lazy=lazy) for rival in rivals}
        self.calls = {name: make() for name, make in self._makers.items()}

    def renew(self, name: str) -> None:
        """With a vehicle make a rival's planner anew, which then has checked no pose."""
        if self._of_body and name in self._makers:
            self.calls[name] = self._makers[name]()


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
