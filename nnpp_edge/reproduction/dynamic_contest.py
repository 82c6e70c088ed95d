"""Episodes on a map that changes, for the paper's plain methods and our dynamic planners."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from nnpp_edge.benchmarks.dynamic_episode import LEAST_DISTANCE, STRIDE, Episode, episodes_of
from nnpp_edge.benchmarks.dynamic_scene import SceneRow, run_scene
from nnpp_edge.profiling.rivals import FIRST_SOURCES
from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Answer, Round, contest, means
from nnpp_edge.reproduction.experiment import MAPS_TRIED, Context
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.workloads import SOFT

OURS = ("astar", "nnpp", "dstar", "nnpp-dstar")
PLANNERS = (PLAIN, PLAIN_NN, *OURS)
TIMES_NOTE = (
    "`plain A*` and `plain A*NN` are the paper's methods in plain Python: a plan builds a graph, and is made once. "
    "There is no plain D*: ours is the compiled D* Lite, over the whole map (`dstar`) and in the network's region "
    "(`nnpp-dstar`, which searches afresh where mending would be more work). Speed-ups are over the method of the "
    "same kind: plain over plain, compiled over compiled, summed over the plans. Times of ours hold the map's update "
    "and the whole plan; what the first map alone decides is made before the clock starts."
)
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


def find_episodes(context: Context, size: int, count: int) -> list[Episode]:
    """So many episodes on crops of the terrain; InvalidQueryError if too few have a way."""
    cases = islice(context.cases(size, LEAST_DISTANCE), MAPS_TRIED * count)
    found = list(islice(episodes_of(cases, context.seed, stride_on(size)), count))
    if len(found) < count:
        raise InvalidQueryError(f"wanted {count} maps of {size} × {size} cells with a path, got {len(found)}")
    return found


def drive(episode: Episode, model: NetworkModel, repeats: int) -> Drive:
    """Have all of `PLANNERS` make every plan of an episode; of ours the median of `repeats` lives counts."""
    size = max(episode.cost.shape)
    rows = run_scene([episode], OURS, model=model.path, repeats=repeats, stride=stride_on(size))
    rounds = []
    for at, step in enumerate(episode.steps):
        case = Case(SOFT, size, episode.map_at(at), ((step.start, episode.goal),))
        (plain,) = contest([case], model, 1, planners=(PLAIN, PLAIN_NN), repeats=1)
        ours = {row.method: _answer(row) for row in rows if row.step == at and row.method in OURS}
        rounds.append(Round(size, plain.path_cells, {**plain.answers, **{name: ours[name] for name in OURS}}))
    return Drive(episode, tuple(rounds))


def _answer(row: SceneRow) -> Answer:
    in_first = row.source in FIRST_SOURCES
    excess = row.cost / row.optimal_cost - 1.0 if row.optimal_cost else 0.0
    return Answer(1e-3 * row.time_ms, in_first, row.cc, excess)


def speedup(rounds: Sequence[Round], slower: str, faster: str) -> float:
    """Summed time of one planner over that of another."""
    return means(rounds, slower).total_s / means(rounds, faster).total_s
