"""Patches, moves, goals, interrupts and limits on one planner: it answers as one made afresh, or
refuses.
"""

import contextlib
import dis
import functools
import math
import random
import sys
import traceback
from collections.abc import Iterator
from types import CodeType, FrameType
from typing import Any

import numpy as np

from nnpp_edge.runtime import DynamicPlanner, Planner
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status
from nnpp_edge.runtime.planners.plan import DynamicMethod
from tests.fuzz.cases import NOWHERE, Case, Place, Problem
from tests.fuzz.elevations import put
from tests.fuzz.weights import (
    FAR_APART,
    METHODS,
    TOO_MUCH,
    apart,
    problem_with_plan,
    seen_by_planner,
)

_CHECKED_AFTER = {"RESUME", "JUMP_BACKWARD", "CALL", "CALL_FUNCTION_EX", "CALL_KW"}
"""Instructions after which the interpreter looks for signals: nowhere else a KeyboardInterrupt can
come.
"""
_OURS = ("/nnpp_edge/", "/runtime/")
MOST_MAPS = 7  # maps that there may be after interrupted patches
# factor between weights up to which D* Lite never refuses; it says that it does from about 1e15 on
MOST_APART = 1e12
Step = tuple[str, Any]


def generate(rng: random.Random, place: Place = NOWHERE, most_side: int = 40) -> Case:
    """A map, a planner, and up to some dozens of steps.

    The step ``interrupted`` holds another step and after how many chances to stop it. `method` is
    that of a `DynamicPlanner`, and empty for a `Planner`.
    """
    rows = rng.randrange(2, most_side)
    cols = rng.randrange(2, most_side)
    step_cost = rng.choice(("paper", "paper", "length"))
    numbers = np.random.default_rng(rng.getrandbits(32))
    cost = _patch(rng, numbers, rows, cols, step_cost)
    cost[numbers.random(cost.shape) < rng.choice((0.0, 0.1, 0.3))] = np.inf
    dynamic = rng.random() < 0.75
    method = rng.choice(list(DynamicMethod)).value if dynamic else ""
    steps: list[Step] = []
    for _ in range(rng.choice((4, 10, 25))):
        step = _step(
            rng, numbers, rows, cols, step_cost, tuple(DynamicMethod) if dynamic else METHODS
        )
        steps.append(
            ("interrupted", (step, int(10 ** rng.uniform(0.0, 2.8))))
            if rng.random() < 0.3
            else step
        )
    return Case(
        cost=cost,
        step_cost=step_cost,
        corner_cutting=rng.random() < 0.5,
        method=method,
        steps=steps,
    )


def _step(
    rng: random.Random,
    numbers: np.random.Generator,
    rows: int,
    cols: int,
    step_cost: str,
    methods: tuple[str, ...],
) -> Step:
    kind = rng.choices(("update", "plan", "move", "goal", "prepare"), (5, 6, 2, 1, 0.4))[0]
    if kind == "update":
        height, width = (min(rng.choice((1, 1, 2, 4, 12, 40)), most) for most in (rows, cols))
        row = rng.randrange(rows - height + 1)
        col = rng.randrange(cols - width + 1)
        return "update", (row, col, _patch(rng, numbers, height, width, step_cost))
    if kind == "plan":
        limit = rng.choices((math.inf, 0.0, 1e-5, 1e-4, 1e-3), (12, 1, 1, 1, 1))[0]
        return "plan", (rng.choice(methods), limit, rng.choice((math.inf, math.inf, 0.0, 0.1)))
    return kind, (rng.randrange(rows), rng.randrange(cols))


def _patch(
    rng: random.Random, numbers: np.random.Generator, rows: int, cols: int, step_cost: str
) -> np.ndarray:
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


@functools.cache
def _operations(code: CodeType) -> dict[int, str]:
    """Name of the instruction at each place of a function."""
    return {found.offset: found.opname for found in dis.get_instructions(code)}


@contextlib.contextmanager
def interrupting(after: int) -> Iterator[list[str]]:
    """Raise a KeyboardInterrupt at the `after`-th place in our code where a signal could raise one.

    Gives a list that holds the place once it was raised.
    """
    left = after
    where = []
    child_returned = False

    def begin(frame: FrameType, event: str, argument: Any) -> Any:
        file = frame.f_code.co_filename
        operations = _operations(frame.f_code)
        before = -1
        if left <= 0 or not any(part in file for part in _OURS) or "/kernels/" in file:
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False

        def trace(frame: FrameType, event: str, argument: Any) -> Any:
            nonlocal left, child_returned, before
            if event == "return":
                child_returned = True
            if event != "opcode":
                return trace
            last = operations.get(before, "RESUME" if before < 0 else "")
            by_c = not (child_returned and last.startswith("CALL"))
            before = frame.f_lasti
            child_returned = False
            at_start = operations.get(frame.f_lasti) in ("RESUME", "CACHE", "PRECALL")
            if last in _CHECKED_AFTER and by_c and not at_start:
                left -= 1
                if left == 0:
                    where.append(f"{file}:{frame.f_lineno} {frame.f_code.co_name}")
                    sys.settrace(None)
                    raise KeyboardInterrupt
            return trace

        return trace

    earlier = sys.gettrace()
    sys.settrace(begin)
    try:
        yield where
    finally:
        sys.settrace(earlier)


class Driver:
    """Does a case's steps with one planner, and keeps what the map must be."""

    def __init__(self, case: Case, place: Place) -> None:
        self.case = case
        self.place = place
        self.cost = case.cost.copy()
        self.start = (0, 0)
        self.goal = (case.cost.shape[0] - 1, case.cost.shape[1] - 1)
        self.maps: list[np.ndarray] = []
        """What else the map may be, since a patch was interrupted."""
        self.interrupted: list[str] = []
        self.planner = self.fresh()

    def fresh(self) -> Any:
        """A planner of the map as it is."""
        case = self.case
        cost = self.cost.copy()
        settings = {
            "step_cost": case.step_cost,
            "corner_cutting": case.corner_cutting,
            "model": self.place.model,
        }
        if not case.method:
            return Planner(cost, ask_from=0, **settings)
        planner = DynamicPlanner(cost, self.goal, case.method, **settings)
        planner.move(self.start)
        return planner

    def weights_apart(self) -> float:
        """The greatest factor between weights of any map that there may be."""
        return max(
            apart(seen_by_planner(cost, self.case.step_cost)) for cost in (self.cost, *self.maps)
        )

    def do(self, step: Step) -> Problem | None:
        """One step; what is wrong with its answer."""
        kind, value = step
        if kind in ("interrupted", "plan"):
            return self._plan(*value) if kind == "plan" else self._interrupted(*value)
        if kind == "update":
            self.planner.update(*value)
            self._wrote(*value)
        elif kind == "prepare":
            self.planner.prepare(**({} if self.case.method else {"landmarks": 2}))
        elif kind == "move":
            self.start = value
        else:
            self.goal = value
        if kind in ("move", "goal") and self.case.method:
            (self.planner.move if kind == "move" else self.planner.set_goal)(value)
        return None

    def _wrote(self, row: int, col: int, patch: np.ndarray) -> None:
        """A patch lies in the map for certain."""
        for known in (self.cost, *self.maps):
            put(known, row, col, patch)
        different = {
            other.tobytes(): other for other in self.maps if not np.array_equal(other, self.cost)
        }
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
        if (
            kind == "update"
        ):  # the patch may lie in the map or not; put again, it lies there for certain
            written = [known.copy() for known in (self.cost, *self.maps)]
            for other in written:
                put(other, *value)
            self.maps += written
            if after % 2 or len(self.maps) > MOST_MAPS:
                self.planner.update(*value)
                self._wrote(*value)
        elif kind in ("goal", "move") and self.case.method:
            self.planner.set_goal(self.goal)
            self.planner.move(self.start)
        return None

    def _plan(self, method: str, limit: float, epsilon: float) -> Problem | None:
        case = self.case
        if case.method:
            plan = self.planner.replan(method=method, time_limit_s=limit)
            epsilon = math.inf
        else:
            plan = self.planner.plan(
                self.start, self.goal, method=method, time_limit_s=limit, epsilon=epsilon
            )
        if plan.status is Status.TIMEOUT and limit < math.inf:
            return None
        problems = [
            problem_with_plan(
                plan,
                seen_by_planner(cost, case.step_cost),
                self.start,
                self.goal,
                step_cost=case.step_cost,
                corner_cutting=case.corner_cutting,
                exact=method in ("astar", "dstar") or epsilon == 0.0,
                epsilon=epsilon if limit == math.inf else math.inf,
                most_expansions=100 * TOO_MUCH if self.weights_apart() > FAR_APART else TOO_MUCH,
                told=f"by {method}, {self.start} to {self.goal}; interrupted at {self.interrupted}",
            )
            for cost in (self.cost, *self.maps)
        ]
        found = [problem for problem in problems if problem]
        if len(found) < len(problems):
            return None
        kinds = dict.fromkeys(problem.kind for problem in found)  # on each map that there may be
        return Problem(" or ".join(kinds), "\n\n".join(problem.detail for problem in found))


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Do all steps; in the end ask once more by each exact method."""
    driver = Driver(case, place)
    last = [
        ("plan", (name, math.inf, 0.0))
        for name in (tuple(DynamicMethod) if case.method else ("astar",))
    ]
    for step in (*case.steps, *last):
        told = f"at {step}, interrupted at {driver.interrupted}"
        try:
            problem = driver.do(step)
        except NnppEdgeError as error:
            far_apart = isinstance(error, InvalidMapError) and driver.weights_apart() > MOST_APART
            if not (driver.interrupted or far_apart):
                return Problem(
                    f"refused: {type(error).__name__}",
                    f"{told}\n{traceback.format_exc()}\n{case!r}",
                )
            # an interrupted planner may refuse until it is made anew; the map is what it was, or
            # has the patch
            driver.interrupted = []
            driver.maps = []
            driver.planner = driver.fresh()
            continue
        except Exception as error:
            return Problem(
                f"raised {type(error).__name__}", f"{told}\n{traceback.format_exc()}\n{case!r}"
            )
        if problem is not None:
            after = " after an interrupt" if driver.interrupted else ""
            return Problem(problem.kind + after, f"{told}\n{problem.detail}\n{case!r}")
    return None
