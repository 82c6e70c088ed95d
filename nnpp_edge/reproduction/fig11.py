"""Fig. 11: time of a query against the length of its path, with and without the network."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction.contest import (
    OURS,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLAIN_PLANNERS,
    PLANNERS,
    Round,
    contest,
    network_of,
    one_query_each,
    shown,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, new_figure, png, tidy
from nnpp_edge.reproduction.regions import CONTROLS_NOTE, Networks
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge, percent

_LEAST_DISTANCE = 0.05
"""Short paths too: start and goal at least so much of the map's side apart."""


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    size: int = 256
    queries: int = 300
    """Each on a map of its own."""
    repeats: int = 3


@dataclass(frozen=True)
class Line:
    """A straight line through (cells of the path, seconds)."""

    offset_s: float
    slope_s: float
    correlation: float


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Random queries, near ones among them, each put to all planners."""
    size, notes = context.one_size(settings.size)
    cases = one_query_each(context, size, _LEAST_DISTANCE)
    rounds = []
    for answered in contest(cases, context.networks, settings.queries, repeats=settings.repeats):
        rounds.append(answered)
        progress(len(rounds) / settings.queries)
    lines = {name: _fit(rounds, name) for name in PLANNERS}
    notes.append(
        f"Maps of {size}², start and goal at least {_LEAST_DISTANCE} of the side apart. The paper gives this figure"
        " as a picture alone. Lines are fitted by least squares."
    )
    findings = [
        *_slopes(rounds, lines, PLAIN, PLAIN_NN, PLAIN_CONTROLS),
        *_slopes(rounds, lines, "astar", "nnpp", {"corridor": "corridor"}),
    ]
    samples = f"{settings.queries} maps, one query each; ours the median of {settings.repeats}"
    about = About(context.networks.named, samples, CONTROLS_NOTE)
    return Result(
        about, _summary(rounds, lines, context.networks), _data(rounds), findings, _picture(rounds, lines), notes
    )


def _cells(rounds: Sequence[Round]) -> NDArray[np.float64]:
    return np.array([r.path_cells for r in rounds], np.float64)


def _times(rounds: Sequence[Round], name: str) -> NDArray[np.float64]:
    return np.array([r.answers[name].time_s for r in rounds])


def _fit(rounds: Sequence[Round], name: str) -> Line:
    cells, times = _cells(rounds), _times(rounds, name)
    if len(set(cells)) < 2:
        return Line(float(times.mean()), 0.0, 0.0)
    slope, offset = np.polyfit(cells, times, 1)
    return Line(float(offset), float(slope), float(np.corrcoef(cells, times)[0, 1]))


def _summary(rounds: Sequence[Round], lines: dict[str, Line], networks: Networks) -> Table:
    header = columns(
        "planner | network | fitted time for 50 cells, ms | for 200 cells, ms | correlation | faster than plain A* | "
        "faster than our exact A*"
    )
    rows: list[Row] = []
    for name, line in lines.items():
        at = [1e3 * (line.offset_s + line.slope_s * cells) for cells in (50, 200)]
        wins = [None if name == other else percent(_wins(rounds, name, other), 0) for other in (PLAIN, "astar")]
        rows.append(
            (
                shown(name),
                network_of(name, networks),
                f"{at[0]:.3g}",
                f"{at[1]:.3g}",
                f"{line.correlation:.2f}",
                *wins,
            )
        )
    return Table(header, rows)


def _data(rounds: Sequence[Round]) -> Table:
    rows = [(r.path_cells, *(r.answers[name].time_s for name in PLANNERS)) for r in rounds]
    return Table(("path_cells", *(f"{name} s" for name in PLANNERS)), rows)


def _slopes(
    rounds: Sequence[Round], lines: dict[str, Line], slow: str, fast: str, controls: Mapping[str, str]
) -> Sequence[Finding]:
    """Two planners, by the lines through their times; `controls` by kind take the place of the second."""
    a, b = lines[slow], lines[fast]
    wins = _wins(rounds, fast, slow)
    flat = {kind: lines[name].slope_s < a.slope_s for kind, name in controls.items()}
    fast_too = {kind: _wins(rounds, name, slow) >= 0.9 for kind, name in controls.items()}
    grows = a.slope_s > 0.0 and a.correlation > 0.3
    slower = f"it grows more slowly with the network ({fast} against {slow})"
    own = f"{1e6 * a.slope_s:.3g} µs a cell, r = {a.correlation:.2f}"
    with_network = f"{1e6 * b.slope_s:.3g} µs a cell"
    faster, share = f"the network's way is much the faster ({fast} against {slow})", percent(wins, 0)
    return [
        judge(f"time grows with the path's length ({slow})", "yes", own, agrees=grows, rule="correlation above 0.3"),
        judge(slower, "yes", with_network, agrees=b.slope_s < a.slope_s, rule="a smaller slope", controls=flat),
        judge(
            faster,
            "yes",
            f"faster on {share} of the queries",
            agrees=wins >= 0.9,
            rule="on at least 90 %",
            controls=fast_too,
        ),
    ]


def _wins(rounds: Sequence[Round], fast: str, slow: str) -> float:
    """Share of the queries that one planner answers sooner than another."""
    return float((_times(rounds, fast) < _times(rounds, slow)).mean())


def _picture(rounds: Sequence[Round], lines: dict[str, Line]) -> bytes:
    figure = new_figure(11.5, 4.6)
    left, right = figure.subplots(1, 2)
    cells = _cells(rounds)
    ends = np.array([cells.min(), cells.max()])
    for axes, names, title in (
        (left, PLAIN_PLANNERS[:3], "Plain Python, a graph for each query"),
        (right, OURS, "This toolkit's planners"),
    ):
        for name in names:
            line = lines[name]
            axes.scatter(cells, 1e3 * _times(rounds, name), s=12, alpha=0.6, color=COLOURS[name], linewidths=0)
            axes.plot(ends, 1e3 * (line.offset_s + line.slope_s * ends), color=COLOURS[name], linewidth=2, label=name)
        tidy(axes, title, "cells of the optimal path", "time of a query, ms")
        axes.set_ylim(bottom=0.0)
        axes.legend(fontsize="small", loc="upper left")
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 11", "Time against the length of the path", run, Settings(), Settings(queries=10, repeats=2)
)
