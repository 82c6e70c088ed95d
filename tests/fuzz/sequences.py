"""Robots and maps of `tests.worlds` and odder ones, on which one planner does what comes: plans by
every method, patches, moves, goals, time limits and interrupts. Answers are held to Dijkstra's, and
to those of a planner that computed all beforehand.
"""

import contextlib
import dis
import functools
import math
import random
import sys
from operator import methodcaller
from unittest import mock

import numpy as np

from nnpp_edge.runtime import DynamicMethod, Method, NnppEdgeError, Status
from nnpp_edge.runtime.options import METHODS
from tests import pose_oracles
from tests.fuzz import bodies
from tests.strategies import KINDS, random_cell, random_costs
from tests.worlds import OMEGA, BodyWorld, World, same_maps

# --- interrupts


_CHECKED_AFTER = {"RESUME", "JUMP_BACKWARD", "CALL", "CALL_FUNCTION_EX", "CALL_KW"}
"""Instructions after which the interpreter looks for signals: nowhere else a KeyboardInterrupt can
come.
"""
_OURS = ("/nnpp_edge/", "/runtime/")


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


# --- maps


EXACT = 3e-5
"""Share by which a path may cost more than Dijkstra's: g is kept in float32, over hundreds of
steps.
"""
FAR_APART = 1e9
TOO_MUCH = {False: 30, True: 3000}
"""Expansions a cell that no search of a small map needs, and where weights lie so far apart that
landmarks, which are kept in float32, make a search expand cells again.
"""


class OddCosts(World):
    """A point on costs of which some are odd."""

    def __init__(self, rng):
        step_cost = str(rng.choice(("paper", "length")))
        shape = tuple(int(40 ** rng.random()) for _ in range(2))
        costs = self.drawn(rng, shape, step_cost)
        super().__init__(rng, (None, costs), (1.0, 1.0), step_cost=step_cost)
        self.omega = float(rng.choice((OMEGA, OMEGA, 0.0, 1e-9, 1.0, 1e3)))

    def drawn(self, rng, shape, step_cost):
        """Costs, some of them impassable."""
        kind = rng.choice((*KINDS, *["any"] * 6))
        wall = rng.choice((np.inf, np.nan, 1e37 if step_cost == "paper" else np.inf))
        return random_costs(rng, shape, step_cost, kind, rng.choice((0.0, 0.1, 0.5)), wall)

    def patch_of_costs(self):
        """As of every world."""
        shape = np.minimum(self.rng.choice((1, 2, 12, 40), 2), self.told.shape)
        row, col = self.rng.integers(np.subtract(self.told.shape, shape) + 1).tolist()
        return row, col, self.drawn(self.rng, shape, self.step_cost)

    def near(self, cost):
        """As of every world."""
        return EXACT * cost + 1e-300

    def judge(self, plan, optimum, epsilon=math.inf):
        """As of every world; and no search expands cells again and again."""
        weights = self.cost[np.isfinite(self.cost) & (self.cost > 0.0)].astype(float)
        far = weights.size > 0 and weights.max() / weights.min() > FAR_APART
        assert plan.expansions <= TOO_MUCH[far] * self.cost.size + 1000, plan
        super().judge(plan, optimum, epsilon)


class OddBody(BodyWorld):
    """A body of one cell to seven, which fits on its map."""

    def __init__(self, rng):
        self.drawn = bodies.generate(random.Random(int(rng.integers(1 << 62))))
        super().__init__(rng, self.drawn.vehicle)
        self.relief_m = self.drawn.vehicle.clearance_m

    def heights(self, rng, vehicle):
        """As of every body."""
        return self.drawn.dem, self.drawn.cell

    def judge(self, plan, optimum, epsilon=math.inf):
        """As of every world; each cell has the heading of the leg that leaves it."""
        super().judge(plan, optimum, epsilon)
        legs = pose_oracles.headings_of(plan.path)
        np.testing.assert_allclose(plan.headings_deg, [*legs, *legs[-1:]], atol=1e-3)


# --- drives


STEPS = {"update": 5, "plan": 6, "move": 2, "set_goal": 1, "prepare": 1}
LIMITED = (0.8, 0.05, 0.05, 0.05, 0.05)


class Drive:
    """Steps of one planner through what a world becomes, and of a second beside it."""

    methods = ("", *DynamicMethod)
    """Of a planner for a map that changes; empty for one of a map that stays."""
    interrupted_share = 0.3

    def __init__(self, world, place):
        self.world = world
        self.rng = world.rng
        self.place = place
        self.start, self.goal = (self.cell() for _ in range(2))
        self.begin, self.end = world.headings()
        self.method = self.rng.choice(self.methods)
        self.alone = self.rng.random() < 0.5
        """Then it is interrupted, and its time is limited, now and then."""
        self.interrupted = []
        self.told = []
        """What was done, a line a step."""
        self.renew()

    def cell(self):
        """Most of them such as one can stand on."""
        often = self.rng.random() < 0.9
        return self.world.cells(1)[0] if often else random_cell(self.rng, self.world.passable.shape)

    def made(self, **options):
        """A planner of the map as it is."""
        if not self.method:
            return self.world.planner(model=self.place.model, ask_from=0, **options)
        made = self.world.planner(self.goal, self.method, model=self.place.model, **options)
        made.set_goal(self.goal, self.world.heading(self.end))
        made.move(self.start, self.world.heading(self.begin))
        return made

    def renew(self):
        """New planners, the second of which computes all beforehand."""
        self.interrupted = []
        self.planners = [self.made()]
        if not self.alone:
            self.planners.append(self.made(lazy=False))

    def run(self, count):
        """Do so many steps, then ask every exact method, and compare the maps."""
        try:
            kinds = self.rng.choice([*STEPS], count, p=np.array([*STEPS.values()]) / 15.0)
            for kind in kinds:
                self.do(str(kind), getattr(self, kind)())
            for method in ("astar", *["dstar"] * bool(self.method)):
                self.do("plan", self.plan(method, math.inf, 0.0))
            self.compare_maps()
        except Exception as error:
            error.add_note("\n".join((repr(vars(self)), repr(vars(self.world)), *self.told)))
            raise

    def do(self, kind, step):
        """Do a step with each planner. What was interrupted is done again; then the planner may
        refuse until it is made anew.
        """
        self.told.append(f"{kind} {step}")
        answers = []
        if step is None:
            return None
        for planner in self.planners:
            after = int(10 ** self.rng.uniform(0.0, 2.8))
            if self.alone and self.rng.random() < self.interrupted_share:
                with interrupting(after) as where, contextlib.suppress(KeyboardInterrupt):
                    step(planner)
                self.interrupted += where
            try:
                answers.append(step(planner))
            except NnppEdgeError:
                if not self.interrupted:
                    raise
                return self.renew()
        if kind == "plan":
            self.compare(*answers)
        return None

    def compare(self, ours, theirs=None):
        """Both answers are the same, but for what a body's lazy checks leave open."""
        if theirs is not None:
            assert ours.status is theirs.status, (ours, theirs)
            vehicle = self.world.vehicle
            if vehicle:
                alike = math.isclose(ours.cost, theirs.cost, rel_tol=1e-6)
                assert alike or vehicle.turning_radius_m, (ours, theirs)
                return
            for name in ("cost", "lower_bound", "expansions", "threshold", "path"):
                both = [getattr(each, name) for each in (ours, theirs)]
                np.testing.assert_array_equal(*both, err_msg=name)

    def compare_maps(self):
        """The map is that of a planner made afresh."""
        same_maps(self.planners[0], self.made(lazy=False))

    def update(self):
        """A patch."""
        patch = self.world.patch()
        self.world.read()
        return patch

    def plan(self, method=None, limit=None, epsilon=None):
        """A plan, which is judged."""
        world = self.world
        method = method or self.rng.choice([*(DynamicMethod if self.method else Method)])
        limits = (math.inf, 0.0, 1e-5, 1e-4, 1e-3)
        self.limit = limit or float(self.rng.choice(limits, p=LIMITED) if self.alone else math.inf)
        options = {"method": method, "time_limit_s": self.limit}
        allowed = METHODS[method].bound - 1.0
        ends = (self.start, self.goal)
        if not self.method:
            epsilon = self.rng.choice((math.inf, 0.0, 0.1)) if epsilon is None else epsilon
            headings = map(world.heading, (self.begin, self.end))
            names = ("start_heading_deg", "goal_heading_deg")
            options |= dict(zip(names, headings, strict=True)) | {"epsilon": epsilon}
            allowed = min(epsilon, allowed) if self.limit == math.inf else allowed
        optimum = world.optimum(*ends, self.begin, self.end)
        ask = methodcaller(*(("replan",) if self.method else ("plan", *ends)), **options)
        self.told.append(f"optimum {optimum}, by {ask}")

        def step(planner):
            plan = ask(planner)
            self.judge(plan, optimum, allowed)
            return plan

        return step

    def judge(self, plan, optimum, allowed):
        """Assert that an answer is right, also where one cannot stand at an end."""
        ends = {Status.START_BLOCKED: self.start, Status.GOAL_BLOCKED: self.goal}
        shut = [status for status, cell in ends.items() if not self.world.passable[cell]]
        if plan.status is Status.TIMEOUT and self.limit < math.inf:
            return
        if shut:
            right = shut[:1]
            if self.world.vehicle:
                right += [Status.NO_PATH, *[Status.OK] * (self.start == self.goal)]
            assert plan.status in right, plan
        else:
            assert plan.status in (Status.OK, Status.NO_PATH), plan
            self.world.judge(plan, optimum, allowed)

    def move(self):
        """The robot is elsewhere."""
        self.start = self.cell()
        self.begin, _ = self.world.headings()
        return self.told_to_moving("move", self.start, self.begin)

    def set_goal(self):
        """It is to go elsewhere."""
        self.goal = self.cell()
        _, self.end = self.world.headings()
        return self.told_to_moving("set_goal", self.goal, self.end)

    def told_to_moving(self, name, cell, heading):
        """The call of a planner that keeps its ends; another is given them with the query."""
        call = methodcaller(name, cell, self.world.heading(heading))
        return call if self.method else None

    def prepare(self):
        """Work ahead, with landmarks where they serve."""
        by_costs = self.world.model is None and self.world.vehicle is None
        return methodcaller("prepare", **{} if self.method else {"landmarks": 2 * by_costs})


def small_sizes(rng):
    """Sizes made so small that small maps have many tiles and several coarse levels."""
    rows, cols = rng.choice(((4, 4), (8, 16), (32, 64), (16, 4)))
    level = rng.choice((2, 4, 8, 16))
    return {
        "map.tiles.TILE_ROWS": rows,
        "map.tiles.TILE_COLS": cols,
        "map.pyramid.ANOTHER_LEVEL_FROM": level,
        "planners.methods.REFINE_FROM": level,
        "bands.THREADS_FROM": rng.choice((1, 200_000)),
    }


def check(rng, place, worlds, drive=Drive):
    """A drive through one of these worlds, which is returned."""
    numbers = np.random.default_rng(rng.getrandbits(64))
    with contextlib.ExitStack() as stack:
        for target, value in small_sizes(rng).items():
            stack.enter_context(mock.patch(f"nnpp_edge.runtime.{target}", value))
        driven = drive(rng.choice(worlds)(numbers), place)
        driven.run(rng.choice((1, 1, 4, 10, 25)))
        return driven


def check_bodies(rng, place):
    """A drive of a body, whose motions are then followed one by one."""
    drive = check(rng, place, [OddBody])
    if problem := bodies.problem_with_motions(drive.made(lazy=False), drive.world.dem):
        raise problem
