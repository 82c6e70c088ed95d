"""The measured run of a profile: every planner, every query, in turns, in two halves."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.machine import CoreTimes, EnergyMeter
from nnpp_edge.profiling.profile_cases import Ground, Question, Sheet
from nnpp_edge.profiling.profile_file import Device, Load, Networks
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.planner import Planner

EXACT = "astar"
HALVES = 2
_PASSED_OVER = 20
"""Times as many maps as are needed are looked at for queries that have a path."""


@dataclass(frozen=True)
class Contender:
    """A planner under its name in the report."""

    name: str
    method: Method
    model: NetworkModel | None


@dataclass
class Answers:
    """What one planner did on the queries of one workload and size. Arrays run over the queries, in order."""

    middle_ms: list[list[float]] = field(default_factory=lambda: [[] for _ in range(HALVES)])
    """For each half, for each query, the time of its middle call; of two calls the faster one."""
    worst_ms: float = 0.0
    """The slowest call of all."""
    stages_ms: list[list[dict[str, float]]] = field(default_factory=lambda: [[] for _ in range(HALVES)])
    """For each half, for each query, the stages of its middle call, and ``other``: what no stage counts."""
    network_ms: list[list[float]] = field(default_factory=lambda: [[] for _ in range(HALVES)])
    """For each half, for each query, the middle time of the whole network on map and query; where there is one."""
    cost: list[float] = field(default_factory=list)
    traverse_cost: list[float] = field(default_factory=list)
    expansions: list[int] = field(default_factory=list)
    sources: list[Source | None] = field(default_factory=list)
    solved: list[bool] = field(default_factory=list)
    energy_j: float = 0.0
    calls: int = 0

    def times(self, half: int | None = None) -> NDArray[np.float64]:
        """Each query's time in milliseconds: in a half, or the mean of both."""
        return np.mean(self.middle_ms, axis=0) if half is None else np.array(self.middle_ms[half])


@dataclass
class Block:
    """One workload and size."""

    workload: str
    size: int
    terrain: str
    asked: list[list[Question]] = field(default_factory=list)
    """Map by map; on some maps no question had a path."""
    answers: dict[str, Answers] = field(default_factory=dict)

    @property
    def questions(self) -> list[Question]:
        """All that were asked, in the order of the answers."""
        return [question for on_map in self.asked for question in on_map]


class Disturbance:
    """What others took while the planners were measured, in one half of the run."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = CoreTimes(cores)
        self._wall_s = self._worked_s = 0.0

    def start(self) -> None:
        """Begin to watch, or go on."""
        self.cores.start()
        self._wall_s -= time.perf_counter()
        self._worked_s -= time.thread_time()

    def stop(self) -> None:
        """Watch no longer."""
        self._worked_s += time.thread_time()
        self._wall_s += time.perf_counter()
        self.cores.stop()

    def leave_out(self, wall_s: float, worked_s: float) -> None:
        """A call in which this thread may have waited for threads of its own."""
        self._wall_s -= wall_s
        self._worked_s -= worked_s

    def waited_share(self) -> float:
        """Share of its time that this thread stood still though it had work to do: beyond its processor time."""
        return max(1.0 - self._worked_s / self._wall_s, 0.0) if self._wall_s > 0.0 else 0.0

    def share(self) -> float:
        """The greater of both signs: the planners stood still, or others ran on the cores."""
        return max(self.waited_share(), self.cores.others_share() or 0.0)


@dataclass
class Run:
    """All that was measured."""

    blocks: list[Block]
    disturbance: list[Disturbance]
    """One for each half."""
    energy_problem: str
    """Why there is no energy; empty where there is."""


def contenders(networks: Networks, device: Device) -> list[Contender]:
    """The planners of a profile; ModelError if a model cannot be loaded."""

    def network(name: str) -> NetworkModel:
        return NetworkModel(name, threads=device.threads, spinning=device.spinning)

    found = [
        Contender(EXACT, Method.ASTAR, None), Contender("corridor", Method.CORRIDOR, None),
        Contender("nnpp", Method.NNPP, network(networks.int8)),
    ]  # fmt: skip
    if networks.fp32 is not None:
        found.append(Contender("nnpp-fp32", Method.NNPP, network(networks.fp32)))
    # a network of its own: one that planners share takes the map over whenever the other has used it
    return [*found, Contender("auto", Method.AUTO, network(networks.int8))]


def run(
    planners: Sequence[Contender],
    load: Load,
    cores: Sequence[int],
    *,
    progress: Callable[[int], None] = lambda done: None,
) -> Run:
    """Put every query to every planner, in both halves of the run.

    Parameters
    ----------
    planners : sequence of Contender
        Exact A* first.
    load : Load
        What is planned.
    cores : sequence of int
        That this process is pinned to: others on them are looked for.
    progress : callable
        Told how many queries are done, of `queries_in`.

    Raises
    ------
    InvalidQueryError
        The terrain has too few queries with a path.

    Notes
    -----
    The second half repeats the first, query by query. So the halves differ by what happened on the machine
    alone, not by what was asked, however few the queries are. What depends on the map alone is made, and every
    planner has answered the map's first query, before the clock starts; within a round planners take turns.
    """
    ground, energy = Ground(load), EnergyMeter()
    blocks: dict[tuple[str, int], Block] = {}
    disturbance = [Disturbance(cores) for _ in range(HALVES)]
    session = _Session(planners, load, energy)
    done = 0
    for half in range(HALVES):
        for name in load.workloads:
            for size in load.sizes:
                block = blocks.setdefault((name, size), Block(name, size, ground.source(size)))
                block.answers = block.answers or {p.name: Answers() for p in planners}
                maps = _asked_before(ground, block) if half else _worth_asking(ground, block, load)
                for sheet, questions in maps:
                    session.ask(sheet, questions, block, half, disturbance[half])
                    progress(done := done + len(questions))
    return Run(list(blocks.values()), disturbance, energy.problem)


def queries_in(load: Load) -> int:
    """How many queries `run` will report as done."""
    return HALVES * len(load.workloads) * len(load.sizes) * (load.queries + load.near)


def _asked_before(ground: Ground, block: Block) -> Iterator[tuple[Sheet, list[Question]]]:
    """The maps of the first half again, with what was asked on them."""
    sheets = ground.sheets(block.workload, block.size)
    return ((sheet, questions) for questions, sheet in zip(block.asked, sheets) if questions)  # noqa: B905


def _worth_asking(ground: Ground, block: Block, load: Load) -> Iterator[tuple[Sheet, list[Question]]]:
    """Maps with the questions on them that have a path, until there are enough; they are booked as asked."""
    room = {True: load.queries, False: load.near}
    for sheet in islice(ground.sheets(block.workload, block.size), _PASSED_OVER * (load.queries + load.near)):
        chosen: list[Question] = []
        scout = Planner(sheet.cost)
        for question in sheet.questions:
            if room[question.judged] and scout.plan(question.start, question.goal, method=Method.CORRIDOR).ok:
                room[question.judged] -= 1
                chosen.append(question)
        block.asked.append(chosen)
        if chosen:
            yield sheet, chosen
        if not any(room.values()):
            return
    raise InvalidQueryError(
        f"wanted {load.queries} queries with a path on maps of {block.size} × {block.size} ({block.workload}), "
        f"found {load.queries - room[True]} on {len(block.asked)} maps"
    )


@dataclass
class _Session:
    """What asking needs besides the question."""

    planners: Sequence[Contender]
    load: Load
    energy: EnergyMeter
    turn: int = 0

    def ask(
        self, sheet: Sheet, questions: list[Question], block: Block, half: int, disturbance: Disturbance
    ) -> None:  # fmt: skip
        """Put the questions on one map to all planners, and book the answers."""
        on_map = {p.name: Planner(sheet.cost, model=p.model or "edge") for p in self.planners}
        first = questions[0]
        for p in self.planners:
            on_map[p.name].plan(first.start, first.goal, method=p.method)  # the map's own work, and warm caches
        disturbance.start()
        for question in questions:
            calls: dict[str, list[tuple[float, Plan]]] = defaultdict(list)
            for _ in range(self.load.repeats):
                self.turn += 1
                shift = self.turn % len(self.planners)
                for p in [*self.planners[shift:], *self.planners[:shift]]:
                    calls[p.name].append(self._call(on_map[p.name], p, question, block, disturbance))
            for name, answered in calls.items():
                _book(block.answers[name], answered, half)
            for p in self.planners:  # last, so that no planner follows what others do not
                if p.method is Method.NNPP and p.model is not None:
                    block.answers[p.name].network_ms[half].append(self._network(p.model, disturbance))
        disturbance.stop()

    def _call(
        self, planner: Planner, p: Contender, question: Question, block: Block, disturbance: Disturbance
    ) -> tuple[float, Plan]:
        joules = self.energy.read()
        worked = time.thread_time()
        began = time.perf_counter()
        plan = planner.plan(question.start, question.goal, method=p.method)
        seconds = time.perf_counter() - began
        worked = time.thread_time() - worked
        if joules:
            block.answers[p.name].energy_j += self.energy.joules(joules, self.energy.read())
        if plan.method is Method.NNPP:
            disturbance.leave_out(seconds, worked)
        return 1e3 * seconds, plan

    @staticmethod
    def _network(model: NetworkModel, disturbance: Disturbance) -> float:
        """Milliseconds of the network on the map and the query that it was shown last, both seen anew."""
        worked = time.thread_time()
        began = time.perf_counter()
        model.run(anew=True)
        seconds = time.perf_counter() - began
        disturbance.leave_out(seconds, time.thread_time() - worked)
        return 1e3 * seconds


def _book(answers: Answers, calls: list[tuple[float, Plan]], half: int) -> None:
    """A query's calls in one half. Plans are the same in both, so the first half's count."""
    answers.calls += len(calls)
    answers.worst_ms = max(answers.worst_ms, *(ms for ms, _ in calls))
    middle_ms, plan = sorted(calls, key=lambda call: call[0])[(len(calls) - 1) // 2]
    stages = {stage: ms for stage, ms in plan.timings_ms.items() if stage != "total"}
    answers.middle_ms[half].append(middle_ms)
    stages["other"] = middle_ms - sum(stages.values())
    answers.stages_ms[half].append(stages)
    if half == 0:
        answers.cost.append(plan.cost)
        answers.traverse_cost.append(plan.traverse_cost)
        answers.expansions.append(plan.expansions)
        answers.sources.append(plan.source)
        answers.solved.append(plan.status is Status.OK)
