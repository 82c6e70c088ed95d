"""Fig. 14 and 15: the network's region for several goals, and around moving obstacles."""

import math
from collections.abc import Iterator
from itertools import chain

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.profiling.suites import LEAST_DISTANCE, QUERIES_PER_MAP, Case
from nnpp_edge.reproduction import drawing
from nnpp_edge.reproduction.experiment import BOTH, Context, Experiment
from nnpp_edge.reproduction.findings import Figure, Finding, judge, mean
from nnpp_edge.reproduction.planners import OneMap
from nnpp_edge.reproduction.regions import NETWORK, best_path, grid_of
from nnpp_edge.reproduction.table import percent
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.obstacles import covered

_FRAMES = range(-2, 3)
"""From T to T + 4Δt (the paper's); obstacles cross the optimal path at the middle one."""
_MAPS = 40
"""Maps that are tried for one on which the goals can be reached and the obstacles leave a way."""


def fig14(context: Context, *, size: int, goals: int) -> Rows:
    """One map: several goals from one start, then obstacles that move on the way to the first of
    them.
    """
    (size,) = context.fitting([size])
    for _, case in context.maps([size], _MAPS, queries=QUERIES_PER_MAP):
        start, goal = case.queries[0]
        ends = _goals(case)[:goals]
        moving = _moving(case.cost, start, goal)
        if len(ends) == goals and moving:
            break
    else:
        raise InvalidQueryError(
            f"none of {_MAPS} maps of {size} × {size} cells has ways around moving obstacles"
        )
    shown = [("goals", f"goal {n}", case.cost, end) for n, end in enumerate(ends, 1)]
    shown += [("obstacles", drawing.frame(at), cost, goal) for at, cost in enumerate(moving)]
    rows = Rows()
    firsts: dict[str, OneMap] = {}
    for part, name, cost, end in shown:
        here = OneMap(cost, (start, end), context.networks)
        first = firsts.setdefault(part, here)
        found = here.searched({kind: kind for kind in here.regions})
        for row in found:
            blocks = here.regions[row["planner"]].blocks()
            of_first = first.regions[row["planner"]].blocks()
            common = (blocks & of_first).sum() / (blocks | of_first).sum()
            rows.append({"part": part, "scene": name, **row, "common": float(common)})
        excess = percent(found.of(NETWORK).mean("gap"), 2)
        context.scenes.append(drawing.scene(f"{name}: {excess} above the optimum", here))
    return rows


def _goals(case: Case) -> list[Cell]:
    """The first query's goal, and ends of the others that are far from its start and can be
    reached.
    """
    start, goal = case.queries[0]
    least = LEAST_DISTANCE * case.size
    ends = dict.fromkeys([goal, *chain.from_iterable(case.queries)])
    far = [end for end in ends if math.dist(start, end) >= least]
    grid = grid_of(case.cost)
    return [end for end in far if len(best_path(grid, (start, end)).path)]


def _moving(cost: Float2D, start: Cell, goal: Cell) -> list[Float2D]:
    """The map at each frame, two obstacles on it that pass each other, a quarter of the map long;
    none if one would cover start or goal, or leave no way.
    """
    size = len(cost)
    depth = max(size // 12, 2)
    way = best_path(grid_of(cost), (start, goal)).path
    upper, lower = sorted(way[len(way) * percent // 100].tolist() for percent in (35, 65))
    costs = []
    for at in _FRAMES:
        moved = at * size // 10
        corners = ((upper[0], upper[1] - moved), (lower[0], lower[1] + moved))
        obstacles = [(row - depth // 2, col - size // 8, depth, size // 4) for row, col in corners]
        costs.append(covered(cost, (0, 0, size, size), obstacles))
    if all(len(best_path(grid_of(changed), (start, goal)).path) for changed in costs):
        return costs
    return []


def fig14_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of both parts: goals, and frames with obstacles."""
    for part, what in (("goals", "goal"), ("obstacles", "frame")):
        own = rows.of(NETWORK, part=part)
        excess = percent(max(own.all("gap"), default=math.nan), 2)
        yield judge(
            f"a good path in the region for every {what}",
            "yes (pictures)",
            "all in the region, within 3 % of the optimum",
            Figure(_greatest_excess, percent),
            rows.of(part=part),
            NETWORK,
            most=0.03,
            ours=f"{sum(own.all('found')):.0f} of {len(own)} in the region, "
            f"at most {excess} above the optimum",
        )
    last = rows.of(part="obstacles", scene=rows[-1]["scene"])
    yield judge(
        "the regions at T and T + 4Δt are the same, as the obstacles there are not in the way",
        "identical",
        "nine blocks in ten in common",
        mean("common", NETWORK),
        last,
        NETWORK,
        least=0.9,
    )


def _greatest_excess(rows: Rows) -> float:
    """Inf where a path is missing."""
    return max(float(row.get("gap", math.inf)) for row in rows.of(NETWORK))


EXPERIMENTS = {
    "fig14": Experiment(
        "Fig. 14 and 15",
        "Other goals, and obstacles that move",
        fig14,
        ("part", "planner"),
        fig14_findings,
        None,
        {"size": 256, "goals": 5},
        networks=BOTH[:1],
    ),
}
