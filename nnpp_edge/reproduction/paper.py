"""The paper's figures as tidy rows (`rows`): NNPP (arXiv 2308.04792v3), section 5 unless said
otherwise.

Times are seconds on the authors' machine, with an A* that builds an explicit graph of the whole map
first. The tables are text with the names of the rows' figures in the first line; what the paper
does not give is left empty.
"""

import csv

from nnpp_edge.profiling.rows import Row, Rows

ASTAR = "paper's A*"
ASTAR_NN = "paper's A*NN"
DSTAR = "paper's D*"
DSTAR_NN = "paper's D*NN"
STATIC = "static"
DYNAMIC = "dynamic"
"""Scenes of Table 4: an episode's first plan (-s in the paper), and all its plans (-d)."""


def table(text: str) -> Rows:
    """The rows of a table of comma-separated values: whole numbers, decimal numbers and text."""
    rows = Rows()
    for line in csv.DictReader(text.split("\n"), skipinitialspace=True):
        row: Row = {}
        for name, value in line.items():
            if value.isdigit():
                row[name] = int(value)
            elif value[:1].isdigit():
                row[name] = float(value)
            elif value:
                row[name] = value
        rows.append(row)
    return rows


def graph_row(
    size: int,
    planner: str,
    graph_s: float,
    search_s: float,
    path_cells: int,
) -> Row:
    """A row of Table 1: an A* that builds a graph first, its time and the graph's share of it."""
    time_s = graph_s + search_s
    return {
        "size": size,
        "planner": planner,
        "time_s": time_s,
        "graph_s": graph_s,
        "search_s": search_s,
        "graph_share": graph_s / time_s,
        "path_cells": path_cells,
    }


TABLE_1 = Rows(
    graph_row(planner=ASTAR, **row)
    for row in table("""size, graph_s, search_s, path_cells
        64,    0.1854, 0.0230,  57
        128,   0.6466, 0.1045, 113
        256,   2.7770, 0.4715, 226
        512,  11.1785, 2.0906, 452
        1024, 46.4525, 8.6014, 904""")
)
"""Table 1: A* on one map at several resolutions."""
GRAPH_SHARE = 0.85
"""Text to Table 1: the graph takes approximately 85 % of the time."""

TABLE_2 = table("""size, planner, time_s, cc, exact_cc, found
    256, paper's A*,    2.7234, 43.5157, 43.5157, 1.0
    256, paper's A*NN,  0.8511, 44.8051, 43.5157, 0.99
    512, paper's A*,   12.1285, 89.1457, 89.1457, 1.0
    512, paper's A*NN,  2.4103, 91.2667, 89.1457, 0.994""")
"""Table 2: means over the validation maps."""
VALIDATION_MAPS = 1000
"""Section 5.1: maps that Table 2 is measured on."""

INFERENCE_S = 0.058
"""Caption of Fig. 9: nearly constant over the maps' resolutions, 17 frames a second."""

OMEGA = 0.011
OMEGA_DEVIATION = 0.003
"""Section 4.2, text to Fig. 7: the best ω of 100 maps, per grey level of the cost map."""
OMEGA_MOST = 0.2
OMEGA_MAPS = 100
"""Section 4.2: the greatest ω that was tried, and the number of maps."""

TABLE_3 = table("""planner, plan, time_s, cc, exact_cc
    paper's A*,   0, 1.77, 20.61, 20.61
    paper's A*,   1, 0.77, 15.81, 15.81
    paper's A*,   2, 0.33, 10.62, 10.62
    paper's A*,   3, 0.17,  6.82,  6.82
    paper's A*NN, 0, 0.42, 20.61, 20.61
    paper's A*NN, 1, 0.25, 17.18, 15.81
    paper's A*NN, 2, 0.17, 11.62, 10.62
    paper's A*NN, 3, 0.10,  6.82,  6.82
    paper's D*,   0, 1.73, 20.61, 20.61
    paper's D*,   1, 0.62, 15.81, 15.81
    paper's D*,   2, 0.24, 10.62, 10.62
    paper's D*,   3, 0.09,  6.82,  6.82
    paper's D*NN, 0, 0.42, 20.61, 20.61
    paper's D*NN, 1, 0.20, 16.05, 15.81
    paper's D*NN, 2, 0.17, 10.62, 10.62
    paper's D*NN, 3, 0.11,  6.98,  6.82""")
"""Table 3: the plans at T, T + Δt, T + 2Δt and T + 3Δt."""

TABLE_4 = table("""scene, map, planner, time_s, cc, exact_cc, mm
    static,  1, paper's A*,   2.37, 120.51, 120.51,
    static,  2, paper's A*,   2.48, 128.71, 128.71,
    static,  3, paper's A*,   2.31, 103.15, 103.15,
    static,  4, paper's A*,   2.22,  92.24,  92.24,
    static,  5, paper's A*,   2.20, 112.03, 112.03,
    static,  1, paper's A*NN, 0.85, 122.87, 120.51, 0.05
    static,  2, paper's A*NN, 0.94, 128.86, 128.71, 0.06
    static,  3, paper's A*NN, 0.67, 103.42, 103.15, 0.09
    static,  4, paper's A*NN, 0.82,  93.31,  92.24, 0.06
    static,  5, paper's A*NN, 0.63, 112.03, 112.03, 0.11
    dynamic, 1, paper's A*,   4.13, 143.87, 143.87,
    dynamic, 2, paper's A*,   3.97, 161.23, 161.23,
    dynamic, 3, paper's A*,   3.65, 125.24, 125.24,
    dynamic, 4, paper's A*,   3.72, 136.82, 136.82,
    dynamic, 5, paper's A*,   3.58, 134.42, 134.42,
    dynamic, 1, paper's A*NN, 1.46, 146.75, 143.87, 0.05
    dynamic, 2, paper's A*NN, 1.33, 164.41, 161.23, 0.05
    dynamic, 3, paper's A*NN, 1.16, 126.64, 125.24, 0.05
    dynamic, 4, paper's A*NN, 1.24, 139.55, 136.82, 0.07
    dynamic, 5, paper's A*NN, 1.12, 136.10, 134.42, 0.07
    dynamic, 1, paper's D*,   3.08,       , 143.87,
    dynamic, 2, paper's D*,   2.85,       , 161.23,
    dynamic, 3, paper's D*,   2.74,       , 125.24,
    dynamic, 4, paper's D*,   2.89,       , 136.82,
    dynamic, 5, paper's D*,   2.64,       , 134.42,
    dynamic, 1, paper's D*NN, 1.13, 146.57, 143.87,
    dynamic, 2, paper's D*NN, 1.11, 164.52, 161.23,
    dynamic, 3, paper's D*NN, 1.09, 126.81, 125.24,
    dynamic, 4, paper's D*NN, 1.12, 139.55, 136.82,
    dynamic, 5, paper's D*NN, 0.98, 135.97, 134.42,""")
"""Table 4, by map: times and CC of a dynamic scene's plans together."""
