"""Profiles: a device, a workload, a model, and budgets, read from TOML."""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from nnpp_edge.profiling.quantities import DIRECTIONS, QUANTITIES
from nnpp_edge.runtime.errors import InvalidQueryError

PLANNERS = ("astar", "corridor", "nnpp", "nnpp-fp32", "auto")
LOOP_METHODS = ("auto", "astar", "dstar", "corridor", "corridor-dstar", "nnpp", "nnpp-dstar")
SAMPLE, SYNTHETIC = "sample", "synthetic"
_SHIPPED = Path(str(files("nnpp_edge.profiles")))
_LEAST_SIDE = 16
_FASTEST_HZ = 1000.0


class ProfileError(InvalidQueryError):
    """A profile that cannot be used; the message names the file and the key."""


@dataclass(frozen=True)
class Device:
    """Where the run takes place."""

    cores: tuple[int, ...]
    """Numbers of the cores to pin to."""
    threads: int | None = None
    """Of onnxruntime; None for what the runtime chooses by the network's size."""
    spinning: bool = False
    """Whether onnxruntime's threads spin after a run."""


@dataclass(frozen=True)
class Load:
    """What is planned."""

    terrain: tuple[str, ...] = (SAMPLE,)
    """Elevation files, ``sample`` for the one that travels with the package, or ``synthetic``."""
    rescale: float | None = None
    """Side of a cell in metres that the terrain is rescaled to, slopes kept."""
    cell_size: float | None = None
    """Side of a cell in metres, where the files do not say."""
    workloads: tuple[str, ...] = ("soft",)
    sizes: tuple[int, ...] = (256,)
    queries: int = 60
    """For each workload and size."""
    near: int = 20
    """Queries of shorter distances besides, which only the break-even is found from."""
    repeats: int = 2
    """Times each planner answers each query, in each half of the run."""
    min_distance: float = 0.35
    """Between start and goal, as a share of the map's side."""
    seed: int = 1


@dataclass(frozen=True)
class Networks:
    """The model in both precisions."""

    int8: str = "edge"
    fp32: str | None = None
    """None: not measured."""


@dataclass(frozen=True)
class Stability:
    """When a run is called noisy."""

    halves: float = 0.15
    """Share by which the medians of the two halves of the run may differ."""
    disturbance: float = 0.10
    """Share of the cores' time that others may take."""


@dataclass(frozen=True)
class OnboardLoop:
    """How `nnpp-edge run` plans on this device."""

    rate_hz: float = 17.0
    method: str = "auto"
    """As `DynamicPlanner` takes it."""
    model: str = "edge"
    """By default the profile's int8 model."""
    cores: tuple[int, ...] = ()
    """To pin the loop's thread to; by default the device's, and without a profile none."""
    priority: int = 0
    """Under SCHED_FIFO; 0 for the usual scheduler."""
    tolerance: float = 0.02
    """A standing path is kept while it cannot cost more than this share above what a new plan might."""
    corner_cutting: bool = True


@dataclass(frozen=True)
class Budget:
    """One line of the table of budgets."""

    name: str
    quantity: str
    limit: float
    direction: str
    unit: str
    planner: str
    workload: str | None = None
    """None: at each of the profile's."""
    size: int | None = None


@dataclass(frozen=True)
class Profile:
    """All that a run of `nnpp-edge profile` needs to know."""

    name: str
    title: str
    planner: str
    """Whom budgets judge that do not name a planner."""
    device: Device
    load: Load
    networks: Networks = field(default_factory=Networks)
    stability: Stability = field(default_factory=Stability)
    budgets: tuple[Budget, ...] = ()
    loop: OnboardLoop = field(default_factory=OnboardLoop)

    def facts(self) -> dict[str, Any]:
        """For JSON: terrain by name only; without the loop, which is not measured."""
        told = asdict(self)
        del told["loop"]
        told["load"]["terrain"] = [Path(each).name for each in self.load.terrain]
        return told


def shipped_profiles() -> list[str]:
    """Names of the profiles that travel with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def read_profile(name: str | Path) -> Profile:
    """A shipped profile by its name, or one from a TOML file.

    Raises
    ------
    ProfileError
        There is no such profile, or a key is missing, unknown, of the wrong type or out of range.
    """
    path = _SHIPPED / f"{name}.toml"
    if not path.is_file():
        path = Path(name)
    if not path.is_file():
        raise ProfileError(
            f"wanted a profile's file or the name of a shipped one ({', '.join(shipped_profiles())}), "
            f"got {str(name)!r}"
        )
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ProfileError(f"{path}: wanted a profile in TOML, got: {' '.join(str(error).split())}") from error
    return _profile(_Table(path.name, "", content), path.stem)


def overridden(profile: Profile, **changes: Any) -> tuple[Profile, list[str]]:
    """The profile with another load, as options on the command line ask for; None changes nothing.

    Also the names of the budgets that were left out because their size is no longer measured.
    """
    load = replace(profile.load, **{key: value for key, value in changes.items() if value is not None})
    _check_load(load, lambda key, wanted, got: ProfileError(f"{key}: wanted {wanted}, got {got!r}"))
    kept = tuple(budget for budget in profile.budgets if budget.size is None or budget.size in load.sizes)
    dropped = [budget.name for budget in profile.budgets if budget not in kept]
    return replace(profile, load=load, budgets=kept), dropped


def overridden_loop(loop: OnboardLoop, **changes: Any) -> OnboardLoop:
    """The loop as options on the command line ask for; None changes nothing. ProfileError if out of range."""
    changed = replace(loop, **{key: value for key, value in changes.items() if value is not None})
    _check_loop(changed, lambda key, wanted, got: ProfileError(f"{key}: wanted {wanted}, got {got!r}"))
    return changed


class _Table:
    """A table of the file, whose keys are taken one by one: what is left at the end is unknown."""

    def __init__(self, file: str, place: str, content: Mapping[str, Any]) -> None:
        self.file, self.place, self.content = file, place, dict(content)
        self.known: list[str] = []

    def error(self, key: str, wanted: str, got: object) -> ProfileError:
        return ProfileError(f"{self.file}: {self._name(key)}: wanted {wanted}, got {got!r}")

    def _name(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def table(self, key: str) -> "_Table":
        return _Table(self.file, self._name(key), self.take(key, dict, "a table", {}))

    def take(self, key: str, kind: Any, wanted: str, *default: Any) -> Any:
        """The value of a key, of the wanted type; without a default the key is needed."""
        self.known.append(key)
        if key not in self.content:
            if default:
                return default[0]
            raise ProfileError(f"{self.file}: {self._name(key)} is missing: wanted {wanted}")
        value = self.content.pop(key)
        if not _is(value, kind):
            raise self.error(key, wanted, value)
        return value

    def many(self, key: str, kind: Any, wanted: str, *default: Any) -> tuple[Any, ...]:
        """One value or a list of them without duplicates."""
        value = self.take(key, object, wanted, *default)
        values = tuple(value) if isinstance(value, list | tuple) else (value,)
        if not values or not all(_is(each, kind) for each in values) or len(set(values)) < len(values):
            raise self.error(key, f"{wanted}, or a list of different ones", value)
        return values

    def finish(self) -> None:
        for key in self.content:
            raise ProfileError(f"{self.file}: {self._name(key)} is unknown: wanted one of {', '.join(self.known)}")


def _is(value: Any, kind: Any) -> bool:
    """Of the type; a bool is no number, a whole number is one; inf and NaN are none."""
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _profile(top: _Table, name: str) -> Profile:
    title = top.take("title", str, "a line of text", name)
    planner = top.take("planner", str, f"one of {', '.join(PLANNERS)}", "auto")
    if planner not in PLANNERS:
        raise top.error("planner", f"one of {', '.join(PLANNERS)}", planner)
    device, load = _device(top.table("device")), _load(top.table("workload"))
    table = top.table("model")
    networks = Networks(
        table.take("int8", str, "a model's name or file", Networks.int8),
        table.take("fp32", str, "a model's name or file", None),
    )
    table.finish()
    stability = _stability(top.table("stability"))
    loop = _loop(top.table("loop"), device, networks)
    lines = top.take("budgets", list, "a list of tables", [])
    top.finish()
    budgets: list[Budget] = []
    for at, line in enumerate(lines):
        if not isinstance(line, dict):
            raise top.error(f"budgets[{at}]", "a table", line)
        budgets.append(_budget(_Table(top.file, f"budgets[{at}]", line), planner, load, networks))
        if budgets[-1].name in {budget.name for budget in budgets[:-1]}:
            raise top.error(f"budgets[{at}].name", "a name of its own", budgets[-1].name)
    if planner == "nnpp-fp32" and networks.fp32 is None:
        raise top.error("planner", "a planner that is measured (model.fp32 is not set)", planner)
    return Profile(name, title, planner, device, load, networks, stability, tuple(budgets), loop)


def _device(table: _Table) -> Device:
    cores = table.many("cores", int, "the number of a core", (0,))
    if min(cores) < 0:
        raise table.error("cores", "numbers of cores from 0", list(cores))
    threads = table.take("threads", int, "a whole number of at least 1", None)
    if threads is not None and threads < 1:
        raise table.error("threads", "a whole number of at least 1", threads)
    device = Device(cores, threads, table.take("spinning", bool, "true or false", Device.spinning))
    table.finish()
    return device


def _load(table: _Table) -> Load:
    number = "a number"
    load = Load(
        terrain=table.many("terrain", str, f"a file, {SAMPLE!r} or {SYNTHETIC!r}", Load.terrain),
        rescale=table.take("rescale", float, number, None),
        cell_size=table.take("cell_size", float, number, None),
        workloads=table.many("workloads", str, "a workload such as 'soft' or 'limit20'", Load.workloads),
        sizes=table.many("sizes", int, "the side of a map in cells", Load.sizes),
        queries=table.take("queries", int, "a whole number", Load.queries),
        near=table.take("near", int, "a whole number", Load.near),
        repeats=table.take("repeats", int, "a whole number", Load.repeats),
        min_distance=table.take("min_distance", float, number, Load.min_distance),
        seed=table.take("seed", int, "a whole number", Load.seed),
    )
    table.finish()
    _check_load(load, table.error)
    return load


def _check_load(load: Load, error: Callable[[str, str, Any], ProfileError]) -> None:
    """What every load must fulfil, whether from a file or from the command line."""
    from nnpp_edge.terrain.workloads import workload

    for name in load.workloads:
        try:
            workload(name)
        except InvalidQueryError:
            raise error("workloads", "'soft' or 'limitN' with N in (0, 90) degrees", name) from None
    if min(load.sizes) < _LEAST_SIDE or len(set(load.sizes)) < len(load.sizes):
        raise error("sizes", f"different sides of at least {_LEAST_SIDE} cells", list(load.sizes))
    for key, least in (("queries", 1), ("near", 0), ("repeats", 1), ("seed", 0)):
        if getattr(load, key) < least:
            raise error(key, f"a whole number of at least {least}", getattr(load, key))
    if not 0.0 < load.min_distance <= 1.0:
        raise error("min_distance", "a share in (0, 1]", load.min_distance)
    for key in ("rescale", "cell_size"):
        if (value := getattr(load, key)) is not None and not (value > 0.0 and math.isfinite(value)):
            raise error(key, "metres above 0", value)
    if len(load.terrain) > 1 and SYNTHETIC in load.terrain:
        raise error("terrain", f"{SYNTHETIC!r} alone, or files", list(load.terrain))


def _stability(table: _Table) -> Stability:
    found = Stability(
        table.take("halves", float, "a share", Stability.halves),
        table.take("disturbance", float, "a share", Stability.disturbance),
    )
    table.finish()
    for key in ("halves", "disturbance"):
        if getattr(found, key) <= 0.0:
            raise table.error(key, "a share above 0", getattr(found, key))
    return found


def _loop(table: _Table, device: Device, networks: Networks) -> OnboardLoop:
    loop = OnboardLoop(
        rate_hz=float(table.take("rate_hz", float, "ticks a second", OnboardLoop.rate_hz)),
        method=table.take("method", str, "a planner's name", OnboardLoop.method),
        model=table.take("model", str, "a model's name or file", networks.int8),
        cores=table.many("cores", int, "the number of a core", device.cores),
        priority=table.take("priority", int, "a whole number", OnboardLoop.priority),
        tolerance=float(table.take("tolerance", float, "a share", OnboardLoop.tolerance)),
        corner_cutting=table.take("corner_cutting", bool, "true or false", OnboardLoop.corner_cutting),
    )
    table.finish()
    _check_loop(loop, table.error)
    return loop


def _check_loop(loop: OnboardLoop, error: Callable[[str, str, Any], ProfileError]) -> None:
    """What every loop must fulfil, whether from a file or from the command line."""
    if loop.method not in LOOP_METHODS:
        raise error("method", f"one of {', '.join(LOOP_METHODS)}", loop.method)
    if not 0.0 < loop.rate_hz <= _FASTEST_HZ:
        raise error("rate_hz", f"ticks a second, above 0 and at most {_FASTEST_HZ:g}", loop.rate_hz)
    if min(loop.cores, default=0) < 0:
        raise error("cores", "numbers of cores from 0", list(loop.cores))
    if not 0 <= loop.priority <= 99:
        raise error("priority", "0, or 1 to 99 for SCHED_FIFO", loop.priority)
    if not 0.0 <= loop.tolerance < math.inf:
        raise error("tolerance", "a share of at least 0", loop.tolerance)


def _budget(table: _Table, planner: str, load: Load, networks: Networks) -> Budget:
    name = table.take("name", str, "a name of its own")
    quantity = table.take("quantity", str, "a quantity")
    if quantity not in QUANTITIES:
        raise table.error("quantity", f"one of {', '.join(QUANTITIES)}", quantity)
    limit = float(table.take("limit", float, "a number"))
    direction = table.take("direction", str, " or ".join(map(repr, DIRECTIONS)))
    if direction not in DIRECTIONS:
        raise table.error("direction", " or ".join(map(repr, DIRECTIONS)), direction)
    unit = table.take("unit", str, f"the unit of {quantity}")
    if unit != QUANTITIES[quantity].unit:
        raise table.error("unit", f"{QUANTITIES[quantity].unit!r}, the unit of {quantity}", unit)
    measured = [p for p in PLANNERS if networks.fp32 is not None or p != "nnpp-fp32"]
    judged = table.take("planner", str, f"one of {', '.join(measured)}", planner)
    if judged not in measured:
        raise table.error("planner", f"one of {', '.join(measured)}", judged)
    if quantity == "int8_speedup" and networks.fp32 is None:
        raise table.error("quantity", "one that is measured (model.fp32 is not set)", quantity)
    workload, size = table.take("workload", str, "a workload", None), table.take("size", int, "a size", None)
    if workload is not None and workload not in load.workloads:
        raise table.error("workload", f"one of {', '.join(load.workloads)}", workload)
    if size is not None and size not in load.sizes:
        raise table.error("size", f"one of {', '.join(map(str, load.sizes))}", size)
    table.finish()
    return Budget(name, quantity, limit, direction, unit, judged, workload, size)
