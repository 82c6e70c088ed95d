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
    EnergyCost,
    Goal,
    Ground,
    MapPatch,
    Mobility,
    Navigator,
    Planner,
    Pose,
    Status,
    Traversability,
    Vehicle,
    traversability_cost,
)
from tests import pose_oracles
from tests.fuzz.cases import NOWHERE, Case, Problem
from tests.fuzz.mutations import junk_bytes, junk_value, mutated, mutated_json

CELL_M = 0.5
FACTOR = 4
DISC = Vehicle(radius_m=0.7)
VEHICLES = (None, None, DISC, Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3))
METHODS = ("auto", "auto", "astar", "dstar", "corridor", "corridor-dstar")
TOLD = (0.0, 0.4, 1.0, np.inf, np.nan)
SHARES = (0.5, 0.2, 0.1, 0.1, 0.1)
ODD_NUMBERS = (0.0, -0.0, 1.0, 0.999999, 1e-45, 1e38, 3e38, -1.0, 1e300, 1e9, -1e9, *TOLD)
DUE_S = (0.01, 0.01, 1.0, 1e9, 0.0, -1.0, 1e-5)
LIMITS = (Traversability(), *[Traversability(hard_slope_deg=20.0)] * 2)
MOST_BYTES = 100_000


def generate(rng, place=NOWHERE):
    """A first map, a robot, and for each tick what comes, and in how many seconds it is due.

    A plain case is a point's whose steps have no directions, on a map known from the start: there
    messages are damaged, and heights and costs may have any size.
    """
    seed = rng.getrandbits(32)
    numbers = np.random.default_rng(seed)
    rows, cols = (FACTOR * numbers.integers(3, 11, 2)).tolist()
    plain = rng.random() < 0.4
    vehicle = None if plain else rng.choice(VEHICLES)
    by_heights = rng.random() < 0.8 or bool(vehicle and vehicle.as_body)
    heights = np.cumsum(numbers.normal(0.0, 0.015, (rows, cols)), axis=1).astype(np.float32)
    for _ in range(rng.randrange(8)):
        row, col = numbers.integers(0, (rows - 6, cols - 6)).tolist()
        high, wide = rng.choice(((1, 6), (6, 1)))
        heights[row : row + high, col : col + wide] += rng.choice((0.6, -0.6, np.nan))
    cost = numbers.random((rows, cols)).astype(np.float32) * 0.9
    cost[numbers.random(cost.shape) < 0.1] = rng.choice((np.nan, np.inf, 1.0))
    directed = by_heights and not plain
    step_cost = rng.choice(("paper", "paper", "tobler", "energy")) if directed else "paper"
    coarse = directed and step_cost == "paper" and vehicle is not DISC and rng.random() < 0.5
    blocks = heights.reshape(rows // FACTOR, FACTOR, cols // FACTOR, FACTOR)
    steps = []
    for _ in range(rng.choice((4, 16, 16))):
        payloads = [
            _payload(rng, numbers, heights, by_heights, plain)
            for _ in range(rng.choice((0, 1, 1, 2, 6)))
        ]
        content = b"".join(
            (each + b"\n") * rng.choice((*[1] * 9, 1 + 39 * plain)) for each in payloads
        )
        content = content if rng.random() < 0.95 else content[: rng.randrange(len(content) + 1)]
        steps.append((content, rng.choice(DUE_S) if plain and rng.random() < 0.3 else math.inf))
    return Case(
        heights=heights * (np.nan if coarse else 1.0) if by_heights else None,
        means=blocks.mean((1, 3)) if coarse else None,
        cost=cost,
        limits=rng.choice(LIMITS),
        vehicle=vehicle,
        step_cost=step_cost,
        corner_cutting=not plain or rng.random() < 0.5,
        method=rng.choice([*DynamicMethod] if plain else METHODS),
        refine=rng.random() < 0.3,
        first=[] if plain and rng.random() < 0.1 else [Pose(3.5, 3.5), Goal(rows - 4, cols - 4)],
        seed=seed,
        steps=[*steps, (b"", math.inf)],
    )


def _payload(rng, numbers, heights, by_heights, plain):
    """A message on the wire, most of them patches and whole."""
    row, col = numbers.integers(-3, heights.shape).tolist()
    if plain and rng.random() < 0.3:
        place = Pose(row + rng.random(), col + rng.random(), rng.choice((0.0, 1.0, -1.0, 1e11)))
        payload = encode(place if rng.random() < 0.75 else Goal(row, col))
    else:
        payload = _patch(rng, numbers, heights, (row, col), by_heights, plain)
    whole = not plain or rng.random() < 0.8
    return payload if whole else rng.choice((mutated(rng, payload), junk_bytes(rng)))


def _patch(rng, numbers, heights, place, by_heights, plain):
    """Heights near those of the first map, or costs; anywhere, also off the map."""
    row, col = place
    rows, cols = numbers.integers(1, (8, 60 if plain and rng.random() < 0.1 else 8)).tolist()
    name = "elevation" if by_heights and rng.random() < 0.5 else "cost"
    values = numbers.choice(TOLD, (rows, cols), p=SHARES)
    if name == "elevation":
        around = np.pad(heights, 64, constant_values=np.nan)
        around = around[row + 64 : row + rows + 64, col + 64 : col + cols + 64]
        values = around + rng.choice((0.0, 0.001, 0.05)) * numbers.normal(size=around.shape)
    share = rng.choice((0.0, 0.0, 0.05, 1.0 if name == "cost" else 0.3))
    odd = rng.choice(ODD_NUMBERS if plain else (np.nan, 2.0 if name == "elevation" else 1.0))
    with np.errstate(over="ignore"):
        values = np.where(numbers.random((rows, cols)) < share, odd, values).astype(np.float32)
    message = {"row": row, "col": col, "keep_known": rng.random() < 0.5}
    if not plain or rng.random() < 0.6:
        return encode(MapPatch(**message, **{name: np.abs(values) if name == "cost" else values}))
    lists = [[None if math.isnan(value) else value for value in each] for each in values.tolist()]
    message |= {"type": "patch", name: lists}
    if rng.random() < 0.2:
        message[rng.choice([*message])] = junk_value(rng)
    text = json.dumps(message).encode()
    return text if rng.random() < 0.6 else mutated_json(rng, text)


class Layers:
    """The map, kept apart from the loop's, cell by cell: heights, if there are any, and what was
    told as costs.
    """

    def __init__(self, heights, cost, limits):
        self.limits = limits
        self.heights = None if heights is None else heights.copy()
        self.told = cost.copy() if heights is None else np.zeros(cost.shape, np.float32)

    def put(self, patch):
        """Each patch into its own layer; what was not seen is unknown then, but in a layer that
        costs are told to.
        """
        by_cost = patch.cost is not None
        layer = self.told if by_cost else self.heights
        if layer is None:
            return
        for (i, j), value in np.ndenumerate(patch.cost if by_cost else patch.elevation):
            cell = patch.row + i, patch.col + j
            if not (0 <= cell[0] < layer.shape[0] and 0 <= cell[1] < layer.shape[1]):
                continue
            if np.isfinite(value) or (by_cost and not np.isnan(value)):
                layer[cell] = value
            elif not patch.keep_known and (layer is self.heights or self.heights is None):
                layer[cell] = np.nan

    def ground(self, **robot):
        """The ground of the heights or, where there are none, of the costs."""
        if self.heights is None:
            return Ground(self.told, cell_size_m=CELL_M, vehicle=robot["vehicle"])
        return Ground.of_elevation(self.heights, CELL_M, self.limits, **robot)

    def cost(self):
        """Of both layers; what is unknown is NaN."""
        if self.heights is None:
            return self.told
        cost = traversability_cost(self.heights, CELL_M, self.limits, warn=False)
        return np.maximum(cost, self.told)


def _ground(case, layers):
    mobility = Mobility(energy=EnergyCost(50.0, 0.1))
    robot = {"vehicle": case.vehicle, "step_cost": case.step_cost, "mobility": mobility}
    if case.means is None:
        return layers.ground(**robot)
    blocks = case.means, FACTOR * CELL_M, FACTOR, case.limits
    return Ground.of_coarse(*blocks, prior="slope", **robot)


def _planner(case, layers):
    """The planner of a robot that has had the whole map from the start."""
    disc = case.vehicle is None or not case.vehicle.as_body
    if case.means is None and (layers.heights is None or (case.step_cost == "paper" and disc)):
        return Planner(
            layers.cost(),
            vehicle=case.vehicle,
            cell_size_m=CELL_M,
            corner_cutting=case.corner_cutting,
        )
    if case.means is None and not disc:
        known = np.where(layers.told < 1.0, layers.heights, np.float32(np.nan))
        return Planner(_ground(case, Layers(known, case.cost, case.limits)))
    planner = Planner(_ground(case, layers))
    planner.update_elevation(0, 0, layers.heights)
    planner.update(0, 0, layers.told)
    return planner


def check(case, place=NOWHERE):
    """What is wrong with the loop's answers, beside the map that keeps the layers apart."""
    layers = Layers(case.heights, case.cost, case.limits)
    body = case.vehicle and case.vehicle.as_body
    clock = 100.0
    navigator = Navigator(
        _ground(case, layers),
        case.method,
        tolerance=1e-4,
        snap_radius=0,
        refine="any-angle" if case.refine and case.step_cost == "paper" and not body else None,
        corner_cutting=case.corner_cutting,
        model=place.model,
        clock=lambda: clock,
    )
    numbers = np.random.default_rng(case.seed)
    last = {}
    offered = case.first
    for tick, (content, due_s) in enumerate(case.steps):
        for each in (*offered, *_inputs(content)):
            last[type(each)] = each
            navigator.offer(each)
            if isinstance(each, MapPatch):
                layers.put(each)
        clock += 0.05
        message = navigator.tick(clock + due_s)
        told = f"tick {tick}: {message}\n{case!r}"
        if errors := navigator.counters().errors:
            return Problem(f"caught inside the loop: {', '.join(errors)}", told)
        offered = []
        if message.outcome is Status.TIMEOUT and due_s < math.inf:
            continue
        if problem := _wrong_answer(message, case, layers, last.get(Pose), last.get(Goal)):
            return Problem(problem, told)
        if body and len(message.path) > 1:
            legs = np.diff(message.path, axis=0)
            places = [message.path[:-1] + share * legs for share in (0.0, 0.5, 1.0)]
            headings = np.tile(np.arctan2(legs[:, 1], legs[:, 0]), 3)
            open_to_all = np.where(layers.told < 1.0, 0.0, np.nan), CELL_M, case.vehicle
            if found := pose_oracles.breaks_at(*open_to_all, np.concatenate(places), headings):
                return Problem("a body over an obstacle or off the map", f"{found}\n{told}")
        bare = (
            layers.told if layers.heights is None else layers.ground(vehicle=case.vehicle).costs()
        )
        passable = (bare < 1.0) & (layers.told < 1.0)
        if case.means is None and not np.array_equal(navigator.map.cost() < 1.0, passable):
            return Problem("the map's costs are shut elsewhere", told)
        cells = message.path[:3] if message.ok else numbers.integers(0, case.cost.shape)[None]
        at = cells[-1].tolist()
        offered = [Pose(*((3.5, 3.5) if message.ok and len(message.path) < 3 else np.add(at, 0.5)))]
    return None


def _inputs(content):
    """The messages that are understood. Others must be refused by an error of the toolkit."""
    found = []
    for payload in messages(io.BytesIO(content), MOST_BYTES):
        try:
            found.append(decode(payload, MOST_BYTES))
        except WireError as error:
            assert len(str(error).split("\n")) == 1 <= len(str(error)), f"no line: {error}"
    return found


def _wrong_answer(message, case, layers, pose, goal):
    """What is wrong with an answer, by a planner of the whole map; empty if nothing."""
    outcome = message.outcome
    if decode_output(encode(message)).outcome is not outcome:
        return "an answer that reads back as another"
    if pose is None or goal is None:
        missing = (Status.NO_POSE, Status.NO_GOAL)
        return "" if outcome in missing else f"{outcome} without pose or goal"
    outside = not (0 <= goal.row < case.cost.shape[0] and 0 <= goal.col < case.cost.shape[1])
    if outside and outcome is Status.GOAL_OUTSIDE_MAP:  # wherever the pose is
        return ""
    planner = _planner(case, layers)
    best = planner.plan(pose.cell, goal.cell, method="astar")
    if outcome is not best.status:
        return f"{outcome} where the map has {best.status}"
    if outcome is not Status.OK:
        return ""
    path = message.path
    cost = planner.state.grid.costs_of(path)[0]
    near = 1e-4 * abs(best.cost) + 1e-5
    legs = 1 if planner.state.grid.robot.moves.poses is None else 2
    wrong = {
        "a path with a leap": not np.isin(np.abs(np.diff(path, axis=0)).max(1), (1, legs)).all(),
        "other ends": (tuple(path[0]), tuple(path[-1])) != (pose.cell, goal.cell),
        "a path that cannot be walked": not np.isfinite(cost) or cost < best.cost - near,
        "a cost that is not the path's": abs(message.cost - cost) > 1e-4 * abs(cost) + 1e-5,
        "a lower bound above the optimum": message.lower_bound > best.cost + near,
        "a path that is not the best": case.method in ("astar", "dstar")
        and message.cost > best.cost + 3.0 * near,
    }
    return next((f"published: {kind}" for kind, found in wrong.items() if found), "")
