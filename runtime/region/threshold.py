"""The heuristic region: where the network's probability is high enough to join start and goal.

NNPP lowers a threshold td step by step until start and goal lie in one piece of {p >= td} (arXiv 2308.04792v3,
section 4.3). A single sweep over 256 levels, from the highest down, finds that td. For the paper, blocks that touch
are one piece. A planner knows which cells of its map can be walked between, and wants the td at which these join
start and goal: so a region never ends at a wall that its blocks reach across.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.kernels import threshold as kernels
from nnpp_edge.runtime.map.pyramid import Level
from nnpp_edge.runtime.map.region import Lookup, Region
from nnpp_edge.runtime.search.workspace import Workspace


class Ends(NamedTuple):
    """Start and goal of a search in a learned region, on the grid that is searched, and the blocks always in it."""

    start: Cell
    goal: Cell
    start_block: Cell
    goal_block: Cell


def probability_of(level: int) -> float:
    """The probability that a level of the threshold stands for; 0 below 0, which stands for no way."""
    return (max(level, 0) / kernels.LEVELS) ** 4


class RegionFinder:
    """Turns probabilities on blocks × blocks into regions; holds the scratch memory for one size."""

    def __init__(self, blocks: int) -> None:
        padded = (blocks + 1, blocks + 1)
        self._levels: NDArray[np.uint8] = np.zeros(padded, np.uint8)
        self._bitmaps = np.zeros(padded, np.int32), np.zeros(padded, np.int32)
        self.at_td: NDArray[np.int32] = np.zeros(padded, np.int32)
        """The region at td itself, by `first`; it stays while wider ones are searched."""
        self.stamp = 0
        self._heads = np.empty(kernels.LEVELS, np.int32)
        self._following = np.empty(self._levels.size, np.int32)
        self._done = np.empty(self._levels.size, np.uint8)

    @property
    def bitmap(self) -> NDArray[np.int32]:
        """(B + 1, B + 1), where the blocks of `stamp` were marked; it holds until the marking after the next.

        The last row and column belong to no region: cells that the network is not shown lie there.
        """
        return self._bitmaps[self.stamp % 2]

    @property
    def levels(self) -> NDArray[np.uint8]:
        """Level of each block: (B, B) uint8."""
        return self._levels[:-1, :-1]

    def read(self, probability: Float2D) -> None:
        """Take over a network's answer, (B, B) float32 in [0, 1]."""
        kernels.quantise(probability, self._levels)

    def threshold(self, start: Cell, goal: Cell) -> int:
        """The adaptive threshold td between two blocks, as a level."""
        return int(kernels.adaptive_threshold(self._levels, *start, *goal, self._heads, self._following, self._done))

    def first(
        self,
        probability: Float2D,
        level: Level,
        workspace: Workspace,
        lookup: Lookup,
        ends: Ends,
        factor: float,
        *,
        touching: bool = False,
        deadline: Deadline = NEVER,
    ) -> int:
        """Take over an answer and find td as a level, along steps that the grid allows; -1 where there is no way.

        The blocks at td are numbered `stamp` in `at_td`, those at `factor` of it in `bitmap`. Where td is not above
        0, `at_td` is every block and `bitmap` is left alone. OutOfTimeError at the deadline.

        Parameters
        ----------
        probability : (B, B) float32
            In [0, 1].
        level, workspace, lookup
            What is walked on, memory of its grid, and the block that each of its rows and columns lies in.
        touching : bool
            Whether each step on the grid leads to the same block or one that touches it; saves time.
        """
        self.stamp += 1
        node = level.grid.node
        packed_ends = node(*ends.start), node(*ends.goal), *ends.start_block, *ends.goal_block
        scratch = self._levels, self._heads, self._following, self._done
        search, marks = (workspace.meta, workspace.next_stamp()), (self.stamp, self.at_td, self.bitmap)
        rule = touching, factor
        walked, until = (level.grid.packed, level.links), deadline.at
        td = kernels.first_regions(probability, lookup, *walked, packed_ends, rule, scratch, search, marks, until)
        if td == kernels.TOO_LATE:
            raise OutOfTimeError
        return int(td)

    def mark(self, threshold: int, start: Cell, goal: Cell, radius: int = 0) -> None:
        """Number the blocks at or above a threshold in `bitmap`; the number is `stamp`."""
        self.stamp += 1
        kernels.fill_region(self._levels, threshold, *start, *goal, self.stamp, radius, self.bitmap)

    def region(self, lookup: Lookup) -> Region:
        """The blocks marked last, as a region of the grid whose rows and columns lie in the blocks of `lookup`."""
        return Region(self.bitmap, *lookup, self.stamp)
