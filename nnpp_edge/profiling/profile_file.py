"""Profiles: a device, a workload, a model, and budgets, read from TOML."""

import re
import tomllib
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, TypeVar, cast

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, fields, replace

from nnpp_edge.profiling.contention import Contention
from nnpp_edge.profiling.quantities import DIRECTIONS, LOOP, QUANTITIES
from nnpp_edge.profiling.tables import LARGEST, Core, Count, Finite, Names, Positive, ProfileError, Table, Whole
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, reason

PLANNERS = ("astar", "corridor", "nnpp", "nnpp-fp32", "auto")
LOOP_METHODS = ("auto", "astar", "dstar", "corridor", "corridor-dstar", "nnpp", "nnpp-dstar")
SAMPLE, SYNTHETIC = "sample", "synthetic"
_SHIPPED = Path(str(files("nnpp_edge.profiles")))


class Device(Table, frozen=True):
    """Where the run takes place."""

    cores: Annotated[tuple[Core, ...], Meta(min_length=1)] = (0,)
    """Numbers of the cores to pin to."""
    threads: Count | None = None
    """Of onnxruntime; None for what the runtime chooses by the network's size."""

    def __post_init__(self) -> None:
        self.check_different("cores")


class Load(Table, frozen=True):
    """Maps and queries to plan on."""

    terrain: Names = (SAMPLE,)
    """Elevation files, ``sample`` for the one that travels with the package, or ``synthetic``."""
    rescale: Positive | None = None
    """Side of a cell in metres that the terrain is rescaled to, slopes kept."""
    cell_size: Positive | None = None
    """Side of a cell in metres, where the files do not say."""
    allow_vrt: bool = False
    """Whether a GDAL VRT is read, too."""
    workloads: Names = ("soft",)
    vehicle: str | None = None
    """Name of a shipped one or a TOML file: whose the workloads ``body`` and ``body-rocksN`` are."""
    sizes: Annotated[tuple[Annotated[int, Meta(ge=16, le=1 << 15)], ...], Meta(min_length=1)] = (256,)
    queries: Count = 60
    """For each workload and size."""
    near: Whole = 20
    """Queries of shorter distances besides, which only the break-even is found from."""
    repeats: Count = 2
    """Times each planner answers each query, in each half of the run."""
    min_distance: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.35
    """Between start and goal, as a share of the map's side."""
    seed: Whole = 1

    def __post_init__(self) -> None:
        self.check_different("terrain", "workloads", "sizes")
        mixed = SYNTHETIC in self.terrain and len(self.terrain) > 1
        self.refuse_unless(not mixed, "terrain", f"{SYNTHETIC!r} alone, or files")
        from nnpp_edge.terrain.workloads import of_bodies

        try:
            bodies = of_bodies(self.workloads)
        except InvalidQueryError as error:
            raise ValueError(f"workloads: {error}") from None
        needs = (
            f"a vehicle for the workload {bodies[0]}" if bodies else "none without the workload body or body-rocksN"
        )
        self.refuse_unless(bool(bodies) == (self.vehicle is not None), "vehicle", needs)


class Networks(Table, frozen=True):
    """The model in both precisions."""

    int8: str = "edge"
    fp32: str | None = None
    """None: not measured."""


class Stability(Table, frozen=True):
    """When a run is called noisy."""

    halves: Positive = 0.15
    """Share by which the medians of the two halves of the run may differ."""
    disturbance: Positive = 0.10
    """Share of the cores' time that others may take."""


class OnboardLoop(Table, frozen=True):
    """How `nnpp-edge run` plans on this device."""

    rate_hz: Annotated[float, Meta(ge=0.001, le=1000.0)] = 17.0
    method: str = "auto"
    """As `DynamicPlanner` takes it."""
    model: str = "edge"
    """By default the profile's int8 model."""
    cores: tuple[Core, ...] = ()
    """To pin the loop's thread to; by default the device's, and without a profile none."""
    priority: Annotated[int, Meta(ge=0, le=99)] = 0
    """Under SCHED_FIFO; 0 for the usual scheduler."""
    tolerance: Annotated[float, Meta(ge=0.0, le=LARGEST)] = 0.02
    """A standing path is kept while it cannot cost more than this share above what a new plan might."""
    corner_cutting: bool = True
    refine: str = ""
    """As `DynamicPlanner` takes it; empty for paths of cells alone."""
    approach: bool = False
    """Whether paths lead as near to the goal as there is a way, where none leads to it."""

    def __post_init__(self) -> None:
        self.check_choice("method", LOOP_METHODS)
        self.check_choice("refine", ("", "any-angle"))
        self.check_different("cores")


class Budget(Table, frozen=True):
    """One line of the table of budgets."""

    name: str
    quantity: str
    limit: Finite
    direction: str
    unit: str
    planner: str = ""
    """By default the profile's; for what the loop does there is none but ``loop``."""
    workload: str | None = None
    """None: at each of the profile's."""
    size: int | None = None

    def __post_init__(self) -> None:
        self.check_choice("quantity", QUANTITIES)
        self.check_choice("direction", DIRECTIONS)
        unit = QUANTITIES[self.quantity].unit
        self.refuse_unless(self.unit == unit, "unit", f"{unit!r}, the unit of {self.quantity}")

    def check(self, profile: "Profile") -> None:
        """Refuse what this profile does not measure."""
        self.check_choice("planner", (LOOP,) if QUANTITIES[self.quantity].of_loop else profile.measured)
        known = self.quantity != "int8_speedup" or profile.networks.fp32 is not None
        self.refuse_unless(known, "quantity", "one that is measured (model.fp32 is not set)")
        if self.workload is not None:
            self.check_choice("workload", profile.load.workloads)
        sizes = profile.load.sizes
        self.refuse_unless(self.size in (None, *sizes), "size", f"one of {', '.join(map(str, sizes))}")


class _File(Table, frozen=True):
    """The whole file, as it is written."""

    title: str = ""
    planner: str = "auto"
    device: Device = Device()
    workload: Load = msgspec.field(default_factory=Load)
    model: Networks = Networks()
    stability: Stability = Stability()
    loop: OnboardLoop = OnboardLoop()
    contention: Contention = Contention()
    budgets: tuple[Budget, ...] = ()

    def __post_init__(self) -> None:
        self.check_choice("planner", PLANNERS)


class Profile(msgspec.Struct, frozen=True):
    """All that a run of `nnpp-edge profile` needs to know."""

    name: str
    title: str
    planner: str
    """Whom a budget judges that names no planner."""
    device: Device
    load: Load
    networks: Networks = Networks()
    stability: Stability = Stability()
    budgets: tuple[Budget, ...] = ()
    loop: OnboardLoop = OnboardLoop()
    contention: Contention = Contention()

    @property
    def measured(self) -> tuple[str, ...]:
        """The planners that take part."""
        return tuple(name for name in PLANNERS if self.networks.fp32 is not None or name != "nnpp-fp32")

    @property
    def arriving(self) -> frozenset[str]:
        """The planners that are also measured on maps and patches that have just arrived."""
        asked = {each.planner for each in self.budgets if QUANTITIES[each.quantity].basis in ("map", "patch")}
        return frozenset(asked | {self.planner})

    @property
    def reactions_at(self) -> frozenset[tuple[str, int]]:
        """Workloads and sizes at which the loop's reactions are measured: where a budget asks for them."""
        asked = [each for each in self.budgets if QUANTITIES[each.quantity].of_loop]
        return frozenset(place for each in asked for place in self.places(each))

    def places(self, budget: Budget) -> list[tuple[str, int]]:
        """Workloads and sizes at which a budget is judged."""
        workloads = (budget.workload,) if budget.workload else self.load.workloads
        return list(product(workloads, (budget.size,) if budget.size else self.load.sizes))

    def facts(self) -> dict[str, object]:
        """For JSON: terrain and vehicle by name only; without the loop, which is not measured."""
        vehicle = self.load.vehicle and Path(self.load.vehicle).name
        load = replace(self.load, terrain=tuple(Path(each).name for each in self.load.terrain), vehicle=vehicle)
        facts: dict[str, object] = msgspec.to_builtins(replace(self, load=load))
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
    if problem_with_file(path):
        path = Path(name)
    if (problem := problem_with_file(path)) is not None:
        wanted = f"wanted a profile's file or the name of a shipped one ({', '.join(shipped_profiles())})"
        raise ProfileError(f"{wanted}, got {str(name)!r} ({problem})")
    try:
        content = parse(read_text(path), tomllib.loads)
    except (OSError, ValueError) as error:
        raise ProfileError(f"{path}: wanted a profile in TOML ({reason(error)})") from error
    try:
        return _profile(content, path.stem)
    except ProfileError as error:
        raise ProfileError(f"{path.name}: {error}") from None


def overridden(profile: Profile, **changes: object) -> tuple[Profile, list[str]]:
    """The profile with another load, as options on the command line ask for; None changes nothing.

    Also the names of the budgets that were left out because their size is no longer measured.
    """
    load = _changed(profile.load, changes)
    kept = tuple(budget for budget in profile.budgets if budget.size is None or budget.size in load.sizes)
    dropped = [budget.name for budget in profile.budgets if budget not in kept]
    return replace(profile, load=load, budgets=kept), dropped


def overridden_loop(loop: OnboardLoop, **changes: object) -> OnboardLoop:
    """The loop as options on the command line ask for; None changes nothing. ProfileError if out of range."""
    return _changed(loop, changes)


TableT = TypeVar("TableT", bound=Table)


def _changed(table: TableT, changes: dict[str, object]) -> TableT:
    given = {key: value for key, value in changes.items() if value is not None}
    return _converted(asdict(table) | given, type(table))


_LISTS = {
    "device": ("cores",),
    "loop": ("cores",),
    "contention": ("cores", "command"),
    "workload": ("terrain", "workloads", "sizes"),
}
"""Keys, by table, whose value may stand alone."""


def _profile(content: dict[str, object], name: str) -> Profile:
    for place, keys in _LISTS.items():
        table = content.get(place)
        for key in keys:
            if isinstance(table, dict) and key in table and not isinstance(table[key], list):
                table[key] = [table[key]]
    file = _converted(content, _File)
    own = cast(dict[str, object], content.get("loop", {}))
    inherited = {"cores": file.device.cores, "model": file.model.int8}
    loop = replace(file.loop, **{key: inherited[key] for key in inherited.keys() - own.keys()})
    budgets = tuple(replace(each, planner=each.planner or _default_planner(each, file)) for each in file.budgets)
    parts = (file.device, file.workload, file.model, file.stability, budgets, loop, file.contention)
    profile = Profile(name, file.title or name, file.planner, *parts)
    if file.planner not in profile.measured:
        raise ProfileError(f"planner: wanted one that is measured (model.fp32 is not set), got {file.planner!r}")
    names = [budget.name for budget in budgets]
    for at, budget in enumerate(budgets):
        try:
            budget.check(profile)
            budget.refuse_unless(budget.name not in names[:at], "name", "a name of its own")
        except ValueError as error:
            raise ProfileError(f"budgets[{at}].{error}") from None
    return profile


def _default_planner(budget: Budget, file: _File) -> str:
    return LOOP if QUANTITIES[budget.quantity].of_loop else file.planner


def _converted(content: dict[str, object], kind: type[TableT]) -> TableT:
    """The table; ProfileError names the key, what was wanted and what came."""
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        problem, _, place = str(error).replace("`", "").partition(" - at $")
        raise ProfileError(_explained(problem, place.strip("."), content)) from None


_WORDS = {
    "object": "a table",
    "array": "a list",
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    " | null": "",
    ">=": "of at least",
    "<=": "of at most",
    ">": "above",
}
"""Kinds of values, in msgspec's words and in ours."""


def _explained(problem: str, place: str, content: object) -> str:
    """msgspec's sentence on a key as ours, with the value that came."""
    before = f"{place}." if place else ""
    if unknown := re.fullmatch(r"Object contains unknown field (.*)", problem):
        tables = {field.name: field.type for field in fields(_File)} | {"": _File, "budgets": Budget}
        known = [field.name for field in fields(tables[place.partition("[")[0]])]
        return f"{before}{unknown[1]} is unknown: wanted one of {', '.join(known)}"
    if missing := re.fullmatch(r"Object missing required field (.*)", problem):
        return f"{before}{missing[1]} is missing"
    if not problem.startswith("Expected "):
        return before + problem
    wanted = problem.removeprefix("Expected ").partition(", got")[0]
    for theirs, ours in _WORDS.items():
        wanted = wanted.replace(theirs, ours)
    for key in re.findall(r"\w+", place):
        content = content[int(key)] if isinstance(content, list | tuple) else cast(dict[str, object], content)[key]
    return f"{place}: wanted {wanted}, got {content!r}"
