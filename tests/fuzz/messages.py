"""JSON and CDR messages into the loop: junk, halves, floods, out of order. It never raises; its paths hold."""

import json
import logging
import math
import random
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nnpp_edge.robot.transports.framing import Framer, WireError, framed
from nnpp_edge.robot.transports.wire import decode, decode_output, encode
from nnpp_edge.ros.maps import GridMap, MapFrame, OccupancyGrid, grid_map_patch, occupancy_patch
from nnpp_edge.runtime.errors import NnppEdgeError, Status
from nnpp_edge.runtime.loop.ladder import NavigatorSettings
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, PathMessage, Pose
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from tests import oracles
from tests.fuzz.commands import Problem
from tests.fuzz.mutations import junk_bytes, junk_value, mutated, mutated_json
from tests.fuzz.samples import heights
from tests.fuzz.weights import EXACT, small_model

NAME = "messages"
_LIMIT = 100_000
_ODD_NUMBERS = (0.0, -0.0, 1.0, 0.999999, 1e-45, 1e38, 3e38, -1.0, 1e300, math.inf, -math.inf, math.nan, 1e9, -1e9)
Step = tuple[str, object]
"""What is done: ``bytes`` fed to the framer, ``patch`` from a ROS message, ``tick`` by so many seconds from now."""


@dataclass(frozen=True)
class Case:
    """A world, how the loop plans, and what comes."""

    rows: int
    cols: int
    seed: int
    by_heights: bool
    hard: bool
    method: str
    corner_cutting: bool
    framing: str
    logged: bool
    steps: tuple[Step, ...]

    def __repr__(self) -> str:
        """Long inputs cut."""
        lines = [f"  {kind} {repr(value)[:300]}" for kind, value in self.steps]
        facts = {name: value for name, value in vars(self).items() if name != "steps"}
        return "\n".join([str(facts), *lines])


class Shadow:
    """The map as the messages have made it, kept apart from the loop's."""

    def __init__(self, case: Case) -> None:
        self.limits = Traversability(hard_slope_deg=20.0) if case.hard else Traversability()
        self.elevation = heights(case.seed, case.rows, case.cols) if case.by_heights else None
        if self.elevation is None:
            rng = np.random.default_rng(case.seed)
            self.cost = rng.random((case.rows, case.cols)).astype(np.float32)
            self.cost[rng.random(self.cost.shape) < 0.15] = np.inf
        else:
            self.cost = self._priced()
        self.told = np.zeros_like(self.cost)
        """What came as costs on a map of heights."""

    def ground(self) -> Ground:
        """The loop's ground, of the same beginning."""
        if self.elevation is None:
            return Ground(self.cost)
        return Ground.of_elevation(self.elevation, 1.0, self.limits)

    def put(self, patch: MapPatch) -> None:
        """Write a patch, cell by cell."""
        values, target = (patch.cost, self.cost) if patch.elevation is None else (patch.elevation, self.elevation)
        rows, cols = self.cost.shape
        misses = (
            patch.row >= rows
            or patch.col >= cols
            or patch.row + patch.shape[0] <= 0
            or patch.col + patch.shape[1] <= 0
        )
        if target is None or values is None or misses:
            return
        unseen = np.float32(np.inf if patch.elevation is None else np.nan)
        if self.elevation is not None and patch.elevation is None:
            target = self.told
        for (i, j), value in np.ndenumerate(values):
            row, col = patch.row + i, patch.col + j
            if not (0 <= row < target.shape[0] and 0 <= col < target.shape[1]):
                continue
            known = not np.isnan(value) if patch.elevation is None else np.isfinite(value)
            if known:
                target[row, col] = value
            elif not patch.keep_known and target is not self.told:
                target[row, col] = unseen
        if self.elevation is not None:
            self.cost = np.maximum(self._priced(), self.told)

    def seen(self) -> np.ndarray:
        """Costs in float64, impassable as inf."""
        return np.where(self.cost < 1.0, self.cost, np.inf).astype(np.float64)

    def _priced(self) -> np.ndarray:
        return traversability_cost(self.elevation, 1.0, self.limits, warn=False)


def generate(rng: random.Random) -> Case:
    """A case of up to some dozens of inputs and ticks."""
    rows, cols = rng.randrange(4, 40), rng.randrange(4, 40)
    by_heights = rng.random() < 0.3
    framing = rng.choice(("lines", "lines", "length"))
    steps: list[Step] = []
    sane = [Pose(rng.random() * rows, rng.random() * cols), Goal(rng.randrange(rows), rng.randrange(cols))]
    if rng.random() < 0.9:
        steps.append(("bytes", b"".join(framed(encode(message), framing) for message in sane)))
    for _ in range(rng.choice((3, 10, 30))):
        if rng.random() < 0.4:
            steps.append(("tick", rng.choice((0.01, 0.01, 1.0, 1e9, 0.0, -1.0, 1e-5, math.inf))))
        elif rng.random() < 0.1:
            steps.append(("ros", _ros(rng, rows, cols, by_heights)))
        else:
            steps.append(("bytes", _bytes(rng, rows, cols, by_heights, framing)))
    steps.append(("tick", math.inf))
    return Case(
        rows,
        cols,
        rng.getrandbits(32),
        by_heights,
        rng.random() < 0.5,
        rng.choice(list(DynamicMethod)),
        rng.random() < 0.5,
        framing,
        rng.random() < 0.15,
        tuple(steps),
    )


def _bytes(rng: random.Random, rows: int, cols: int, by_heights: bool, framing: str) -> bytes:
    """One or several messages on the wire, most of them whole."""
    parts = []
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        payload = _payload(rng, rows, cols, by_heights)
        payload = rng.choices((payload, mutated(rng, payload), junk_bytes(rng)), (12, 2, 1))[0]
        parts.append(framed(payload, framing) * rng.choice((1, 1, 1, 1, 1, 40)))
    content = b"".join(parts)
    return content if rng.random() < 0.95 else content[: rng.randrange(len(content) + 1)]


def _payload(rng: random.Random, rows: int, cols: int, by_heights: bool) -> bytes:
    place = {"row": rng.randrange(-3, rows + 3), "col": rng.randrange(-3, cols + 3)}
    kind = rng.choices(("pose", "goal", "patch", "list", "odd"), (3, 1, 5, 2, 3))[0]
    stamp = rng.choice((0.0, 1.0, -1.0, 1e11, 5e8))
    if kind == "pose":
        return encode(Pose(place["row"] + rng.random(), place["col"] + rng.random(), stamp))
    if kind == "goal":
        return encode(Goal(place["row"], place["col"], stamp))
    height, width = rng.randrange(1, 9), rng.choice((1, 3, 8, 60))
    values = _values(rng, height, width, by_heights)
    name = "elevation" if (by_heights if rng.random() < 0.9 else not by_heights) else "cost"
    keep = rng.random() < 0.5
    if kind == "patch":
        both = (values, None) if name == "elevation" else (None, np.abs(values))
        return encode(MapPatch(place["row"], place["col"], *both, keep, stamp))
    listed = [[None if math.isnan(value) else value for value in row] for row in values.tolist()]
    message = {"type": "patch", **place, name: listed, "keep_known": keep}
    content = json.dumps(message).encode()
    if kind == "list":
        return content
    if rng.random() < 0.3:
        message[rng.choice(list(message))] = junk_value(rng)
        return json.dumps(message).encode()
    if rng.random() < 0.1:
        return b'{"type":"patch","row":0,"col":0,"cost":' + b"[" * rng.choice((10, 3000, 90_000))
    if rng.random() < 0.1:
        packed = {"shape": [rng.choice((1, 2**31, 2**62)), rng.choice((1, 2**33))], "float32": "AAAA"}
        return json.dumps({"type": "patch", **place, name: packed}).encode()
    return mutated_json(rng, content)


def _values(rng: random.Random, height: int, width: int, by_heights: bool) -> np.ndarray:
    numbers = np.random.default_rng(rng.getrandbits(32))
    values = heights(rng.getrandbits(16), height, width) if by_heights else numbers.random((height, width))
    odd = numbers.random((height, width)) < rng.choice((0.0, 0.1, 0.3, 1.0))
    with np.errstate(over="ignore"):
        values = np.where(odd, rng.choice(_ODD_NUMBERS), values).astype(np.float32)
    return values


def _ros(rng: random.Random, rows: int, cols: int, by_heights: bool) -> dict[str, object]:
    """The fields of a ROS message of a map."""
    width, height = rng.choice((1, 4, 9, 0, -1)), rng.choice((1, 4, 9))
    size = rng.choice((1.0, 1.0, 1.0, 0.0, math.nan, 2.0, 1e-300, math.inf))
    x, y = rng.choice((0.0, 3.0, 3.4, -2.0, 1e308, math.nan)), rng.choice((0.0, 2.0, 50.0))
    data = [rng.choice((-1, 0, 50, 98, 99, 100)) for _ in range(max(width * height, 0))]
    if rng.random() < 0.1:
        data = data[:-1] if rng.random() < 0.5 else [*data, 127, -128]
    return {
        "grid_map": by_heights,
        "resolution": size,
        "width": width,
        "height": height,
        "x": x,
        "y": y,
        "data": data,
    }


def ros_patch(fields: dict[str, object]) -> MapPatch:
    """The patch that a ROS message makes."""
    resolution, width, height = fields["resolution"], fields["width"], fields["height"]
    x, y, data = fields["x"], fields["y"], fields["data"]
    if fields["grid_map"]:
        frame = MapFrame(1.0, 0.0, 0.0, rows_along_x=True)
        layers = {"elevation": np.array(data, np.float32) * 0.01}
        grid = GridMap(resolution, height * resolution, width * resolution, layers, x, y)  # type: ignore[arg-type,operator]
        return grid_map_patch(grid, frame)
    grid = OccupancyGrid(resolution, width, height, np.array(data, np.int8), x, y)  # type: ignore[arg-type,assignment]
    return occupancy_patch(grid, MapFrame(1.0))  # type: ignore[arg-type]


class _Log(logging.Handler):
    """Keeps what the loop logs of errors that it caught."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""

    def emit(self, record: logging.LogRecord) -> None:
        """Keep it, with its traceback."""
        if record.exc_info:
            self.text += "".join(traceback.format_exception(*record.exc_info))  # type: ignore[arg-type]


def check(
    case: Case,
    samples: Path | None = None,
    folder: Path | None = None,
    answer: Callable[[Navigator, float], PathMessage] = Navigator.tick,
) -> Problem | None:
    """Let the messages come, and look at each answer. The log, if one is kept, is written to `folder`."""
    log, logger = _Log(), logging.getLogger("nnpp_edge")
    logger.addHandler(log)
    propagated, logger.propagate = logger.propagate, False
    try:
        return _drive(case, samples, folder, log, answer)
    except Exception:
        return Problem("the loop raised", f"{traceback.format_exc()}\n{case!r}")
    finally:
        logger.removeHandler(log)
        logger.propagate = propagated


def _drive(
    case: Case,
    samples: Path | None,
    folder: Path | None,
    log: _Log,
    answer: Callable[[Navigator, float], PathMessage],
) -> Problem | None:
    shadow, clock = Shadow(case), [100.0]
    settings = NavigatorSettings(case.method, corner_cutting=case.corner_cutting, model=small_model(samples))  # type: ignore[arg-type]
    navigator = Navigator(shadow.ground(), settings, clock=lambda: clock[0])
    framer = Framer(case.framing, _LIMIT)
    taken: list[Input] = []
    answers: list[PathMessage] = []
    for kind, value in case.steps:
        if kind == "tick":
            clock[0] += 0.05
            deadline = clock[0] + float(value)  # type: ignore[arg-type]
            message = answer(navigator, deadline)
            answers.append(message)
            if problem := problem_with_answer(message, shadow, case, taken):
                return Problem(problem, f"{message}\n{log.text}\n{case!r}")
            if errors := navigator.counters().errors:
                return Problem(f"caught inside the loop: {', '.join(errors)}", f"{log.text}\n{case!r}")
            continue
        for found in _inputs(kind, value, framer):
            taken.append(found)
            navigator.offer(found)
            if isinstance(found, MapPatch):
                shadow.put(found)
    if case.logged and folder is not None:
        return _problem_of_log(case, taken, answers, shadow, folder)
    return None


def _inputs(kind: str, value: object, framer: Framer) -> list[Input]:
    """What is understood of bytes or a ROS message. What is not must be refused by an error of the toolkit."""
    if kind == "ros":
        try:
            return [ros_patch(value)]  # type: ignore[arg-type]
        except NnppEdgeError:
            return []
    content, found = bytes(value), []  # type: ignore[call-overload]
    half = len(content) // 2
    for payload in (*framer.feed(content[:half]), *framer.feed(content[half:])):
        try:
            if isinstance(payload, WireError):
                raise payload
            found.append(decode(payload, _LIMIT))
        except WireError as error:
            if "\n" in str(error) or not str(error):
                raise AssertionError(f"the refusal is not one line: {error}") from None
    return found


def problem_with_answer(message: PathMessage, shadow: Shadow, case: Case, taken: list[Input]) -> str:
    """What is wrong with an answer on the map as it is; empty if nothing."""
    pose = next((m for m in reversed(taken) if isinstance(m, Pose)), None)
    goal = next((m for m in reversed(taken) if isinstance(m, Goal)), None)
    if decode_output(encode(message), 1 << 24).outcome is not message.outcome:  # type: ignore[union-attr]
        return "an answer that reads back as another"
    if pose is None or goal is None:
        return (
            "" if message.outcome in (Status.NO_POSE, Status.NO_GOAL) else f"{message.outcome} without pose or goal"
        )
    seen = shadow.seen()
    if message.outcome is Status.TIMEOUT or not message.ok:
        if message.outcome is Status.NO_PATH and message.start is not None:
            cheapest = oracles.cheapest(seen, message.start, goal.cell, corner_cutting=case.corner_cutting)
            return "NO_PATH where there is a path" if math.isfinite(cheapest) else ""
        return f"{message.outcome}" if message.outcome in (Status.UNKNOWN, Status.INVALID_MAP) else ""
    path = [tuple(map(int, cell)) for cell in message.path]
    start = message.start if message.start_moved else pose.cell
    if start is None or goal.cell != message.goal:
        return "a path to another goal"
    if wrong := oracles.path_problem(path, seen, start, goal.cell, case.corner_cutting):
        return f"published: {wrong}"
    cheapest = oracles.cheapest(seen, start, goal.cell, corner_cutting=case.corner_cutting)
    if message.lower_bound > cheapest * (1.0 + EXACT) + 1e-6:
        return "published: a lower bound above the optimum"
    cost = oracles.path_cost(path, seen)
    return "" if abs(cost - message.cost) <= 1e-4 * cost + 1e-6 else "published: a cost that is not the path's"


def _problem_of_log(
    case: Case, taken: list[Input], answers: list[PathMessage], shadow: Shadow, folder: Path
) -> Problem | None:
    """Write all of it as CDR messages, and read it back by another library."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    from nnpp_edge.robot.transports.mcap_log import McapLog

    file = folder / "drive.mcap"
    file.unlink(missing_ok=True)
    with McapLog(file, state=shadow.ground().state(), cell_size_m=1.0) as log:
        for message in taken:
            log.record(message)
        for message_out in answers:
            log.publish(message_out)
    count: dict[str, int] = {}
    last = None
    written = max(folder.glob("drive*.mcap"), key=lambda path: path.stat().st_mtime)
    with written.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, decoded in reader.iter_decoded_messages():
            count[channel.topic] = count.get(channel.topic, 0) + 1
            last = decoded if channel.topic == "/path" else last
    written.unlink()
    patches = sum(isinstance(m, MapPatch) for m in taken)
    lost = getattr(log, "lost", 0)
    if count.get("/map_patch", 0) + count.get("/elevation_patch", 0) + lost < patches:
        return Problem("patches missing in the log", f"{count}, {patches} patches\n{case!r}")
    if last is not None and len(last.poses) not in {len(answer.path) for answer in answers}:
        return Problem("another path in the log", f"{len(last.poses)} poses\n{case!r}")
    return None
