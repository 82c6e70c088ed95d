"""The paper's figures as tidy rows (`rows`): NNPP (arXiv 2308.04792v3), section 5 unless said
otherwise.

Times are seconds on the authors' machine, with an A* that builds an explicit graph of the whole map
first.
"""

from nnpp_edge.reproduction.rows import Row, Rows

ASTAR = "paper's A*"
ASTAR_NN = "paper's A*NN"
DSTAR = "paper's D*"
DSTAR_NN = "paper's D*NN"


def graph_row(planner: str, graph_s: float, search_s: float, path_cells: int) -> Row:
    """An answer of an A* that builds a graph first: the time of both, and the share of
    the graph.
    """
    time_s = graph_s + search_s
    row = {"planner": planner, "time_s": time_s, "graph_s": graph_s, "search_s": search_s}
    return row | {"graph_share": graph_s / time_s, "path_cells": path_cells}


TABLE_1 = Rows(
    {"size": size} | graph_row(ASTAR, graph_s, search_s, cells)
    for size, graph_s, search_s, cells in (
        (64, 0.1854, 0.0230, 57),
        (128, 0.6466, 0.1045, 113),
        (256, 2.7770, 0.4715, 226),
        (512, 11.1785, 2.0906, 452),
        (1024, 46.4525, 8.6014, 904),
    )
)
"""Table 1: A* on one map at several resolutions."""
GRAPH_SHARE = 0.85
"""Text to Table 1: the graph takes approximately 85 % of the time."""

TABLE_2 = Rows(
    {
        "planner": planner,
        "size": size,
        "time_s": time_s,
        "cc": cc,
        "exact_cc": exact_cc,
        "found": found,
    }
    for size, planner, time_s, cc, exact_cc, found in (
        (256, ASTAR, 2.7234, 43.5157, 43.5157, 1.0),
        (256, ASTAR_NN, 0.8511, 44.8051, 43.5157, 0.99),
        (512, ASTAR, 12.1285, 89.1457, 89.1457, 1.0),
        (512, ASTAR_NN, 2.4103, 91.2667, 89.1457, 0.994),
    )
)
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
"""Section 4.2: ω was varied from 0 to this, on so many maps."""

TABLE_3 = Rows(
    {
        "planner": name,
        "plan": at,
        "time_s": time_s,
        "cc": cc,
        "exact_cc": (20.61, 15.81, 10.62, 6.82)[at],
    }
    for name, plans in {
        ASTAR: ((1.77, 20.61), (0.77, 15.81), (0.33, 10.62), (0.17, 6.82)),
        ASTAR_NN: ((0.42, 20.61), (0.25, 17.18), (0.17, 11.62), (0.10, 6.82)),
        DSTAR: ((1.73, 20.61), (0.62, 15.81), (0.24, 10.62), (0.09, 6.82)),
        DSTAR_NN: ((0.42, 20.61), (0.20, 16.05), (0.17, 10.62), (0.11, 6.98)),
    }.items()
    for at, (time_s, cc) in enumerate(plans)
)
"""Table 3, at T, T + Δt, T + 2Δt and T + 3Δt."""

STATIC = "static"
DYNAMIC = "dynamic"
"""Scenes: an episode's first plan (-s in Table 4), and all its plans (-d)."""
_TABLE_4 = {
    STATIC: {
        ASTAR: ((2.37, 120.51), (2.48, 128.71), (2.31, 103.15), (2.22, 92.24), (2.20, 112.03)),
        ASTAR_NN: (
            *((0.85, 122.87, 0.05), (0.94, 128.86, 0.06), (0.67, 103.42, 0.09)),
            *((0.82, 93.31, 0.06), (0.63, 112.03, 0.11)),
        ),
    },
    DYNAMIC: {
        ASTAR: ((4.13, 143.87), (3.97, 161.23), (3.65, 125.24), (3.72, 136.82), (3.58, 134.42)),
        ASTAR_NN: (
            *((1.46, 146.75, 0.05), (1.33, 164.41, 0.05), (1.16, 126.64, 0.05)),
            *((1.24, 139.55, 0.07), (1.12, 136.10, 0.07)),
        ),
        DSTAR: ((3.08,), (2.85,), (2.74,), (2.89,), (2.64,)),
        DSTAR_NN: ((1.13, 146.57), (1.11, 164.52), (1.09, 126.81), (1.12, 139.55), (0.98, 135.97)),
    },
}
TABLE_4 = Rows(
    {"scene": scene, "map": at + 1, "planner": name, "exact_cc": planners[ASTAR][at][1]}
    | dict(zip(("time_s", "cc", "mm"), figures, strict=False))
    for scene, planners in _TABLE_4.items()
    for name, maps in planners.items()
    for at, figures in enumerate(maps)
)
"""Table 4, by map: times and CC of a dynamic scene's plans together."""
