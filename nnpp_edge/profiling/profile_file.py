"""Profiles: a device, a workload, a model, and budgets on quantities, read from TOML."""

from importlib.resources import files
from itertools import chain, product
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, replace

from nnpp_edge.profiling.quantities import EXACT, QUANTITIES, THOUSANDTH
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.settings import Core, OnboardLoop
from nnpp_edge.runtime.options import METHODS, STILL
from nnpp_edge.runtime.reading import Table, changed, converted, read_toml
from nnpp_edge.terrain.workloads import of_bodies

_CHOSEN = [name for name in STILL if METHODS[name].chooses]
PLANNERS = (*(name for name in STILL if name not in _CHOSEN), "nnpp-fp32", "paper", *_CHOSEN)
SAMPLE = "sample"
SYNTHETIC = "synthetic"
LOOP = "loop"
"""Stands in place of a planner's name in figures of the onboard loop."""
SHIPPED = Path(str(files("nnpp_edge.profiles")))
_LARGEST = 1e9
"""Neither inf nor NaN is a number here, and products of two stay finite."""

_Whole = Annotated[int, Meta(ge=0, le=2**31 - 1)]
_Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
_Side = Annotated[int, Meta(ge=16, le=1 << 15)]
_Finite = Annotated[float, Meta(ge=-_LARGEST, le=_LARGEST)]
_Positive = Annotated[float, Meta(gt=0.0, le=_LARGEST)]
_Names = Annotated[tuple[str, ...], Meta(min_length=1)]


class ProfileError(InvalidQueryError):
    """A profile that cannot be used; the message names the file and the key."""


class Device(Table, frozen=True):
    """Where the run takes place."""

    cores: Annotated[tuple[Core, ...], Meta(min_length=1)] = (0,)
    """Numbers of the cores to pin to."""
    threads: _Count | None = None
    """Of onnxruntime; None for what the runtime chooses by the network's size."""

    def __post_init__(self) -> None:
        self.check_different("cores")


class Load(Table, frozen=True):
    """Maps and queries to plan on, as the table `workload` of docs/profile.md has them."""

    terrain: _Names = (SAMPLE,)
    """Elevation files, ``sample`` for the one that travels with the package, or ``synthetic``."""
    rescale: _Positive | None = None
    """Side of a cell in metres that the terrain is rescaled to, slopes kept."""
    cell_size: _Positive | None = None
    """Side of a cell in metres, where the files do not say."""
    workloads: _Names = ("soft",)
    vehicle: str | None = None
    """Name of a shipped one or a TOML file: whose the workloads ``body`` and
    ``body-rocksN`` are.
    """
    sizes: Annotated[tuple[_Side, ...], Meta(min_length=1)] = (256,)
    queries: _Count = 60
    """Number of them for each workload and size."""
    repeats: _Count = 2
    """Times each planner answers each query, in each half of the run."""
    patches: _Count = 120
    """That the loop is given in each half of the run, where a budget is set on its reactions."""
    min_distance: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.35
    """Between start and goal, as a share of the map's side."""
    seed: _Whole = 1

    def __post_init__(self) -> None:
        self.check_different("terrain", "workloads", "sizes")
        mixed = SYNTHETIC in self.terrain and len(self.terrain) > 1
        self.refuse_unless(not mixed, "terrain", f"{SYNTHETIC!r} alone, or files")
        try:
            bodies = of_bodies(self.workloads)
        except InvalidQueryError as error:
            raise ValueError(f"workloads: {error}") from None
        wanted = "none without the workload body or body-rocksN"
        if bodies:
            wanted = f"a vehicle for the workload {bodies[0]}"
        self.refuse_unless(bool(bodies) == (self.vehicle is not None), "vehicle", wanted)


class Networks(Table, frozen=True):
    int8: str = "edge"
    fp32: str | None = None
    paper: str | None = None
    """The network of the planner ``paper``. None, of both: not measured."""

    @property
    def by_planner(self) -> dict[str, str]:
        """The planners of a run, and the file of the network of each."""
        files = dict.fromkeys(PLANNERS, self.int8) | {"nnpp-fp32": self.fp32, "paper": self.paper}
        return {name: file for name, file in files.items() if file is not None}


class Budget(Table, frozen=True):
    """One line of the table of budgets."""

    name: str
    quantity: str
    limit: _Finite
    direction: str
    unit: str
    planner: str = ""
    """By default the profile's; of quantities of the loop always ``loop``."""
    workload: str | None = None
    """None: at each of the profile's."""
    size: int | None = None

    def __post_init__(self) -> None:
        self.check_choice("quantity", QUANTITIES)
        self.check_choice("direction", ("at least", "at most"))
        unit = QUANTITIES[self.quantity].unit
        self.refuse_unless(self.unit == unit, "unit", f"{unit!r}, the unit of {self.quantity}")

    @property
    def basis(self) -> str:
        """Of what the two halves of a run must agree."""
        return QUANTITIES[self.quantity].basis

    def check(self, profile: "Profile") -> None:
        """Refuse what this profile does not measure."""
        of_loop = QUANTITIES[self.quantity].of_loop
        self.check_choice("planner", (LOOP,) if of_loop else profile.measured)
        enough = self.quantity != "reaction_ms_p999" or 2 * profile.load.patches >= THOUSANDTH
        wanted = f"none of fewer than {THOUSANDTH} reactions (workload.patches: {THOUSANDTH // 2})"
        self.refuse_unless(enough, "quantity", wanted)
        if self.workload is not None:
            self.check_choice("workload", profile.load.workloads)
        if self.size is not None:
            self.check_choice("size", profile.load.sizes)


class Profile(Table, frozen=True):
    """What `nnpp-edge profile` measures, where, and against which budgets; the keys are those of
    the file, with `name` added.
    """

    hidden = "name"
    name: str
    title: str
    planner: str = "auto"
    """The planner of budgets that name none."""
    device: Device = Device()
    load: Load = msgspec.field(default_factory=Load, name="workload")
    networks: Networks = msgspec.field(default_factory=Networks, name="model")
    budgets: tuple[Budget, ...] = ()
    loop: OnboardLoop = OnboardLoop()

    def __post_init__(self) -> None:
        self.check_choice("planner", PLANNERS)

    @property
    def measured(self) -> tuple[str, ...]:
        """The planners of a run."""
        return tuple(self.networks.by_planner)

    @property
    def arriving(self) -> frozenset[str]:
        """The planners that are also measured on maps and patches that have just arrived."""
        of_maps = [each for each in self.budgets if each.basis in ("map", "map_ratio", "patch")]
        exact = {EXACT for each in of_maps if each.basis == "map_ratio"}
        return frozenset({self.planner, *exact, *(each.planner for each in of_maps)})

    def measured_at(self, basis: str) -> frozenset[tuple[str, int]]:
        """Workloads and sizes at which a budget asks for quantities of this basis."""
        asked = [self.places(budget) for budget in self.budgets if budget.basis == basis]
        return frozenset(chain.from_iterable(asked))

    def places(self, budget: Budget) -> list[tuple[str, int]]:
        """Workloads and sizes at which a budget is judged."""
        workloads = (budget.workload,) if budget.workload else self.load.workloads
        return list(product(workloads, (budget.size,) if budget.size else self.load.sizes))

    def facts(self) -> Facts:
        """For JSON: terrain and vehicle by name only; without the loop, which is not measured."""
        terrain = tuple(Path(each).name for each in self.load.terrain)
        vehicle = self.load.vehicle and Path(self.load.vehicle).name
        load = replace(self.load, terrain=terrain, vehicle=vehicle)
        facts: Facts = msgspec.to_builtins(asdict(self) | {"load": load})
        del facts["loop"]
        return facts


def read_profile(name: str | Path) -> Profile:
    """A shipped profile by its name, or one from a TOML file.

    ProfileError if there is no such profile, or a key is missing, unknown, of the wrong type or out
    of range.
    """
    path, content = read_toml(name, SHIPPED, "profile", ProfileError)
    try:
        return _profile(content, path.stem)
    except ValueError as error:
        raise ProfileError(f"{path.name}: {error}") from None


def overridden(profile: Profile, **changes: object) -> tuple[Profile, list[str]]:
    """The profile with another load, as options on the command line ask for; None changes nothing.
    Also a note on the budgets that are left out because their size is no longer measured.
    """
    load = changed(profile.load, **changes)
    kept = tuple(each for each in profile.budgets if each.size in (None, *load.sizes))
    dropped = ", ".join(each.name for each in profile.budgets if each not in kept)
    notes = [f"left out, as their sizes are not measured: {dropped}"] if dropped else []
    return replace(profile, load=load, budgets=kept), notes


def _profile(content: Facts, name: str) -> Profile:
    if "name" in content:
        raise ProfileError("name: a profile is called by its file, got a key")
    read = converted({"title": name, **content, "name": name}, Profile)
    # what the file leaves to other keys: the loop's device and model, the planner of each budget
    left = {"cores": read.device.cores, "model": read.networks.int8}
    loop = converted(left | content.get("loop", {}), OnboardLoop)
    budgets = []
    for budget in read.budgets:
        whose = LOOP if QUANTITIES[budget.quantity].of_loop else read.planner
        budgets.append(replace(budget, planner=budget.planner or whose))
    profile = replace(read, loop=loop, budgets=tuple(budgets))
    if profile.planner not in profile.measured:
        raise ProfileError(
            f"planner: wanted one that is measured (model.fp32 is not set), got {profile.planner!r}"
        )
    for at, budget in enumerate(budgets):
        try:
            budget.check(profile)
        except ValueError as error:
            raise ProfileError(f"budgets[{at}].{error}") from None
    return profile
