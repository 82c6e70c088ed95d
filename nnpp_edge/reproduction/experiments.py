"""The experiments of the paper by name, in the order in which they run."""

from nnpp_edge.reproduction.dynamic import table3, table4
from nnpp_edge.reproduction.encodings import fig13
from nnpp_edge.reproduction.exact import fig6, fig7, table1
from nnpp_edge.reproduction.looks import fig8, fig14
from nnpp_edge.reproduction.static import fig9, fig11, fig12, table2

EXPERIMENTS = {
    "table1": table1,
    "fig6": fig6,
    "fig7": fig7,
    "fig8": fig8,
    "table2": table2,
    "fig9": fig9,
    "fig11": fig11,
    "fig12": fig12,
    "fig14": fig14,
    "table3": table3,
    "table4": table4,
    "fig13": fig13,
}
