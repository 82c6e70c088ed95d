"""Fig. 8: the network's answer to one query, and what several thresholds make of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import bare, draw_ends, new_figure, png, tinted
from nnpp_edge.reproduction.regions import (
    CONTROLS,
    CONTROLS_NOTE,
    NETWORK,
    Found,
    PaperRegions,
    compare_regions,
    region_of,
)
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge, percent
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.region.threshold import probability_of

_SMALL = 0.2
"""Share of the map that a region at td should stay below."""


@dataclass(frozen=True)
class Settings:
    """What is drawn."""

    size: int = 256
    above: tuple[float, ...] = (0.6, 0.3)
    """Thresholds above td, as shares of the way from it to 1."""
    below: tuple[float, ...] = (1.0, 0.5)
    """Thresholds from td down, as shares of it."""


@dataclass(frozen=True)
class _Segmented:
    """The answer at one threshold."""

    threshold: float
    mask: NDArray[np.bool_]
    connected: bool


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """The first map with a path: the answer of the paper's network, at several thresholds."""
    size, notes = context.one_size(settings.size)
    ((case, query),) = context.maps(size, 1)
    maker = PaperRegions(case.cost, context.networks.paper)
    probability, td = maker.probability(query)
    thresholds = [*(td + share * (1.0 - td) for share in settings.above), *(share * td for share in settings.below)]
    cuts = [_cut(maker, threshold, td) for threshold in thresholds]
    found = compare_regions(case.cost, query, context.networks.paper, context.networks.shuffled)
    progress(1.0)
    notes.append(
        f"A map of {size}². Thresholds are the adaptive one, td = {td:.3g}, and others around it; the paper gives "
        "this figure as a picture alone. *Connected*: start and goal lie in one piece, blocks that touch being "
        "one."
    )
    name = context.networks.paper.metadata.name
    about = About(f"`{name}` in the paper's method; ours does not take part", "1 map, one query", CONTROLS_NOTE)
    table = _summary(cuts, name)
    return Result(about, table, table, _findings(cuts, found), _picture(case, query, maker, probability, cuts), notes)


def _cut(maker: PaperRegions, threshold: float, td: float) -> _Segmented:
    """The region at a threshold; td itself joins start and goal, what lies above it does not."""
    levels = maker.finder.levels
    blocks = np.array([probability_of(int(level)) for level in levels.ravel()]).reshape(levels.shape) >= threshold
    return _Segmented(threshold, region_of(blocks, maker.lookup).mask(), threshold <= td)


def _summary(cuts: Sequence[_Segmented], network: str) -> Table:
    rows: list[Row] = [
        (
            f"{cut.threshold:.4g}",
            f"`{network}`",
            percent(float(cut.mask.mean())),
            "connected" if cut.connected else "apart",
        )
        for cut in cuts
    ]
    return Table(columns("td | network | region, of the map | start and goal"), rows)


def _findings(cuts: Sequence[_Segmented], found: dict[str, Found]) -> Sequence[Finding]:
    own = found[NETWORK].share
    as_well = {kind: found[kind].found and found[kind].share < _SMALL for kind in CONTROLS}
    claim, rule = (
        "the greatest td that joins start and goal leaves a small part of the map",
        f"below {percent(_SMALL, 0)}",
    )
    return [judge(claim, "yes (picture)", percent(own), agrees=own < _SMALL, rule=rule, controls=as_well)]


def _picture(
    case: Case, query: Endpoints, maker: PaperRegions, probability: NDArray[np.float32], cuts: Sequence[_Segmented]
) -> bytes:
    figure = new_figure(2.7 * (len(cuts) + 1), 3.3)
    first, *others = figure.subplots(1, len(cuts) + 1, squeeze=False)[0]
    rows, cols = maker.lookup
    first.imshow(probability[np.ix_(rows, cols)], cmap="viridis", interpolation="nearest")
    draw_ends(first, *query)
    bare(first, "the network's answer")
    for axes, cut in zip(others, cuts, strict=True):
        axes.imshow(tinted(case.cost, cut.mask), interpolation="nearest")
        draw_ends(axes, *query)
        bare(axes, f"td = {cut.threshold:.3g}: {'connected' if cut.connected else 'apart'}")
    return png(figure)


EXPERIMENT = Experiment("Fig. 8", "Regions at several thresholds", run, Settings(), Settings(size=128))
