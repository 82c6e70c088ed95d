"""What users may set of a planner and of a query: name, type, range and words of each option, and
tables of what they choose by name.

Calls take these as keywords. Commands make their options of those with a description, and the page
its parameters of the types, so that each is explained here alone; what is not given keeps its
default. Nothing heavy is imported, so that `--help` is instant.
"""

import math
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypedDict

from msgspec import Meta

if TYPE_CHECKING:
    from pathlib import Path

    from nnpp_edge.runtime.arrays import Float2D
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.robots.slope.cost import Mobility
    from nnpp_edge.runtime.terrain.vehicle import Vehicle

CELLS = "cells"
STATES = "states"
"""What a robot's search goes over: points and discs, and bodies (`robots.robot.CellMoves`)."""


class Entry(NamedTuple):
    """A way of planning. All that commands, page, profiles, docs and planners know of it."""

    name: str
    help: str
    find: str
    """Name of a method of `planners.methods.Methods`, of (query, work); or ``module:function`` of
    (methods, query, work), imported when first asked for. It returns a `Found`, or None where the
    next way is to be tried. Empty of one that `chooses`.
    """
    needs: frozenset[str] = frozenset()
    """Of ``levels`` and ``network``."""
    bound: float = math.inf
    """No path of it costs more than so many times the optimum: 1 is exact, inf is not known."""
    robots: frozenset[str] = frozenset((CELLS, STATES))
    """For which robots it is."""
    instead: tuple[str, str] = ("", "")
    """The method that plans for other robots, and why, which their plans tell; without one they are
    refused."""
    keeps: str = ""
    """Of one that is kept from query to query, on a map that changes: that whose steps it makes."""
    chooses: bool = False
    """Whether it is one of the others, by figures."""
    in_slices: bool = False
    """Whether the loop may let it go on from tick to tick."""


_LEVELS = frozenset(("levels",))
_NETWORK = frozenset(("levels", "network"))
_CELLS = frozenset((CELLS,))
_NO_NETWORK = "no network is used for a vehicle's body: the corridor is as fast, closer to optimal"
_NO_REPAIRS = "D* Lite does not plan for a vehicle's body: it is searched afresh"
METHODS = {
    entry.name: entry
    for entry in (
        Entry(
            "auto",
            "picks one by measured figures, and says why",
            "",
            _LEVELS,
            chooses=True,
            in_slices=True,
        ),
        Entry("astar", "exact, over the whole map", "search_map", bound=1.0),
        Entry(
            "corridor",
            "coarse to fine, without learning",
            "corridor",
            _LEVELS,
            in_slices=True,
        ),
        Entry(
            "nnpp",
            "inside the network's region (the paper)",
            "network_region",
            _NETWORK,
            robots=_CELLS,
            instead=("corridor", _NO_NETWORK),
        ),
        Entry(
            "dstar",
            "D* Lite over the whole map: exact, repaired from step to step",
            "mend_map",
            bound=1.0,
            robots=_CELLS,
            instead=("astar", _NO_REPAIRS),
            keeps="astar",
        ),
        Entry(
            "corridor-dstar",
            "D* Lite in the corridor",
            "mended_corridor",
            _LEVELS,
            robots=_CELLS,
            instead=("corridor", _NO_REPAIRS),
            keeps="corridor",
        ),
        Entry(
            "nnpp-dstar",
            "D* Lite in the network's region (the paper's D*NN)",
            "mended_region",
            _NETWORK,
            robots=_CELLS,
            instead=("corridor", _NO_NETWORK),
            keeps="nnpp",
        ),
    )
}
"""Ways of planning, by name; those that `keeps` say are for maps that change alone."""
STILL = {name: entry.help for name, entry in METHODS.items() if not entry.keeps}
"""Names and words of the ways of planning on a map that stands."""
STEP_COSTS = {
    "paper": "ground (paper)",
    "tobler": "time on foot (Tobler)",
    "linear": "slope (linear)",
    "time": "vehicle's time",
    "energy": "vehicle's energy",
}
"""What a step costs on a map of heights; those by the slope are `robots.slope.cost.SLOPE_COSTS`."""


PRIORS = ("network", "slope")
"""By what unseen ground is priced, see `network.priors`; the first by default."""


class Term(NamedTuple):
    """A term of Eq. 1, and the attributes of `Traversability` that limit and weigh it."""

    words: str
    unit: str
    """Of the limits; of degrees kernels take radians."""
    limit: str
    weight: str
    hard: str

    def told(self, value: float) -> float:
        """A value of the kernels in the unit of the limits."""
        return math.degrees(value) if self.unit == "°" else value


TERMS = (
    Term("slope", "°", "slope_limit_deg", "slope_weight", "hard_slope_deg"),
    Term("roughness", " m", "roughness_limit_m", "roughness_weight", "hard_roughness_m"),
    Term("elevation difference", " m", "step_limit_m", "step_weight", "hard_step_m"),
)
"""The terms of Eq. 1 that heights make, in the order of `kernels.records.Terms`."""
LAYER_TERMS: tuple[Term, ...] = ()
"""Those of layers that are given with the heights; their words are the layers' names."""


class Kind(NamedTuple):
    """A kind of vehicle: what makes one, and its robot on a map."""

    name: str
    key: str
    """The value of `Vehicle` without which it is none."""
    robot: str
    """``module:function`` of (state, vehicle, sides_m): its `Robot` on a `MapState` being made."""
    by_heights: bool = True
    """Whether it stands by heights, not by costs alone; else it has no other values."""


KINDS = (
    Kind("disc", "radius_m", "nnpp_edge.runtime.robots.disc:disc_on", by_heights=False),
    Kind("body", "length_m", "nnpp_edge.runtime.robots.body.robot:body_on"),
)
"""A vehicle is of the first kind whose key it has."""


Omega = Annotated[
    float,
    Meta(
        ge=0.0,
        description="Weight of the cost against length, per grey level; the paper's 0.011 by "
        "default. Of no effect where steps cost by the slope.",
    ),
]
CornerCutting = Annotated[
    bool,
    Meta(description="Allow diagonal steps beside impassable cells, as by default."),
]
Heading = Annotated[float, Meta(ge=0.0, le=360.0)]


class StepOptions(TypedDict, total=False):
    """Of the options of a planner those that commands have: what a step over the map costs, and
    which steps are allowed.
    """

    omega: Omega
    corner_cutting: CornerCutting


class GroundOptions(TypedDict, total=False):
    """Attributes of `Ground`, beside heights and limits."""

    cell_width_m: float | None
    vehicle: "Vehicle | None"
    step_cost: str
    mobility: "Mobility | None"
    prior: str
    layers: "dict[str, Float2D]"


class PlannerOptions(GroundOptions, StepOptions, total=False):
    """What a planner is made with beside its map: the options of `Planner` and `DynamicPlanner`,
    and of their `of_elevation`.
    """

    lazy: bool
    """Whether costs of heights are computed, and poses checked, only where searched, as by
    default. Else all are now; plans are the same. Costs of steps by the slope always are."""
    warn: bool
    """Whether to warn of heights whose slopes all lie beyond the limits; by default `of_elevation`
    does.
    """
    model: "str | Path | NetworkModel"
    """The network for ``nnpp``: a shipped model's name (by default ``edge``), a file, or one
    already loaded, which planners may share. It is loaded when first needed."""
    ask_from: int
    """Cells between start and goal from which on ``nnpp`` runs the network. Nearer goals A* has
    mostly found before it has answered, and is tried first."""


class PlanOptions(TypedDict, total=False):
    """How a query is to be answered: the options of `Planner.plan` and `plan_via`."""

    method: Annotated[
        str,
        Meta(
            description="Way of planning; auto, the default, picks one.",
            extra={"choices": STILL},
        ),
    ]
    """``astar``: exact, over the whole map. ``corridor``: coarse to fine. ``nnpp``: inside the
    network's region; goals nearer than `ask_from` by A*, where the way is not long; with a
    vehicle's body the corridor. ``auto``: one of them, by the figures in
    docs/decisions/methods.md; the plan says which and why."""
    epsilon: Annotated[
        float,
        Meta(
            ge=0.0,
            description="Keep widening until the path is certain to cost at most this share above "
            "the optimum; 0 gives the optimum. By default the first path found is taken.",
        ),
    ]
    time_limit_s: Annotated[
        float,
        Meta(
            gt=0.0,
            description="Seconds for one planning. After these the status is TIMEOUT, with the "
            "path as far as a search of the map had come.",
        ),
    ]
    """inf by default. What has been made ready of the map by then is kept, so that the next query
    comes further. Neither loading a network nor running it can be stopped."""
    keep_regions: bool
    """Whether the plan says in what region it was found; copied after the clock has stopped."""
    refine: (
        Annotated[
            str,
            Meta(
                description="Free the path from the grid: adds way points.",
                extra={"choices": ["any-angle"]},
            ),
        ]
        | None
    )
    """``any-angle``, see `planners.refine`. The plan gains `waypoints` and `line_cost`; its path
    and cost stay the grid's."""
    start_heading_deg: (
        Annotated[
            Heading,
            Meta(
                description="Heading of a body at the start, degrees clockwise from grid north; "
                "any by default.",
            ),
        ]
        | None
    )
    """The nearest of the sixteen directions counts, at most 14° off on square cells."""
    goal_heading_deg: (
        Annotated[Heading, Meta(description="Heading of a body at the goal, likewise.")] | None
    )
    goal_tolerance_deg: Annotated[
        float,
        Meta(ge=0.0, description="Greatest deviation from the heading at the goal; 0 by default."),
    ]
    """A body arrives in a direction so near to the heading, or in the nearest."""
