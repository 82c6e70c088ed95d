"""Drives of the loop through messages with patches of heights, costs and nothing, beside a map that
keeps the layers apart. Of some maps the means of blocks are all that is known at first; messages
may be junk, halves, floods or out of order.
"""

import io
import json
import math

import numpy as np

from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import WireError, decode, decode_output, encode
from nnpp_edge.runtime import (
    DynamicMethod,
    Goal,
    MapPatch,
    Navigator,
    Planner,
    Pose,
    Status,
    traversability_cost,
)
from tests import pose_oracles
from tests.fuzz.mutations import junk_bytes, junk_value, mutated, mutated_json
from tests.worlds import WORLDS

FACTOR = 4
METHODS = ("auto", "auto", "astar", "dstar", "corridor", "corridor-dstar")
PLAIN = ("costs", "heights")
"""Worlds of a point whose steps have no directions, known from the start: there messages are
damaged, and heights and costs may have any size.
"""
ROBOTS = ("costs", "disc", "heights", "disc on heights", "tobler", "energy", "body", "body")
COARSE = ("heights", "body")
TOLD = (0.0, 0.4, 1.0, np.inf, np.nan)
SHARES = (0.5, 0.2, 0.1, 0.1, 0.1)
ODD_NUMBERS = (0.0, -0.0, 1.0, 0.999999, 1e-45, 1e38, 3e38, -1.0, 1e300, 1e9, -1e9, *TOLD)
DUE_S = (0.01, 0.01, 1.0, 1e9, 0.0, -1.0, 1e-5)
MARGIN = 64
MOST_BYTES = 100_000


class Drive:
    """A robot, its first map, what comes and what that makes of the map."""

    def __init__(self, rng):
        self.rng = rng
        self.plain = rng.random() < 0.4
        self.name = rng.choice(PLAIN if self.plain else ROBOTS)
        self.world = world = WORLDS[self.name](np.random.default_rng(rng.getrandbits(64)))
        self.coarse = not self.plain and self.name in COARSE and rng.random() < 0.5
        if self.coarse:
            more = [(0, -side % FACTOR) for side in world.dem.shape]
            world.dem = np.pad(world.dem, more, mode="edge")
            world.told = np.zeros(world.dem.shape, np.float32)
            world.read()
        self.shape = world.told.shape
        self.begin, self.end = world.cells(2)
        self.first = None
        """Heights, of which a coarse map shows the means alone."""
        if world.dem is not None:
            self.first = np.pad(world.dem, MARGIN, constant_values=np.nan)
        self.start = world.ground()
        if self.coarse:
            self.start = self.start.by_blocks(FACTOR, "slope")
            world.dem[:] = np.nan

    def content(self):
        """Bytes that come in one tick."""
        rng = self.rng
        lines = []
        for _ in range(rng.choice((0, 1, 1, 2, 6))):
            line = self.message() + b"\n"
            lines.append(line * rng.choice((*[1] * 9, 1 + 39 * self.plain)))
        content = b"".join(lines)
        return content if rng.random() < 0.95 else content[: rng.randrange(len(content) + 1)]

    def message(self):
        """Most of them patches, and whole."""
        rng = self.rng
        row, col = (rng.randrange(-3, side) for side in self.shape)
        if self.plain and rng.random() < 0.3:
            stamp = rng.choice((0.0, 1.0, -1.0, 1e11))
            pose = Pose(row + rng.random(), col + rng.random(), stamp)
            made = encode(pose if rng.random() < 0.75 else Goal(row, col))
        else:
            made = self.patch(row, col)
        if not self.plain or rng.random() < 0.8:
            return made
        return rng.choice((mutated(rng, made), junk_bytes(rng)))

    def patch(self, row, col):
        """Heights near those of the first map, or costs; anywhere, also off the map."""
        rng = self.rng
        numbers = self.world.rng
        most = 60 if self.plain and rng.random() < 0.1 else 8
        rows, cols = (rng.randrange(1, each) for each in (8, most))
        if self.first is not None and rng.random() < 0.5:
            name = "elevation"
            values = self.first[row + MARGIN :, col + MARGIN :][:rows, :cols]
            noise = rng.choice((0.0, 0.001, 0.05)) * numbers.normal(size=values.shape)
            values = values + noise
            odd = (np.nan, 2.0)
        else:
            name = "cost"
            values = numbers.choice(TOLD, (rows, cols), p=SHARES)
            odd = (np.nan, 1.0)
        share = rng.choice((0.0, 0.0, 0.05, 0.3, 1.0))
        at = numbers.random(values.shape) < share
        with np.errstate(over="ignore"):
            values = np.where(at, rng.choice(ODD_NUMBERS if self.plain else odd), values)
            values = values.astype(np.float32)
        values = np.abs(values) if name == "cost" else values
        made = encode(MapPatch(row, col, keep_known=rng.random() < 0.5, **{name: values}))
        return self.listed(made, name, values) if self.plain and rng.random() < 0.4 else made

    def listed(self, made, name, values):
        """The same message with lists, or with something else in it."""
        rng = self.rng
        message = json.loads(made)
        message[name] = [
            [None if math.isnan(value) else value for value in row] for row in values.tolist()
        ]
        if rng.random() < 0.2:
            message[rng.choice([*message])] = junk_value(rng)
        text = json.dumps(message).encode()
        return text if rng.random() < 0.6 else mutated_json(rng, text)

    def put(self, patch):
        """Each patch into its own layer, cell by cell; what was not seen is unknown then, but in a
        layer that costs are told to.
        """
        world = self.world
        by_cost = patch.cost is not None
        layer = world.told if by_cost else world.dem
        if layer is None:
            return
        for (i, j), value in np.ndenumerate(patch.cost if by_cost else patch.elevation):
            cell = patch.row + i, patch.col + j
            if not (0 <= cell[0] < self.shape[0] and 0 <= cell[1] < self.shape[1]):
                continue
            if np.isfinite(value) or (by_cost and not np.isnan(value)):
                layer[cell] = value
            elif not patch.keep_known and not (by_cost and world.dem is not None):
                layer[cell] = np.nan

    def planner(self):
        """Of a robot that has had the whole map from the start."""
        world = self.world
        if not self.coarse:
            return world.planner()
        rule = {"corner_cutting": world.corner_cutting, "omega": world.omega}
        planner = Planner(self.start, **rule)
        planner.update_elevation(0, 0, world.dem)
        planner.update(0, 0, world.told)
        return planner

    def passable(self):
        """(H, W) whether a point may be there, by either layer."""
        world = self.world
        if world.dem is None:
            return world.ground().costs() < 1.0
        limits = world.ground().limits
        width = {"cell_width_m": world.sides[1], "warn": False}
        cost = traversability_cost(world.dem, world.sides[0], limits, **width)
        return (cost < 1.0) & (world.told < 1.0)


def inputs(content):
    """The messages that are understood. Others must be refused by an error of the toolkit."""
    found = []
    for payload in messages(io.BytesIO(content), MOST_BYTES):
        try:
            if isinstance(payload, WireError):
                raise payload
            found.append(decode(payload, MOST_BYTES))
        except WireError as error:
            assert len(str(error).split("\n")) == 1 <= len(str(error)), f"no line: {error}"
    return found


def check(rng, place):
    """A drive, whose answers are held to a planner of the whole map."""
    drive = Drive(rng)
    world = drive.world
    by_paper = world.step_cost == "paper" and not (world.vehicle and world.vehicle.as_body)
    method = rng.choice([*DynamicMethod] if drive.plain else METHODS)
    clock = 100.0
    navigator = Navigator(
        drive.start,
        method,
        tolerance=1e-4,
        snap_radius=0,
        refine="any-angle" if by_paper and rng.random() < 0.3 else None,
        corner_cutting=world.corner_cutting,
        omega=world.omega,
        model=place.model,
        clock=lambda: clock,
    )
    last = {}
    offered = [Pose(*np.add(drive.begin, 0.5)), Goal(*drive.end)]
    if drive.plain and rng.random() < 0.1:
        offered = []
    told = [f"{vars(drive)} {vars(world)}"]
    try:
        for _ in range(rng.choice((4, 16, 16))):
            content = drive.content()
            due_s = rng.choice(DUE_S) if drive.plain and rng.random() < 0.3 else math.inf
            told.append(f"{content[:2000]!r} due in {due_s}")
            for each in (*offered, *inputs(content)):
                last[type(each)] = each
                navigator.offer(each)
                if isinstance(each, MapPatch):
                    drive.put(each)
            clock += 0.05
            message = navigator.tick(clock + due_s)
            told.append(f"{message}")
            offered = []
            assert not navigator.counters().errors, "caught inside the loop"
            if message.outcome is Status.TIMEOUT and due_s < math.inf:
                continue
            judge(drive, method, message, last.get(Pose), last.get(Goal))
            if not drive.coarse:
                np.testing.assert_array_equal(navigator.map.cost() < 1.0, drive.passable())
            at = message.path[:3][-1] if len(message.path) > 2 else drive.begin
            offered = [Pose(*np.add(at, 0.5))]
    except Exception as error:
        error.add_note("\n".join(told))
        raise


def judge(drive, method, message, pose, goal):
    """Assert that an answer is right, by a planner of the whole map."""
    outcome = message.outcome
    assert decode_output(encode(message)).outcome is outcome
    if pose is None or goal is None:
        assert outcome in (Status.NO_POSE, Status.NO_GOAL)
        return
    outside = not (0 <= goal.row < drive.shape[0] and 0 <= goal.col < drive.shape[1])
    if outside and outcome is Status.GOAL_OUTSIDE_MAP:  # wherever the pose is
        return
    planner = drive.planner()
    best = planner.plan(pose.cell, goal.cell, method="astar")
    assert outcome is best.status, best
    if outcome is not Status.OK:
        return
    path = message.path
    body = drive.world.vehicle and drive.world.vehicle.as_body
    assert (tuple(path[0]), tuple(path[-1])) == (pose.cell, goal.cell)
    assert np.isin(np.abs(np.diff(path, axis=0)).max(1), (1, 2 if body else 1)).all(), "a leap"
    cost = planner.state.grid.costs_of(path)[0]
    near = 1e-4 * abs(best.cost) + 1e-5
    assert abs(message.cost - cost) <= 1e-4 * abs(cost) + 1e-5, cost
    assert message.lower_bound - near <= best.cost <= cost + near, best
    assert method not in ("astar", "dstar") or message.cost <= best.cost + 3.0 * near, best
    if body and len(path) > 1:
        legs = np.diff(path, axis=0)
        places = np.concatenate([path[:-1] + share * legs for share in (0.0, 0.5, 1.0)])
        headings = np.tile(np.arctan2(legs[:, 1], legs[:, 0]), 3)
        open_to_all = np.where(drive.world.told < 1.0, 0.0, np.nan)
        sides = drive.world.sides
        broken = pose_oracles.breaks_at(open_to_all, sides, drive.world.vehicle, places, headings)
        assert broken is None, broken
