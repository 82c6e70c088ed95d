"""Fig. 6: one map and one query, and the optimal path at three weights of the traversability cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import OPTIMUM, Cells, bare, draw_ends, draw_path, new_figure, png, tinted
from nnpp_edge.reproduction.regions import optimal_path
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import SQRT2, StepModel


@dataclass(frozen=True)
class Settings:
    """What is drawn."""

    size: int = 256
    omegas: tuple[float, ...] = (0.0, 0.01, 0.05)
    """Per grey level (the paper's)."""


@dataclass(frozen=True)
class _Way:
    """The optimal path at one weight."""

    omega: float
    path: Cells
    length: float
    """In cells, a diagonal step counting √2."""
    cc: float


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """The first map with a path, by exact A* at each weight."""
    size, notes = context.one_size(settings.size)
    ((case, query),) = context.maps(size, 1)
    ways = []
    for omega in settings.omegas:
        path = optimal_path(Grid.of(case.cost, StepModel.of("paper", omega)), query)
        assert path is not None
        ways.append(_way(case.cost, omega, path))
        progress(len(ways) / len(settings.omegas))
    notes.append(f"A map of {size}², start and goal fixed. The paper gives this figure as a picture alone.")
    about = About("none", "1 map, one query")
    return Result(about, _summary(ways), _summary(ways), _findings(ways), _picture(case.cost, ways), notes)


def _way(cost: Float2D, omega: float, path: Cells) -> _Way:
    diagonal = int((np.abs(np.diff(path, axis=0)).sum(axis=1) == 2).sum())
    length = len(path) - 1 + (SQRT2 - 1.0) * diagonal
    return _Way(omega, path, length, float(cost[path[:, 0], path[:, 1]].sum(dtype=np.float64)))


def _summary(ways: Sequence[_Way]) -> Table:
    rows: list[Row] = [(way.omega, round(way.length, 2), round(way.cc, 3)) for way in ways]
    return Table(columns("ω | length, cells | CC"), rows)


def _findings(ways: Sequence[_Way]) -> Sequence[Finding]:
    lengths, ccs = ([getattr(way, name) for way in ways] for name in ("length", "cc"))
    ours = f"length {lengths[0]:.1f} → {lengths[-1]:.1f} cells, CC {ccs[0]:.2f} → {ccs[-1]:.2f}"
    curved = all(np.diff(lengths) >= -1e-6) and all(np.diff(ccs) <= 1e-6)
    claim = "the greater ω, the more the path turns aside for cheaper ground"
    return [judge(claim, "yes (picture)", ours, agrees=curved, rule="length never falls, CC never rises")]


def _picture(cost: Float2D, ways: Sequence[_Way]) -> bytes:
    figure = new_figure(3.4 * len(ways), 3.8)
    for axes, way in zip(figure.subplots(1, len(ways), squeeze=False)[0], ways, strict=True):
        axes.imshow(tinted(cost), interpolation="nearest")
        draw_path(axes, way.path, OPTIMUM, 3.0)
        draw_ends(axes, way.path[0], way.path[-1])
        bare(axes, f"ω = {way.omega:g}: {way.length:.0f} cells, CC {way.cc:.1f}")
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 6", "Paths at three weights ω", run, Settings(), Settings(size=128), asks_networks=False
)
