"""Planning once, without keeping a planner."""

import math
from pathlib import Path

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.loading import begin_loading
from nnpp_edge.runtime.planners.choice import expects_network
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.query import Query


@checked(InvalidQueryError)
def plan_path(
    cost: Float2D,
    start: Cell,
    goal: Cell,
    method: str = Method.AUTO,
    step_cost: str = "paper",
    corner_cutting: bool = True,
    omega: float = PAPER_OMEGA,
    *,
    model: str | Path | NetworkModel = "edge",
    epsilon: float = math.inf,
    time_limit_s: float = math.inf,
    refine: str | None = None,
) -> Plan:
    """Plan once; the arguments are those of `Planner` and `Planner.plan`.

    Where the network is expected to be asked, its file is opened while the map is made ready.
    """
    query = Query(as_cell(start, "start"), as_cell(goal, "goal"))
    if expects_network(method, getattr(cost, "shape", ()), model, query.apart):
        begin_loading(model)
    planner = Planner(cost, step_cost=step_cost, omega=omega, corner_cutting=corner_cutting, model=model)
    return planner.plan(start, goal, method=method, epsilon=epsilon, time_limit_s=time_limit_s, refine=refine)
