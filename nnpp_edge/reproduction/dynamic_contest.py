"""Episodes on a map that changes, for the paper's plain methods and our dynamic planners."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.benchmarks.dynamic_episode import LEAST_DISTANCE, STRIDE, Episode, episodes_of
from nnpp_edge.benchmarks.dynamic_scene import SceneRow, run_scene
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.rivals import FIRST_SOURCES
from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_CONTROLS, PLAIN_NN, Answer, Round, contest, means
from nnpp_edge.reproduction.experiment import MAPS_TRIED, Context
from nnpp_edge.reproduction.plain_dstar import PlainDStar
from nnpp_edge.reproduction.regions import CORRIDOR, Networks, PaperRegions, corridor_region
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.planners.plan import path_costs
from nnpp_edge.terrain.workloads import SOFT

PLAIN_DSTAR, PLAIN_DSTAR_NN, PLAIN_DSTAR_CORRIDOR = "plain D*", "plain D*NN", "plain D*, corridor"
"""D* Lite over a graph of the whole map, of the network's region, and of a corridor of the same area: the graph is
mended as the map changes, and as the region does."""
OURS = ("astar", "nnpp", "dstar", "nnpp-dstar", "corridor", "corridor-dstar")
PLAIN_ASTARS = (PLAIN, PLAIN_NN, PLAIN_CONTROLS[CORRIDOR])
PLAIN_DSTARS = (PLAIN_DSTAR, PLAIN_DSTAR_NN, PLAIN_DSTAR_CORRIDOR)
PLAIN_PLANNERS = (*PLAIN_ASTARS, *PLAIN_DSTARS)
PLANNERS = (*PLAIN_PLANNERS, *OURS)
CONTROL_OF = {
    PLAIN_NN: PLAIN_ASTARS[2],
    PLAIN_DSTAR_NN: PLAIN_DSTAR_CORRIDOR,
    "nnpp": "corridor",
    "nnpp-dstar": "corridor-dstar",
}
"""For each method with a network the same with a corridor in place of the network's region."""
CONTROLS_NOTE = (
    "a *corridor* in place of the network's region: for the plain methods the blocks nearest to the path over the "
    "map averaged to blocks, as many as the network's region; for ours `corridor` and `corridor-dstar`"
)
TIMES_NOTE = (
    "The plain methods are the paper's, in plain Python: A* builds a graph for each plan; D* (D* Lite) builds it for "
    "the first plan, and mends graph and search afterwards, within the whole map or as its region changes. Ours are "
    "compiled: `dstar` is D* Lite over the whole map, `nnpp-dstar` in the network's region, where it searches afresh "
    "if mending would be more work. Speed-ups are over the method of the same kind, summed over the plans. Times of "
    "ours hold the map's update and the whole plan; what the first map alone decides is made before the clock starts."
)
NEAR_STRIDE = 5
"""Cells that the robot walks between two plans where the map changes near it."""
_PAPER_SIZE = 256


@dataclass(frozen=True)
class Drive:
    """An episode, and all planners' answers to each of its plans."""

    episode: Episode
    rounds: tuple[Round, ...]

    def answered(self) -> Iterator[tuple[int, Endpoints, Round]]:
        """Each plan's number, start and goal, and answers."""
        for at, (step, answered) in enumerate(zip(self.episode.steps, self.rounds, strict=True)):
            yield at, (step.start, self.episode.goal), answered


def stride_on(size: int) -> int:
    """Cells that the robot walks between two plans: the paper's 45 at 256² and more, fewer on smaller maps."""
    return min(STRIDE, max(STRIDE * size // _PAPER_SIZE, 1))


def find_episodes(context: Context, size: int, count: int, *, near: bool = False) -> list[Episode]:
    """So many episodes on crops of the terrain: the paper's scene, or the one whose changes stay near the robot.

    InvalidQueryError if too few have a way.
    """
    cases = islice(context.cases(size, LEAST_DISTANCE), MAPS_TRIED * count)
    stride = NEAR_STRIDE if near else stride_on(size)
    found = list(islice(episodes_of(cases, context.seed, stride, near=near), count))
    if len(found) < count:
        raise InvalidQueryError(f"wanted {count} maps of {size} × {size} cells with a path, got {len(found)}")
    return found


def drive(episode: Episode, networks: Networks, repeats: int) -> Drive:
    """Have all of `PLANNERS` make every plan of an episode; of ours the median of `repeats` lives counts."""
    size = max(episode.cost.shape)
    rows = run_scene([episode], OURS, model=networks.ours.path, repeats=repeats, stride=stride_on(size))
    mending = {name: _mended_in_python(episode, networks, name) for name in PLAIN_DSTARS}
    rounds = []
    for at, step in enumerate(episode.steps):
        case = Case(SOFT, size, episode.map_at(at), ((step.start, episode.goal),))
        (plain,) = contest([case], networks, 1, planners=PLAIN_ASTARS, repeats=1)
        optimum = next(row.optimal_cost for row in rows if row.step == at)
        by_name = dict(plain.answers)
        for name, lives in mending.items():
            by_name[name] = replace(lives[at], excess=lives[at].excess / optimum - 1.0 if optimum else 0.0)
        ours = {row.method: _answer(row) for row in rows if row.step == at and row.method in OURS}
        by_name |= {name: ours[name] for name in OURS}
        rounds.append(Round(size, plain.path_cells, by_name))
    return Drive(episode, tuple(rounds))


def _mended_in_python(episode: Episode, networks: Networks, name: str) -> list[Answer]:
    """The answers of one of `PLAIN_DSTARS`, plan by plan; as their ``excess`` the cost of the path."""
    answers, harness = list[Answer](), Harness()
    dstar: PlainDStar | None = None
    for at, step in enumerate(episode.steps):
        cost, query = episode.map_at(at), (step.start, episode.goal)
        inside, stages = (None, {}) if name == PLAIN_DSTAR else _region_of(cost, query, networks, name)
        if dstar is None:
            graph_s, dstar = harness.timed(partial(PlainDStar, cost, *query, inside))
        else:
            graph_s, _ = harness.timed(partial(dstar.change, cost, inside))
            dstar.move(step.start)
        assert dstar is not None
        search_s, path = harness.timed(dstar.plan)
        stages |= {"graph": graph_s, "search": search_s}
        grid = Grid.of(cost, StepModel.of("paper"))
        total, _, cc = path_costs(grid, np.array(path or [], np.int32).reshape(-1, 2))
        answers.append(Answer(sum(stages.values()), path is not None, cc, total, None, stages, mended=at > 0))
    return answers


def _region_of(
    cost: Float2D, query: Endpoints, networks: Networks, name: str
) -> tuple[NDArray[np.bool_], dict[str, float]]:
    """The cells of the network's region, or of the corridor of its area, and the seconds that it took."""
    maker, harness = PaperRegions(cost, networks.paper), Harness()
    region, stages = maker.find(query)
    if name == PLAIN_DSTAR_CORRIDOR:
        region_s, region = harness.timed(lambda: corridor_region(maker.grid, query, region))
        stages = {"region": region_s}
    mask_s, inside = harness.timed(region.mask)
    return inside, stages | {"mask": mask_s}


def _answer(row: SceneRow) -> Answer:
    in_first = row.source in FIRST_SOURCES
    excess = row.cost / row.optimal_cost - 1.0 if row.optimal_cost else 0.0
    return Answer(
        1e-3 * row.time_ms, in_first, row.cc, excess, mended=row.mended or (row.method == "dstar" and row.step > 0)
    )


def speedup(rounds: Sequence[Round], slower: str, faster: str) -> float:
    """Summed time of one planner over that of another."""
    return means(rounds, slower).total_s / means(rounds, faster).total_s


def mended(rounds: Sequence[Round], name: str) -> str:
    """On how many of the plans after an episode's first a planner mended what it knew; as text."""
    answers = [each.answers[name] for each in rounds]
    return f"{sum(a.mended for a in answers)} of {len(answers)}"


def network_of(name: str, networks: Networks) -> str | None:
    """The network that a planner asks, for a table; None where it asks none."""
    if name in (PLAIN_NN, PLAIN_DSTAR_NN):
        return f"`{networks.paper.metadata.name}`"
    return f"`{networks.ours.metadata.name}`" if name in ("nnpp", "nnpp-dstar") else None


def label(name: str) -> str:
    """A planner's name in a table for people: ours as code."""
    return f"`{name}`" if name in OURS else name
