"""Patches, moves, goals, interrupts and limits on one planner: it answers as one made afresh, or refuses."""

import contextlib
import dis
import math
import random
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

from nnpp_edge.runtime import DynamicPlanner, Planner
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status
from nnpp_edge.runtime.planners.plan import DynamicMethod
from tests.fuzz.commands import Problem
from tests.fuzz.weights import FAR_APART, METHODS, TOO_MUCH, apart, problem_with_plan, seen_by_planner, small_model

NAME = "sequences"
_CHECKED_AFTER = {"RESUME", "JUMP_BACKWARD", "CALL", "CALL_FUNCTION_EX", "CALL_KW"}
"""Instructions after which the interpreter looks for signals: nowhere else a KeyboardInterrupt can come."""
_OURS = ("/nnpp_edge/", "/runtime/")
MOST_MAPS = 7
"""Maps that there may be after interrupted patches."""
MOST_APART = 1e12
"""Factor between weights up to which D* Lite never refuses; it says that it does from about 1e15 on."""
Step = tuple[str, Any]
"""What is done, with its arguments; ``interrupted`` holds another step and after how many chances to stop it."""


@dataclass(frozen=True)
class Case:
    """A map, a planner, and what is done with it."""

    cost: np.ndarray
    step_cost: str
    corner_cutting: bool
    method: str
    """Of a `DynamicPlanner`; empty for a `Planner`."""
    also: tuple[str, ...]
    steps: tuple[Step, ...]

    def __repr__(self) -> str:
        """Long patches cut."""
        facts = {name: value for name, value in vars(self).items() if name not in ("steps", "cost")}
        with np.printoptions(threshold=60, linewidth=200):
            return "\n".join([f"{facts} {self.cost.shape}", *(f"  {step}" for step in self.steps)])


def generate(rng: random.Random, most_side: int = 40) -> Case:
    """A case of up to some dozens of steps."""
    rows, cols = rng.randrange(2, most_side), rng.randrange(2, most_side)
    step_cost = rng.choice(("paper", "paper", "length"))
    numbers = np.random.default_rng(rng.getrandbits(32))
    cost = _patch(rng, numbers, rows, cols, step_cost)
    cost[numbers.random(cost.shape) < rng.choice((0.0, 0.1, 0.3))] = np.inf
    dynamic = rng.random() < 0.75
    method = rng.choice(list(DynamicMethod)).value if dynamic else ""
    also = tuple(other.value for other in DynamicMethod if rng.random() < 0.4) if dynamic else ()
    steps: list[Step] = []
    for _ in range(rng.choice((4, 10, 25))):
        step = _step(rng, numbers, rows, cols, step_cost, (method, *also) if dynamic else METHODS)
        if rng.random() < 0.3:
            step = ("interrupted", (step, int(10 ** rng.uniform(0.0, 2.8))))
        steps.append(step)
    return Case(cost, step_cost, rng.random() < 0.5, method, also, tuple(steps))


def _step(
    rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, step_cost: str, methods: tuple[str, ...]
) -> Step:
    cell = rng.randrange(rows), rng.randrange(cols)
    kind = rng.choices(("update", "plan", "move", "goal", "prepare", "odd"), (5, 6, 2, 1, 0.4, 0.6))[0]
    if kind == "update":
        height, width = (min(rng.choice((1, 1, 2, 4, 12, 40)), most) for most in (rows, cols))
        row, col = rng.randrange(rows - height + 1), rng.randrange(cols - width + 1)
        return "update", (row, col, _patch(rng, numbers, height, width, step_cost))
    if kind == "plan":
        limit = rng.choices((math.inf, 0.0, 1e-5, 1e-4, 1e-3), (12, 1, 1, 1, 1))[0]
        return "plan", (rng.choice(methods), limit, rng.choice((math.inf, math.inf, 0.0, 0.1)))
    return kind, cell


def _patch(rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, step_cost: str) -> np.ndarray:
    kind = rng.choice(("any", "any", "wall", "same", "steep", "clear"))
    values = numbers.random((rows, cols))
    if kind == "wall":
        values[:] = np.inf
    elif kind == "same":
        values[:] = rng.choice((0.1, 0.5, 0.9))
    elif kind == "steep":
        values = 10.0 ** (rng.choice((-6.0, -2.0, 0.0)) * values)
    elif kind == "clear":
        values *= 0.01
    if step_cost == "length":
        values = values * 10.0 ** rng.choice((0.0, 0.0, 0.0, 3.0, 9.0, -20.0)) + 1e-30
    return values.astype(np.float32)


@contextlib.contextmanager
def interrupting(after: int) -> Iterator[list[str]]:
    """Raise a KeyboardInterrupt at the `after`-th place in our code where a signal could raise one.

    Gives a list that holds the place once it was raised.
    """
    left, where, child_returned = [after], [], [False]

    def local(frame: FrameType) -> Callable[[FrameType, str, Any], Any]:
        before = [-1]
        operations = _operations(frame.f_code)

        def trace(frame: FrameType, event: str, argument: Any) -> Any:
            if event == "return":
                child_returned[0] = True
                return trace
            if event != "opcode":
                return trace
            last = operations.get(before[0], "RESUME" if before[0] < 0 else "")
            by_c = not (child_returned[0] and last.startswith("CALL"))
            before[0] = frame.f_lasti
            child_returned[0] = False
            if (
                last in _CHECKED_AFTER
                and by_c
                and operations.get(frame.f_lasti) not in ("RESUME", "CACHE", "PRECALL")
            ):
                left[0] -= 1
                if left[0] == 0:
                    where.append(f"{frame.f_code.co_filename}:{frame.f_lineno} {frame.f_code.co_name}")
                    sys.settrace(None)
                    raise KeyboardInterrupt
            return trace

        return trace

    def begin(frame: FrameType, event: str, argument: Any) -> Any:
        if (
            left[0] <= 0
            or not any(part in frame.f_code.co_filename for part in _OURS)
            or "/kernels/" in frame.f_code.co_filename
        ):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        return local(frame)

    earlier = sys.gettrace()
    sys.settrace(begin)
    try:
        yield where
    finally:
        sys.settrace(earlier)


_KNOWN: dict[CodeType, dict[int, str]] = {}


def _operations(code: CodeType) -> dict[int, str]:
    """Name of the instruction at each place of a function."""
    if code not in _KNOWN:
        _KNOWN[code] = {found.offset: found.opname for found in dis.get_instructions(code)}
    return _KNOWN[code]


class Driver:
    """Does a case's steps with one planner, and keeps what the map must be."""

    def __init__(self, case: Case, folder: Path | None) -> None:
        self.case, self.folder = case, folder
        rows, cols = case.cost.shape
        self.cost = case.cost.copy()
        self.start, self.goal = (0, 0), (rows - 1, cols - 1)
        self.planner = self.fresh()
        self.maps: list[np.ndarray] = []
        """What else the map may be, since a patch was interrupted."""
        self.interrupted: list[str] = []

    def fresh(self) -> Any:
        """A planner of the map as it is."""
        case, cost = self.case, self.cost.copy()
        settings = {
            "step_cost": case.step_cost,
            "corner_cutting": case.corner_cutting,
            "model": small_model(self.folder),
        }
        if not case.method:
            return Planner(cost, ask_from=0, **settings)
        planner = DynamicPlanner(cost, self.goal, case.method, also=case.also, **settings)
        planner.move(self.start)
        return planner

    def weights_apart(self) -> float:
        """The greatest factor between weights of any map that there may be."""
        return max(apart(seen_by_planner(cost, self.case.step_cost)) for cost in (self.cost, *self.maps))

    def do(self, step: Step) -> Problem | None:
        """One step; what is wrong with its answer."""
        kind, value = step
        if kind == "interrupted":
            return self._interrupted(*value)
        if kind == "update":
            row, col, patch = value
            self.planner.update(row, col, patch)
            self._wrote(row, col, patch)
        elif kind == "plan":
            return self._plan(*value)
        elif kind == "move":
            self.start = value
            if self.case.method:
                self.planner.move(value)
        elif kind == "goal":
            self.goal = value
            if self.case.method:
                self.planner.set_goal(value)
        elif kind == "prepare":
            self.planner.prepare() if self.case.method else self.planner.prepare(landmarks=2)
        else:
            return self._odd(value)
        return None

    def _wrote(self, row: int, col: int, patch: np.ndarray) -> None:
        """A patch lies in the map for certain."""
        here = (slice(row, row + patch.shape[0]), slice(col, col + patch.shape[1]))
        self.cost[here] = patch
        for other in self.maps:
            other[here] = patch
        different = {other.tobytes(): other for other in self.maps if not np.array_equal(other, self.cost)}
        self.maps = list(different.values())
        if len(self.maps) > MOST_MAPS:  # too many to tell them apart: the whole map is put anew
            self.planner.update(0, 0, self.cost)
            self.maps = []

    def _interrupted(self, step: Step, after: int) -> Problem | None:
        """Do a step that may be interrupted on the way."""
        problem = None
        with interrupting(after) as where, contextlib.suppress(KeyboardInterrupt):
            problem = self.do(step)
        if not where:
            return problem
        self.interrupted += where
        kind, value = step
        if kind == "update":  # the patch may lie in the map or not; put again, it lies there for certain
            row, col, patch = value
            for known in (self.cost, *self.maps):
                other = known.copy()
                other[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
                self.maps = [*self.maps, other]
            if after % 2 or len(self.maps) > MOST_MAPS:
                self.planner.update(row, col, patch)
                self._wrote(row, col, patch)
        elif kind in ("goal", "move") and self.case.method:
            self.planner.set_goal(self.goal)
            self.planner.move(self.start)
        return None

    def _plan(self, method: str, limit: float, epsilon: float) -> Problem | None:
        if self.case.method:
            plan = self.planner.replan(method=method, time_limit_s=limit)
            epsilon = math.inf
        else:
            plan = self.planner.plan(self.start, self.goal, method=method, time_limit_s=limit, epsilon=epsilon)
        if plan.status is Status.TIMEOUT and limit < math.inf:
            return None
        problems = [
            problem_with_plan(
                plan,
                seen_by_planner(cost, self.case.step_cost),
                self.start,
                self.goal,
                step_cost=self.case.step_cost,
                corner_cutting=self.case.corner_cutting,
                exact=method in ("astar", "dstar") or epsilon == 0.0,
                epsilon=epsilon if limit == math.inf else math.inf,
                most_expansions=100 * TOO_MUCH if self.weights_apart() > FAR_APART else TOO_MUCH,
                told=f"by {method}, {self.start} to {self.goal}; interrupted at {self.interrupted}",
            )
            for cost in (self.cost, *self.maps)
        ]
        if not all(problems):
            return None
        kinds = dict.fromkeys(problem.kind for problem in problems if problem)  # on each map that there may be
        return Problem(" or ".join(kinds), "\n\n".join(problem.detail for problem in problems if problem))

    def _odd(self, cell: tuple[int, int]) -> Problem | None:
        """What makes no sense is refused by an error of the toolkit, and changes nothing."""
        rows, cols = self.cost.shape
        junk = np.full((1, 1), 0.5, np.float32)
        below = np.full((1, 1), -1.0, np.float32)
        calls: tuple[Callable[[], object], ...] = (
            lambda: self.planner.update(*cell, below),
            lambda: self.planner.update(rows, cols, junk),
            lambda: self.planner.update(-1, 0, junk),
            lambda: self.planner.update(0.5, 0, junk),
            lambda: self.planner.update(math.inf, 0, junk),
            lambda: self.planner.update(0, 0, np.zeros((0, 3), np.float32)),
            lambda: self.planner.update(0, 0, np.zeros((2, 2), np.complex64)),
        )
        if self.case.method:
            calls += (
                lambda: self.planner.move((math.inf, 0)),
                lambda: self.planner.set_goal((0, math.nan)),
                lambda: self.planner.replan(time_limit_s=math.nan),
                lambda: self.planner.replan(method="nope"),
            )
        else:
            calls += (
                lambda: self.planner.plan((math.inf, 0), cell),
                lambda: self.planner.plan(cell, cell, time_limit_s=math.nan),
                lambda: self.planner.plan(cell, cell, epsilon=-1.0),
                lambda: self.planner.nearest(cell, [cell], count=0),
                lambda: self.planner.plan(cell, cell, method="nope"),
            )
        for number, call in enumerate(calls):
            with contextlib.suppress(NnppEdgeError):
                call()
                return Problem(
                    f"nonsense was taken: call {number} of a {type(self.planner).__name__}", repr(self.case)
                )
        return None


def check(case: Case, samples: Path | None = None) -> Problem | None:
    """Do all steps; in the end ask once more by each exact method."""
    driver = Driver(case, samples)
    last = [("plan", (name, math.inf, 0.0)) for name in ({case.method, *case.also} if case.method else ("astar",))]
    for step in (*case.steps, *last):
        try:
            problem = driver.do(step)
        except NnppEdgeError as error:
            if not driver.interrupted and not (
                isinstance(error, InvalidMapError) and driver.weights_apart() > MOST_APART
            ):
                return Problem(
                    f"refused: {type(error).__name__}", f"{error} at {step}\n{traceback.format_exc()}\n{case!r}"
                )
            # an interrupted planner may refuse until it is made anew; the map is what it was, or has the patch
            driver.interrupted, driver.maps = [], []
            driver.planner = driver.fresh()
            continue
        except KeyboardInterrupt:
            raise
        except Exception as error:
            told = f"at {step}, interrupted at {driver.interrupted}\n{traceback.format_exc()}\n{case!r}"
            return Problem(f"raised {type(error).__name__}", told)
        if problem is not None:
            after = " after an interrupt" if driver.interrupted else ""
            return Problem(problem.kind + after, f"at {step}\n{problem.detail}\n{case!r}")
    return None
