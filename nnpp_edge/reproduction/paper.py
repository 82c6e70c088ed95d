"""The paper's figures, as data: NNPP (arXiv 2308.04792v3), section 5 unless said otherwise.

Times are seconds on the authors' machine, with an A* that builds an explicit graph of the whole map first.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Graphing:
    """A row of Table 1: A* on one map at several resolutions."""

    graph_s: float
    search_s: float
    path_cells: float

    @property
    def total_s(self) -> float:
        """The whole time."""
        return self.graph_s + self.search_s

    @property
    def graph_share(self) -> float:
        """Share of the whole time that the graph takes."""
        return self.graph_s / self.total_s


TABLE_1 = {
    64: Graphing(0.1854, 0.0230, 57),
    128: Graphing(0.6466, 0.1045, 113),
    256: Graphing(2.7770, 0.4715, 226),
    512: Graphing(11.1785, 2.0906, 452),
    1024: Graphing(46.4525, 8.6014, 904),
}
"""Table 1, by the side of the map."""
GRAPH_SHARE = 0.85
"""Text to Table 1: the graph takes approximately 85 % of the time."""


@dataclass(frozen=True)
class Scale:
    """A half of Table 2: means over 1000 validation maps."""

    astar_s: float
    nn_s: float
    astar_cc: float
    nn_cc: float
    nn_success: float

    @property
    def speedup(self) -> float:
        """A*'s time over that of A* in the network's region."""
        return self.astar_s / self.nn_s

    @property
    def cc_increase(self) -> float:
        """What the paths in the region cost more, as a share."""
        return self.nn_cc / self.astar_cc - 1.0


TABLE_2 = {256: Scale(2.7234, 0.8511, 43.5157, 44.8051, 0.99), 512: Scale(12.1285, 2.4103, 89.1457, 91.2667, 0.994)}
"""Table 2, by the side of the map."""

VALIDATION_MAPS = 1000
"""Section 5.1: maps that Table 2 is measured on."""

INFERENCE_S = 0.058
"""Caption of Fig. 9: nearly constant over the maps' resolutions, 17 frames a second."""

OMEGA, OMEGA_DEVIATION = 0.011, 0.003
"""Section 4.2, text to Fig. 7: the best ω of 100 maps, per grey level of the cost map."""
OMEGA_MOST = 0.2
"""Section 4.2: ω was varied from 0 to this."""
OMEGA_MAPS = 100

BEST_SIGMA = 0.25
"""Text to Fig. 13: the network does best with σ around 1/4 of the map's side."""


@dataclass(frozen=True)
class Static:
    """A row of Table 4 in a static scene: one of the maps of Fig. 12."""

    astar_s: float
    astar_cc: float
    nn_s: float
    nn_cc: float
    nn_mm: float


@dataclass(frozen=True)
class Dynamic(Static):
    """A row of Table 4 in a dynamic scene: times and CC of the planning steps together."""

    dstar_s: float
    dstar_nn_s: float
    dstar_nn_cc: float


TABLE_4_STATIC = {
    "map1": Static(2.37, 120.51, 0.85, 122.87, 0.05),
    "map2": Static(2.48, 128.71, 0.94, 128.86, 0.06),
    "map3": Static(2.31, 103.15, 0.67, 103.42, 0.09),
    "map4": Static(2.22, 92.24, 0.82, 93.31, 0.06),
    "map5": Static(2.20, 112.03, 0.63, 112.03, 0.11),
}
"""Table 4, the rows marked -s."""
TABLE_4_DYNAMIC = {
    "map1": Dynamic(4.13, 143.87, 1.46, 146.75, 0.05, 3.08, 1.13, 146.57),
    "map2": Dynamic(3.97, 161.23, 1.33, 164.41, 0.05, 2.85, 1.11, 164.52),
    "map3": Dynamic(3.65, 125.24, 1.16, 126.64, 0.05, 2.74, 1.09, 126.81),
    "map4": Dynamic(3.72, 136.82, 1.24, 139.55, 0.07, 2.89, 1.12, 139.55),
    "map5": Dynamic(3.58, 134.42, 1.12, 136.10, 0.07, 2.64, 0.98, 135.97),
}
"""Table 4, the rows marked -d."""

TABLE_3 = {
    "A*": ((1.77, 20.61), (0.77, 15.81), (0.33, 10.62), (0.17, 6.82)),
    "A*NN": ((0.42, 20.61), (0.25, 17.18), (0.17, 11.62), (0.10, 6.82)),
    "D*": ((1.73, 20.61), (0.62, 15.81), (0.24, 10.62), (0.09, 6.82)),
    "D*NN": ((0.42, 20.61), (0.20, 16.05), (0.17, 10.62), (0.11, 6.98)),
}
"""Table 3: (AT in seconds, CC) at T, T + Δt, T + 2Δt and T + 3Δt."""
