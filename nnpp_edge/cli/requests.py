"""The questions that `plan` and `reach` ask: their options' values, as given, which must go together."""

from dataclasses import dataclass
from pathlib import Path

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ends import End


@dataclass(frozen=True)
class PlanRequest:
    """A plan's question: the options' values, as given."""

    start: End
    goals: tuple[End, ...]
    via: tuple[End, ...]
    best_order: bool
    method: str
    model: str
    omega: float
    corner_cutting: bool
    epsilon: float | None
    time_limit: float | None
    compare: bool
    step_cost: str
    refine: str | None
    hillshade: bool

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.best_order and not self.via:
            raise click.UsageError("--best-order is of way points: give --via too")
        if self.via and self.compare:
            raise click.UsageError("--compare is of one leg: leave out --via")

    @property
    def files(self) -> list[Path]:
        """Vector files that are read."""
        return [end.file for end in (self.start, *self.via, *self.goals) if end.file is not None]


@dataclass(frozen=True)
class ReachRequest:
    """From where, and how far: the options' values, as given."""

    start: End
    within_cost: float | None
    within_time: float | None
    within_energy: float | None
    levels: int
    step_cost: str
    omega: float
    corner_cutting: bool

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        from nnpp_edge.runtime.map.slope_cost import unit_of

        if sum(most is not None for most in (self.within_cost, self.within_time, self.within_energy)) != 1:
            raise click.UsageError("give one of --within-cost, --within-time and --within-energy")
        measure, _ = self.most
        in_seconds = measure == "time" and unit_of(self.step_cost) == "s"
        if measure != "cost" and "step_cost" in options.given_options() and not in_seconds:
            raise click.UsageError(
                f"--within-{measure} counts {measure} already: leave out --step-cost, or give --within-cost with it; "
                "one in seconds goes with --within-time"
            )

    @property
    def most(self) -> tuple[str, float]:
        """Unit of the limit, and its number."""
        within = {"cost": self.within_cost, "time": self.within_time, "energy": self.within_energy}
        return next((measure, most) for measure, most in within.items() if most is not None)
