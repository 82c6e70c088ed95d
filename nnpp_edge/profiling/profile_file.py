"""Profiles: a device, a workload, a model, and budgets, read from TOML."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from nnpp_edge.profiling.quantities import DIRECTIONS, QUANTITIES
from nnpp_edge.profiling.toml_table import ProfileError, TomlTable
from nnpp_edge.runtime.errors import InvalidQueryError

PLANNERS = ("astar", "corridor", "nnpp", "nnpp-fp32", "auto")
LOOP_METHODS = ("auto", "astar", "dstar", "corridor", "corridor-dstar", "nnpp", "nnpp-dstar")
SAMPLE, SYNTHETIC = "sample", "synthetic"
_SHIPPED = Path(str(files("nnpp_edge.profiles")))
_LEAST_SIDE = 16
_FASTEST_HZ = 1000.0


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
    """Whom a budget judges that names no planner."""
    device: Device
    load: Load
    networks: Networks = field(default_factory=Networks)
    stability: Stability = field(default_factory=Stability)
    budgets: tuple[Budget, ...] = ()
    loop: OnboardLoop = field(default_factory=OnboardLoop)

    def facts(self) -> dict[str, object]:
        """For JSON: terrain by name only; without the loop, which is not measured."""
        load = replace(self.load, terrain=tuple(Path(each).name for each in self.load.terrain))
        facts: dict[str, object] = asdict(replace(self, load=load))
        del facts["loop"]
        return facts


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
    return _profile(TomlTable(path.name, "", content), path.stem)


Error = Callable[[str, str, object], ProfileError]
"""From a key, what was wanted and what came."""


def overridden(profile: Profile, **changes: object) -> tuple[Profile, list[str]]:
    """The profile with another load, as options on the command line ask for; None changes nothing.

    Also the names of the budgets that were left out because their size is no longer measured.
    """
    load = replace(profile.load, **_given(changes))
    _check_load(load, _option_error)
    kept = tuple(budget for budget in profile.budgets if budget.size is None or budget.size in load.sizes)
    dropped = [budget.name for budget in profile.budgets if budget not in kept]
    return replace(profile, load=load, budgets=kept), dropped


def overridden_loop(loop: OnboardLoop, **changes: object) -> OnboardLoop:
    """The loop as options on the command line ask for; None changes nothing. ProfileError if out of range."""
    changed = replace(loop, **_given(changes))
    _check_loop(changed, _option_error)
    return changed


def _given(changes: dict[str, object]) -> dict[str, Any]:
    return {key: value for key, value in changes.items() if value is not None}


def _option_error(key: str, wanted: str, got: object) -> ProfileError:
    return ProfileError(f"{key}: wanted {wanted}, got {got!r}")


def _profile(top: TomlTable, name: str) -> Profile:
    title = top.optional("title", str, "a line of text", name)
    planner = top.choice("planner", PLANNERS, "auto")
    device, load = _device(top.table("device")), _load(top.table("workload"))
    networks = _networks(top.table("model"))
    stability = _stability(top.table("stability"))
    loop = _loop(top.table("loop"), device, networks)
    budgets = _budgets(top, planner, load, networks)
    top.finish()
    if planner == "nnpp-fp32" and networks.fp32 is None:
        raise top.error("planner", "a planner that is measured (model.fp32 is not set)", planner)
    return Profile(name, title, planner, device, load, networks, stability, budgets, loop)


def _device(table: TomlTable) -> Device:
    cores = table.several("cores", int, "the number of a core", (0,))
    if min(cores) < 0:
        raise table.error("cores", "numbers of cores from 0", list(cores))
    threads = table.optional("threads", int, "a whole number of at least 1", None)
    if threads is not None and threads < 1:
        raise table.error("threads", "a whole number of at least 1", threads)
    device = Device(cores, threads, table.optional("spinning", bool, "true or false", Device.spinning))
    table.finish()
    return device


def _networks(table: TomlTable) -> Networks:
    int8 = table.optional("int8", str, "a model's name or file", Networks.int8)
    networks = Networks(int8, table.optional("fp32", str, "a model's name or file", None))
    table.finish()
    return networks


def _load(table: TomlTable) -> Load:
    number, whole = "a number", "a whole number"
    load = Load(
        terrain=table.several("terrain", str, f"a file, {SAMPLE!r} or {SYNTHETIC!r}", Load.terrain),
        rescale=table.optional("rescale", float, number, None),
        cell_size=table.optional("cell_size", float, number, None),
        workloads=table.several("workloads", str, "a workload such as 'soft' or 'limit20'", Load.workloads),
        sizes=table.several("sizes", int, "the side of a map in cells", Load.sizes),
        queries=table.optional("queries", int, whole, Load.queries),
        near=table.optional("near", int, whole, Load.near),
        repeats=table.optional("repeats", int, whole, Load.repeats),
        min_distance=table.optional("min_distance", float, number, Load.min_distance),
        seed=table.optional("seed", int, whole, Load.seed),
    )
    table.finish()
    _check_load(load, table.error)
    return load


def _check_load(load: Load, error: Error) -> None:
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


def _stability(table: TomlTable) -> Stability:
    halves = table.optional("halves", float, "a share", Stability.halves)
    found = Stability(halves, table.optional("disturbance", float, "a share", Stability.disturbance))
    table.finish()
    for key in ("halves", "disturbance"):
        if getattr(found, key) <= 0.0:
            raise table.error(key, "a share above 0", getattr(found, key))
    return found


def _loop(table: TomlTable, device: Device, networks: Networks) -> OnboardLoop:
    loop = OnboardLoop(
        rate_hz=float(table.optional("rate_hz", float, "ticks a second", OnboardLoop.rate_hz)),
        method=table.optional("method", str, "a planner's name", OnboardLoop.method),
        model=table.optional("model", str, "a model's name or file", networks.int8),
        cores=table.several("cores", int, "the number of a core", device.cores),
        priority=table.optional("priority", int, "a whole number", OnboardLoop.priority),
        tolerance=float(table.optional("tolerance", float, "a share", OnboardLoop.tolerance)),
        corner_cutting=table.optional("corner_cutting", bool, "true or false", OnboardLoop.corner_cutting),
    )
    table.finish()
    _check_loop(loop, table.error)
    return loop


def _check_loop(loop: OnboardLoop, error: Error) -> None:
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


def _budgets(top: TomlTable, planner: str, load: Load, networks: Networks) -> tuple[Budget, ...]:
    found: list[Budget] = []
    for at, line in enumerate(top.optional("budgets", list, "a list of tables", [])):
        place = f"budgets[{at}]"
        if not isinstance(line, dict):
            raise top.error(place, "a table", line)
        found.append(_budget(TomlTable(top.file, place, line), planner, load, networks))
        if found[-1].name in {budget.name for budget in found[:-1]}:
            raise top.error(f"{place}.name", "a name of its own", found[-1].name)
    return tuple(found)


def _budget(table: TomlTable, planner: str, load: Load, networks: Networks) -> Budget:
    measured = tuple(p for p in PLANNERS if networks.fp32 is not None or p != "nnpp-fp32")
    name = table.needed("name", str, "a name of its own")
    quantity = table.choice("quantity", tuple(QUANTITIES))
    limit = float(table.needed("limit", float, "a number"))
    words = " or ".join(map(repr, DIRECTIONS))
    direction = table.needed("direction", str, words)
    if direction not in DIRECTIONS:
        raise table.error("direction", words, direction)
    unit = table.needed("unit", str, f"the unit of {quantity}")
    if unit != QUANTITIES[quantity].unit:
        raise table.error("unit", f"{QUANTITIES[quantity].unit!r}, the unit of {quantity}", unit)
    judged = table.choice("planner", measured, planner)
    if quantity == "int8_speedup" and networks.fp32 is None:
        raise table.error("quantity", "one that is measured (model.fp32 is not set)", quantity)
    workload, size = table.optional("workload", str, "a workload", None), table.optional("size", int, "a size", None)
    if workload is not None and workload not in load.workloads:
        raise table.error("workload", f"one of {', '.join(load.workloads)}", workload)
    if size is not None and size not in load.sizes:
        raise table.error("size", f"one of {', '.join(map(str, load.sizes))}", size)
    table.finish()
    return Budget(name, quantity, limit, direction, unit, judged, workload, size)
