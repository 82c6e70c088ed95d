"""Maps with weights over the whole range of float32, planned on by every method and compared with
Dijkstra; patches, moves, goals, interrupts and limits on one planner, which answers as one made
afresh, or refuses.
"""

import contextlib
import dis
import functools
import math
import sys
import traceback

import numpy as np

from nnpp_edge.runtime import DynamicMethod, DynamicPlanner, Planner
from nnpp_edge.runtime.errors import InvalidMapError, NnppEdgeError, Status
from nnpp_edge.runtime.terrain.step_cost import LEAST_WEIGHT, MOST_WEIGHT
from tests import oracles
from tests.fuzz import cases
from tests.fuzz.cases import NOWHERE, Case, Problem, put

_CHECKED_AFTER = {"RESUME", "JUMP_BACKWARD", "CALL", "CALL_FUNCTION_EX", "CALL_KW"}
"""Instructions after which the interpreter looks for signals: nowhere else a KeyboardInterrupt can
come.
"""
_OURS = ("/nnpp_edge/", "/runtime/")
METHODS = ("astar", "corridor", "nnpp", "auto")
MOST_MAPS = 7  # maps that there may be after interrupted patches
TOO_MUCH = 30
FAR_APART = 1e9
"""Expansions a cell that no search of a small map needs, a hundred times as many where weights
lie so far apart that landmarks, which are kept in float32, make a search expand cells again."""


def generate(rng, place=NOWHERE, most_side=40):
    """A map, a planner, and up to some dozens of steps; small maps are drawn as often as large
    ones.

    The step ``interrupted`` holds another step and after how many chances to stop it. `method` is
    that of a `DynamicPlanner`, and empty for a `Planner`.
    """
    shape = tuple(max(int(most_side ** rng.random()), 1) for _ in range(2))
    numbers = np.random.default_rng(rng.getrandbits(32))
    step_cost = rng.choice(("paper", "length"))
    wild = rng.random() < 0.4
    cost = draw_costs(rng, numbers, shape, step_cost, wild)
    blocked = numbers.random(shape) < rng.choice((0.0, 0.0, 0.1, 0.3, 0.5))
    way = rng.choice((np.inf, np.nan, "masked"))
    with np.errstate(over="ignore", under="ignore"):
        cost = cost.astype(rng.choice((np.float32, np.float32, np.float64)))
    if way == "masked":
        cost = np.ma.masked_array(cost, blocked)
    else:
        cost[blocked] = way
    methods = rng.choice((METHODS, *[tuple(DynamicMethod)] * 2))

    def cell():
        return rng.randrange(shape[0]), rng.randrange(shape[1])

    def step():
        kind = rng.choices(("update", "plan", "move", "goal", "prepare"), (5, 6, 2, 1, 0.7))[0]
        if kind == "update":
            sides = [min(rng.choice((1, 1, 2, 4, 12, 40)), most) for most in shape]
            row, col = (rng.randrange(m - n + 1) for m, n in zip(shape, sides, strict=True))
            patch = draw_costs(rng, numbers, sides, step_cost, wild)
            if step_cost == "length":
                patch = np.where(patch < np.inf, np.clip(patch, LEAST_WEIGHT, MOST_WEIGHT), patch)
            return "update", (row, col, patch.astype(np.float32))
        if kind == "plan":
            limit = rng.choices((math.inf, 0.0, 1e-5, 1e-4, 1e-3), (12, 1, 1, 1, 1))[0]
            return "plan", (rng.choice(methods), limit, rng.choice((math.inf, math.inf, 0.0, 0.1)))
        return kind, cell()

    steps = [step() for _ in range(rng.choice((1, 1, 4, 10, 25)))]
    return Case(
        cost=cost,
        start=cell(),
        goal=cell(),
        step_cost=step_cost,
        corner_cutting=rng.random() < 0.5,
        omega=rng.choice((0.011, 0.011, 0.0, 1e-9, 1.0, 1e3)),
        method="" if methods is METHODS else rng.choice(methods).value,
        steps=[
            ("interrupted", (step, int(10 ** rng.uniform(0.0, 2.8))))
            if rng.random() < 0.3
            else step
            for step in steps
        ],
    )


def draw_costs(rng, numbers, shape, step_cost, wild):
    """Traversability costs, some of 1 and more, which are impassable; or weights, which `wild` are
    of one size or of up to 68 decades, a few of them far from the others, seldom out of range.
    """
    share = numbers.random(shape)
    alike = np.full(shape, share[0, 0])
    wall = np.full(shape, np.inf)
    if step_cost == "paper":
        return rng.choice(
            (
                *(share, share, share, 0.01 * share, alike, wall),
                10.0 ** (-45.0 * share),
                1.0 - 10.0 ** (-1.0 - 8.0 * share),
                np.where(share < 0.7, rng.choice((0.0, -0.0)), share),
                np.where(share > 0.9, share * 10.0 ** rng.uniform(0.0, 37.0), share),
            )
        )
    if not wild:
        steep = 10.0 ** (rng.choice((-6.0, -2.0)) * share)
        values = rng.choice((share, share, 0.01 * share, steep, alike, wall))
        return values * 10.0 ** rng.choice((0.0, 0.0, 0.0, 3.0, 9.0, -20.0)) + 1e-30
    if rng.random() < 0.3:
        share = np.round(rng.choice((0, 3, 40)) * share) / 40.0  # equal, or in levels
    spread = rng.choice((1e-6, 0.1, 0.5, 3.0, 12.0, 20.0, 50.0, 68.0))
    values = 10.0 ** (rng.uniform(-40.0, 32.0 - 0.9 * spread) + spread * share)
    for _ in range(rng.choice((0, 0, 1, 3, 5))):
        values[rng.randrange(shape[0]), rng.randrange(shape[1])] *= 10.0 ** rng.uniform(-30.0, 30.0)
    return values if rng.random() < 0.1 else np.clip(values, LEAST_WEIGHT, MOST_WEIGHT)


@functools.cache
def _operations(code):
    """Name of the instruction at each place of a function."""
    return {found.offset: found.opname for found in dis.get_instructions(code)}


@contextlib.contextmanager
def interrupting(after):
    """Raise a KeyboardInterrupt at the `after`-th place in our code where a signal could raise one.

    Gives a list that holds the place once it was raised.
    """
    left = after
    where = []
    child_returned = False

    def begin(frame, event, argument):
        file = frame.f_code.co_filename
        operations = _operations(frame.f_code)
        before = -1
        if left <= 0 or not any(part in file for part in _OURS) or "/kernels/" in file:
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False

        def trace(frame, event, argument):
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

    def __init__(self, case, place):
        self.case = case
        self.place = place
        self.start = case.start
        self.goal = case.goal
        self.cost = case.cost
        self.maps = []
        """What else the map may be, since a patch was interrupted."""
        self.interrupted = []
        self.settings = {
            name: getattr(case, name) for name in ("step_cost", "corner_cutting", "omega")
        }
        self.planner = self.fresh()
        with np.errstate(over="ignore", under="ignore"):
            self.cost = np.ma.filled(case.cost, np.inf).astype(np.float32)

    def fresh(self):
        """A planner of the map as it is."""
        settings = self.settings | {"model": self.place.model}
        self.interrupted = []
        self.maps = []
        if not self.case.method:
            return Planner(self.cost.copy(), ask_from=0, **settings)
        planner = DynamicPlanner(self.cost.copy(), self.goal, self.case.method, **settings)
        planner.move(self.start)
        return planner

    def weights_apart(self):
        """The greatest factor between weights above 0 of any map that there may be."""
        return max(
            float(weights.max() / weights.min()) if weights.size else 1.0
            for seen in (seen_by_planner(each, self.case.step_cost) for each in self.all_maps())
            for weights in (seen[np.isfinite(seen) & (seen > 0.0)],)
        )

    def all_maps(self):
        """All that the map may be."""
        return [self.cost, *self.maps]

    def do(self, step):
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

    def _wrote(self, row, col, patch):
        """A patch lies in the map for certain."""
        for known in self.all_maps():
            put(known, row, col, patch)
        others = (each for each in self.maps if not np.array_equal(each, self.cost))
        self.maps = [*{other.tobytes(): other for other in others}.values()]
        if len(self.maps) > MOST_MAPS:  # too many to tell them apart: the whole map is put anew
            self.planner.update(0, 0, self.cost)
            self.maps = []

    def _interrupted(self, step, after):
        """Do a step that may be interrupted on the way."""
        problem = None
        with interrupting(after) as where, contextlib.suppress(KeyboardInterrupt):
            problem = self.do(step)
        if not where:
            return problem
        self.interrupted += where
        kind, value = step
        if kind == "update":
            # the patch may lie in the map or not; put again, it lies there for certain
            written = [known.copy() for known in self.all_maps()]
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

    def _plan(self, method, limit, epsilon):
        if self.case.method:
            plan = self.planner.replan(method=method, time_limit_s=limit)
            epsilon = math.inf
        else:
            ends = self.start, self.goal
            plan = self.planner.plan(*ends, method=method, time_limit_s=limit, epsilon=epsilon)
        if plan.status is Status.TIMEOUT and limit < math.inf:
            return None
        problems = [
            problem_with_plan(
                plan,
                seen_by_planner(cost, self.case.step_cost),
                self.start,
                self.goal,
                **self.settings,
                exact=method in ("astar", "dstar") or epsilon == 0.0,
                epsilon=epsilon if limit == math.inf else math.inf,
                most_expansions=100 * TOO_MUCH if self.weights_apart() > FAR_APART else TOO_MUCH,
                told=f"by {method}, {self.start} to {self.goal}; interrupted at {self.interrupted}",
            )
            for cost in self.all_maps()
        ]
        found = [problem for problem in problems if problem]
        if len(found) < len(problems):
            return None
        kinds = dict.fromkeys(problem.kind for problem in found)  # on each map that there may be
        return Problem(" or ".join(kinds), "\n\n".join(problem.detail for problem in found))


def check(case, place=NOWHERE):
    """Do all steps; in the end ask once more by each exact method."""
    lengths = case.step_cost == "length"
    given = np.ma.filled(np.ma.asarray(case.cost, np.float64), np.inf)
    given = given[np.isfinite(given)]  # some are beyond what a float32 holds
    most = np.float64(np.float32(MOST_WEIGHT)) if lengths else np.finfo(np.float32).max
    out_of_range = (given > most).any() or (lengths and (given < LEAST_WEIGHT).any())
    try:
        driver = Driver(case, place)
    except InvalidMapError as error:
        return None if out_of_range else Problem("a map is refused", f"{error}\n{case!r}")
    if out_of_range:
        return Problem("weights out of range are taken", repr(case))
    exact = tuple(DynamicMethod) if case.method else ("astar",)
    for step in (*case.steps, *(("plan", (name, math.inf, 0.0)) for name in exact)):
        told = f"at {step}, interrupted at {driver.interrupted}"
        try:
            problem = driver.do(step)
        except Exception as error:
            if isinstance(error, NnppEdgeError) and driver.interrupted:
                # an interrupted planner may refuse until it is made anew; the map is what it was,
                # or has the patch
                driver.planner = driver.fresh()
                continue
            problem = Problem(f"raised {type(error).__name__}", traceback.format_exc())
        if problem is not None:
            after = " after an interrupt" if driver.interrupted else ""
            return Problem(problem.kind + after, f"{told}\n{problem.detail}\n{case!r}")
    return None


def seen_by_planner(cost, step_cost):
    """The costs in float64 as the planner must take them: rounded to float32, impassable as inf."""
    with np.errstate(over="ignore", under="ignore"):
        seen = np.ma.filled(np.ma.asarray(cost, np.float64), np.inf).astype(np.float32)
    return np.where(seen < (1.0 if step_cost == "paper" else np.inf), seen, np.inf).astype(float)


def problem_with_plan(
    plan,
    seen,
    start,
    goal,
    *,
    step_cost="paper",
    corner_cutting=True,
    omega=0.011,
    exact,
    epsilon=math.inf,
    most_expansions=TOO_MUCH,
    told="",
):
    """What is wrong with an answer on a map whose costs are `seen`."""
    if plan.expansions > most_expansions * seen.size + 1000:
        each = f"{plan.expansions / seen.size:.0f} expansions a cell"
        return Problem(f"{each}: {plan.planner}", f"{plan}\n{told}")
    return cases.problem_with_plan(
        plan,
        np.isfinite(seen),
        (start, goal),
        lambda *ends: oracles.cheapest(seen, *ends, step_cost, corner_cutting, omega),
        lambda path: oracles.path_problem(path, seen, start, goal, corner_cutting),
        lambda path: oracles.path_cost(path, seen, step_cost, omega),
        exact=exact,
        epsilon=epsilon,
        told=told,
    )
