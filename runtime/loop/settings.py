"""Settings of the onboard loop, as a profile's table [loop] and options of `run` give them."""

from typing import Annotated

from msgspec import Meta
from msgspec.structs import asdict

from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.options import Omega
from nnpp_edge.runtime.planners.plan import DynamicMethod
from nnpp_edge.runtime.reading import Table
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA

Core = Annotated[int, Meta(ge=0, le=1023)]
"""As many as the kernel's set of cores holds."""


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
    tolerance: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.02
    """A standing path is kept while it cannot cost more than this share above what a new plan
    might.
    """
    omega: Omega = PAPER_OMEGA
    corner_cutting: bool = True
    snap_radius: Annotated[int, Meta(ge=0, le=2**31 - 1)] = 3
    """Cells; how far from a robot in an impassable cell its path may begin."""
    refine: str = ""
    """As `DynamicPlanner` takes it; empty for paths of cells alone."""
    approach: bool = False
    """Whether paths lead as near to the goal as there is a way, where none leads to it."""
    slice_ms: Annotated[float, Meta(ge=0.0, le=1e6)] = 10.0
    """Milliseconds that a tick searches for a corridor; what takes longer goes on in the next."""

    def __post_init__(self) -> None:
        self.check_choice("method", tuple(DynamicMethod))
        self.refuse_unless(self.refine in ("", "any-angle"), "refine", "'any-angle' or ''")
        self.check_different("cores")

    def navigator(self, ground: Ground) -> Navigator:
        """A navigator on this ground; errors as of `Navigator`."""
        options = asdict(self) | {"refine": self.refine or None}
        for name in ("rate_hz", "cores", "priority"):  # the loop's own
            del options[name]
        return Navigator(ground, **options)
