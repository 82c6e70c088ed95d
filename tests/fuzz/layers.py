"""The loop in the place of a planner: what it is told comes as bytes on the wire, among junk and
damaged messages, in patches that say the same in other ways. Of some maps the means of blocks are
all that is known at first.
"""

import io
import json
import random
from operator import methodcaller
from types import SimpleNamespace

import numpy as np

from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import WireError, decode, encode
from nnpp_edge.runtime import DynamicMethod, Goal, MapPatch, Navigator, Pose
from tests import pose_oracles
from tests.fuzz import sequences
from tests.fuzz.mutations import junk_bytes, mutated, mutated_json
from tests.fuzz.sequences import Drive, OddCosts
from tests.worlds import WORLDS, World, same_maps

FACTOR = 4
MOST_BYTES = 1 << 20
TOLERANCE = 1e-4


class CoarseWorld(World):
    """Ground of which the means of blocks are known at first, and later what patches tell. It is
    judged by a planner that is told all of that at once.
    """

    def __init__(self, rng):
        fine = WORLDS[rng.choice(("heights", "body"))](rng)
        more = [(0, -side % FACTOR) for side in fine.dem.shape]
        dem = np.pad(fine.dem, more, mode="edge")
        fine.dem = self.fine = dem
        self.start = fine.ground().by_blocks(FACTOR, "slope")
        layers = (np.full_like(dem, np.nan), np.zeros(dem.shape, np.float32))
        super().__init__(rng, layers, fine.sides, fine.limits, vehicle=fine.vehicle)

    def ground(self):
        """As of every world."""
        return self.start

    def planner(self, *towards, **options):
        """As of every world."""
        made = super().planner(*towards, **options)
        made.update_elevation(0, 0, self.dem)
        return made

    def read(self):
        """As of every world."""
        self.judging = self.planner()
        grid = self.judging.state.grid
        stands = [grid.is_passable(cell) for cell in np.ndindex(self.dem.shape)]
        self.passable = np.reshape(stands, self.dem.shape)

    def patch(self):
        """As of every world; most show a part of the ground."""
        if self.rng.random() < 0.3:
            return super().patch()
        row, col = (int(self.rng.integers(side)) for side in self.dem.shape)
        rows, cols = self.rng.integers(1, 12, 2)
        part = (slice(row, row + rows), slice(col, col + cols))
        self.dem[part] = self.fine[part]
        return methodcaller("update_elevation", row, col, self.dem[part].copy())

    def optimum(self, start, goal, begin=None, end=None):
        """As of every world."""
        return self.judging.plan(start, goal, method="astar").cost

    def path_cost(self, path):
        """As of every world."""
        return self.judging.state.grid.costs_of(path)[0]


def inputs(content):
    """The messages that are understood. Others must be refused by an error of the toolkit."""
    found = []
    for payload in messages(io.BytesIO(content), MOST_BYTES):
        try:
            found.append(decode(payload, MOST_BYTES))
        except WireError as error:
            assert len(str(error).split("\n")) == 1 <= len(str(error)), f"no line: {error}"
    return found


class LoopPlanner:
    """The loop by the names that a planner has, and its inputs as bytes."""

    def __init__(self, rng, world, method, model):
        self.rng = rng
        self.now = 100.0
        point = world.vehicle is None and world.model is None
        rule = {"corner_cutting": world.corner_cutting, "omega": world.omega, "model": model}
        self.navigator = Navigator(
            world.ground(),
            method,
            refine="any-angle" if point and rng.random() < 0.3 else None,
            tolerance=TOLERANCE,
            snap_radius=0,
            clock=lambda: self.now,
            **rule,
        )
        self.state = self.navigator.planner.state

    def offer(self, message):
        """Send a message, and now and then what is none before it."""
        made = encode(message)
        if self.rng.random() < 0.5:
            damage = self.rng.choice((mutated, mutated_json, lambda rng, _: junk_bytes(rng)))
            inputs(damage(self.rng, made) + b"\n")
        for each in inputs(made + b"\n"):
            self.navigator.offer(each)

    def told(self, row, col, values, name):
        """A patch: as it is, in two parts, or amid cells that were not seen, also off the map."""
        values = np.asarray(values, np.float32)
        by_cost = name == "cost"
        known = ~np.isnan(values) if by_cost else np.isfinite(values)
        way = self.rng.choice(("whole", "parts", "amid"))
        if way == "parts" and len(values) > 1:
            half = len(values) // 2
            self.offer(MapPatch(row, col, **{name: values[:half]}))
            self.offer(MapPatch(row + half, col, **{name: values[half:]}))
        elif way == "amid" and known.all():
            amid = np.pad(values, 3, constant_values=np.nan)
            self.offer(MapPatch(row - 3, col - 3, keep_known=True, **{name: amid}))
        else:
            self.offer(MapPatch(row, col, **{name: values}))

    def update(self, row, col, patch):
        """As of a planner."""
        self.told(row, col, patch, "cost")

    def update_elevation(self, row, col, patch):
        """As of a planner."""
        self.told(row, col, patch, "elevation")

    def move(self, cell, heading):
        """As of a planner."""
        self.offer(Pose(*np.add(cell, self.rng.random())))

    def set_goal(self, cell, heading):
        """As of a planner."""
        self.offer(Goal(*cell))

    def replan(self, method, time_limit_s):
        """The answer of a tick."""
        self.now += 0.05
        message = self.navigator.tick(self.now + time_limit_s)
        assert not self.navigator.counters().errors, "caught inside the loop"
        assert json.loads(encode(message))["outcome"] == message.outcome
        facts = {name: getattr(message, name) for name in ("ok", "cost", "lower_bound", "path")}
        return SimpleNamespace(
            status=message.outcome, walked=message.path, expansions=0, message=message, **facts
        )


class LoopDrive(Drive):
    """Steps of the loop through what a world becomes."""

    methods = tuple(DynamicMethod)
    interrupted_share = 0.0

    def made(self, **options):
        """The loop on the map as it is."""
        seed = int(self.rng.integers(1 << 62))
        made = LoopPlanner(random.Random(seed), self.world, self.method, self.place.model)
        made.set_goal(self.goal, None)
        made.move(self.start, None)
        return made

    def renew(self):
        """As of every drive; but for the loop there is no second planner."""
        self.planners = [self.made()]

    def plan(self, method=None, limit=None, epsilon=None):
        """As of every drive, by the loop's own method."""
        return super().plan(self.method, limit, epsilon)

    def prepare(self):
        """The loop does so by itself."""

    def judge(self, plan, optimum, allowed):
        """As of every drive; no part of a body may be above what was told, or off the map."""
        super().judge(plan, optimum, allowed + 2.0 * TOLERANCE)
        path = plan.path
        vehicle = self.world.vehicle
        if vehicle and vehicle.as_body and len(path) > 1:
            legs = np.diff(path, axis=0)
            places = np.concatenate([path[:-1] + share * legs for share in (0.0, 0.5, 1.0)])
            headings = np.tile(np.arctan2(legs[:, 1], legs[:, 0]), 3)
            ground = np.where(self.world.told < 1.0, 0.0, np.nan)
            broken = pose_oracles.breaks_at(ground, self.world.sides, vehicle, places, headings)
            assert broken is None, broken

    def compare_maps(self):
        """The loop's map is that of a planner made afresh; of a coarse one nothing is said."""
        if not isinstance(self.world, CoarseWorld):
            same_maps(self.planners[0], self.world.planner(lazy=False))


NAMES = ("costs", "lengths", "disc", "heights", "disc on heights", "tobler", "energy", "body")
LOOPED = (OddCosts, CoarseWorld, CoarseWorld, *(WORLDS[name] for name in NAMES))


def check(rng, place):
    """A drive of the loop through one of these worlds."""
    return sequences.check(rng, place, LOOPED, LoopDrive)
