"""JSON messages into the loop: junk, halves, floods, out of order. It never raises; its
paths hold.
"""

import io
import json
import math
import random
import traceback
from typing import Any

import numpy as np

from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import WireError, decode, decode_output, encode
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, PathMessage, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.planners.planner import Planner
from tests.fuzz.cases import NOWHERE, Case, Place, Problem
from tests.fuzz.layers import HARD, SOFT, Layers, wrong_answer
from tests.fuzz.mutations import junk_bytes, junk_value, mutated, mutated_json
from tests.fuzz.samples import heights

_LIMIT = 100_000
_ODD_NUMBERS = (
    0.0,
    -0.0,
    1.0,
    0.999999,
    1e-45,
    1e38,
    3e38,
    -1.0,
    1e300,
    math.inf,
    -math.inf,
    math.nan,
    1e9,
    -1e9,
)


def generate(rng: random.Random, place: Place = NOWHERE) -> Case:
    """A map, how the loop plans, and what comes: ``bytes`` of messages, and ``tick``, due in so
    many seconds.
    """
    rows = rng.randrange(4, 40)
    cols = rng.randrange(4, 40)
    by_heights = rng.random() < 0.3
    steps: list[tuple[str, Any]] = []
    if rng.random() < 0.9:
        sane = [
            Pose(rng.random() * rows, rng.random() * cols),
            Goal(rng.randrange(rows), rng.randrange(cols)),
        ]
        steps.append(("bytes", b"".join(encode(message) + b"\n" for message in sane)))
    for _ in range(rng.choice((3, 10, 30))):
        if rng.random() < 0.4:
            steps.append(("tick", rng.choice((0.01, 0.01, 1.0, 1e9, 0.0, -1.0, 1e-5, math.inf))))
        else:
            steps.append(("bytes", _bytes(rng, rows, cols, by_heights)))
    return Case(
        rows=rows,
        cols=cols,
        seed=rng.getrandbits(32),
        by_heights=by_heights,
        limits=rng.choice((SOFT, HARD)),
        method=rng.choice(list(DynamicMethod)),
        corner_cutting=rng.random() < 0.5,
        steps=[*steps, ("tick", math.inf)],
    )


def _bytes(rng: random.Random, rows: int, cols: int, by_heights: bool) -> bytes:
    """One or several messages on the wire, most of them whole."""
    parts = []
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        payload = _payload(rng, rows, cols, by_heights)
        payload = rng.choices((payload, mutated(rng, payload), junk_bytes(rng)), (12, 2, 1))[0]
        parts.append((payload + b"\n") * rng.choice((1, 1, 1, 1, 1, 40)))
    content = b"".join(parts)
    return content if rng.random() < 0.95 else content[: rng.randrange(len(content) + 1)]


def _payload(rng: random.Random, rows: int, cols: int, by_heights: bool) -> bytes:
    row = rng.randrange(-3, rows + 3)
    col = rng.randrange(-3, cols + 3)
    kind = rng.choices(("pose", "goal", "patch", "list", "odd"), (3, 1, 5, 2, 2.7))[0]
    stamp = rng.choice((0.0, 1.0, -1.0, 1e11, 5e8))
    if kind == "pose":
        return encode(Pose(row + rng.random(), col + rng.random(), stamp))
    if kind == "goal":
        return encode(Goal(row, col, stamp))
    values = _values(rng, rng.randrange(1, 9), rng.choice((1, 3, 8, 60)), by_heights)
    elevation = by_heights == (rng.random() < 0.9)
    keep = rng.random() < 0.5
    if kind == "patch":
        both = (values, None) if elevation else (None, np.abs(values))
        return encode(MapPatch(row, col, *both, keep, stamp))
    name = "elevation" if elevation else "cost"
    message: dict[str, Any] = {"type": "patch", "row": row, "col": col, "keep_known": keep}
    message[name] = [
        [None if math.isnan(value) else value for value in each] for each in values.tolist()
    ]
    if kind == "odd" and rng.random() < 0.3:
        message[rng.choice(list(message))] = junk_value(rng)
    elif kind == "odd":
        return mutated_json(rng, json.dumps(message).encode())
    return json.dumps(message).encode()


def _values(rng: random.Random, height: int, width: int, by_heights: bool) -> np.ndarray:
    numbers = np.random.default_rng(rng.getrandbits(32))
    values = (
        heights(rng.getrandbits(16), height, width)
        if by_heights
        else numbers.random((height, width))
    )
    odd = numbers.random((height, width)) < rng.choice((0.0, 0.1, 0.3, 1.0))
    with np.errstate(over="ignore"):
        return np.where(odd, rng.choice(_ODD_NUMBERS), values).astype(np.float32)


def check(case: Case, place: Place = NOWHERE) -> Problem | None:
    """Let the messages come, and look at each answer."""
    try:
        return _drive(case, place)
    except Exception:
        return Problem("the loop raised", f"{traceback.format_exc()}\n{case!r}")


def _drive(case: Case, place: Place) -> Problem | None:
    numbers = np.random.default_rng(case.seed)
    clock = 100.0
    cost = numbers.random((case.rows, case.cols)).astype(np.float32)
    cost[numbers.random(cost.shape) < 0.15] = np.inf
    layers = Layers(heights(case.seed, *cost.shape) if case.by_heights else None, cost, case.limits)
    navigator = Navigator(
        layers.ground(1.0),
        case.method,
        tolerance=1e-4,
        snap_radius=0,
        corner_cutting=case.corner_cutting,
        model=place.model,
        clock=lambda: clock,
    )
    last: dict[type, Input] = {}
    for kind, value in case.steps:
        if kind == "tick":
            clock += 0.05
            message = navigator.tick(clock + value)
            told = f"{message}\n{case!r}"
            if errors := navigator.counters().errors:
                return Problem(f"caught inside the loop: {', '.join(errors)}", told)
            if problem := _problem_with_answer(
                message, layers, case, last.get(Pose), last.get(Goal)
            ):
                return Problem(problem, told)
            continue
        for found in _inputs(value):
            last[type(found)] = found
            navigator.offer(found)
            if isinstance(found, MapPatch):
                layers.put(found)
    return None


def _inputs(value: bytes) -> list[Input]:
    """The messages that are understood. Others must be refused by an error of the toolkit."""
    found = []
    for payload in messages(io.BytesIO(value), _LIMIT):
        try:
            if isinstance(payload, WireError):
                raise payload
            found.append(decode(payload, _LIMIT))
        except WireError as error:
            if "\n" in str(error) or not str(error):
                raise AssertionError(f"the refusal is not one line: {error}") from None
    return found


def _problem_with_answer(
    message: PathMessage, layers: Layers, case: Case, pose: Any, goal: Any
) -> str:
    """What is wrong with an answer on the map as it is; empty if nothing."""
    outcome = message.outcome
    if decode_output(encode(message)).outcome is not outcome:  # type: ignore[union-attr]
        return "an answer that reads back as another"
    if pose is None or goal is None:
        return (
            "" if outcome in (Status.NO_POSE, Status.NO_GOAL) else f"{outcome} without pose or goal"
        )
    if outcome in (Status.TIMEOUT, Status.UNKNOWN, Status.INVALID_MAP):
        return "" if outcome is Status.TIMEOUT else f"{outcome}"
    outside = not (0 <= goal.row < case.rows and 0 <= goal.col < case.cols)
    if outside and outcome is Status.GOAL_OUTSIDE_MAP:  # wherever the pose is
        return ""
    planner = Planner(layers.cost(1.0), corner_cutting=case.corner_cutting)
    return wrong_answer(message, planner, pose.cell, goal.cell, exact=False)
