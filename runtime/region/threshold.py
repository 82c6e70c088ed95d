"""The heuristic region: where the network's probability is high enough to join start and goal.

NNPP lowers a threshold td step by step until start and goal lie in one piece of {p >= td}
(arXiv 2308.04792v3, section 4.3). That td is the width of the widest path between the two, and a single
sweep over 256 levels, from the highest down, finds it exactly.

What counts as one piece: for the paper, blocks that touch. A planner knows more, namely which cells of its map
can be walked between, and asks for the td at which these join start and goal. So a region never ends at a wall
that its blocks reach across.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.expansion import COL_STEP, ROW_STEP
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.search.workspace import STAMP_SHIFT, Workspace

LEVELS = 256
"""Level n stands for the probability (n / 256)⁴. So what is unlikely has levels too: where slope limits leave only a
long way round, td is often below 1/1000."""

TOWARDS = np.array(
    [sorted(range(8), key=lambda k: ROW_STEP[k] * (n // 3 - 1) + COL_STEP[k] * (n % 3 - 1)) for n in range(9)],
    np.int8,
)
"""The eight directions, those that lead most towards row n // 3 - 1 and column n % 3 - 1 last."""


@kernel
def quantise(probability, levels):
    """Level ⌊256 p^(1/4)⌋ of each block, at most 255: (B, B) float32 in [0, 1] to (B, B) uint8."""
    for i in range(probability.shape[0]):
        for j in range(probability.shape[1]):
            root = math.sqrt(math.sqrt(max(probability[i, j], np.float32(0.0))))
            levels[i, j] = np.uint8(min(root * LEVELS, LEVELS - 1.0))


@kernel
def lowered(level, factor):
    """The level, at least 1, of a probability that is `factor` times another one's."""
    return max(int(level * math.sqrt(math.sqrt(factor))), 1)


def probability_of(level: int) -> float:
    """What a level stands for; below 0, which stands for no way, nothing."""
    return (max(level, 0) / LEVELS) ** 4


@kernel
def adaptive_threshold(levels, start_row, start_col, goal_row, goal_col, heads, following, done):
    """The largest level at which two blocks are joined in {levels >= level}, eight-connected.

    Parameters
    ----------
    levels : (B, C) uint8
        Level of each block, and 0 in the last row and column.
    start_row, start_col, goal_row, goal_col : int
        Blocks.
    heads : (256,) int32, following : (B·C,) int32, done : (B·C,) uint8
        Scratch.

    Returns
    -------
    int
        In 0…255. All blocks are joined at level 0.
    """
    rows, cols = levels.shape
    heads[:] = -1
    done[:] = 0
    goal = goal_row * cols + goal_col
    first = start_row * cols + start_col
    width = np.int64(levels[start_row, start_col])
    done[first] = 1
    following[first] = -1
    heads[width] = first
    while True:
        while heads[width] == -1:
            width -= 1
        block = heads[width]
        heads[width] = following[block]
        if block == goal:
            return width
        row, col = block // cols, block % cols
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(col - 1, 0), min(col + 2, cols)):
                there = i * cols + j
                if not done[there]:
                    done[there] = 1
                    bucket = min(width, np.int64(levels[i, j]))
                    following[there] = heads[bucket]
                    heads[bucket] = there


@kernel
def linked(weights, links, node, k, stride, corner_cutting):
    """Whether a step in direction k leads from a passable cell to another."""
    if links is not None:
        return (links[node] >> k) & 1 != 0
    there = node + ROW_STEP[k] * stride + COL_STEP[k]
    if weights[there] == np.inf:
        return False
    if k < 4 or corner_cutting:
        return True
    return weights[node + ROW_STEP[k] * stride] != np.inf and weights[node + COL_STEP[k]] != np.inf


@kernel
def walkable_threshold(
    levels, row_blocks, col_blocks, weights, links, stride, corner_cutting, start, goal, most, heads, state, stamp
):  # fmt: skip
    """The largest level at which two nodes of a grid are joined by steps through cells whose blocks reach it.

    Among cells that serve alike, those towards the goal come first: where the way is free, few others are looked at.

    Parameters
    ----------
    levels : (B, C) uint8
        Level of each block.
    row_blocks, col_blocks : (H,) int32, (W,) int32
        Row and column of the block that a row and a column of the grid lie in.
    weights, links, stride, corner_cutting
        The grid, and which steps it allows.
    start, goal : int
        Nodes.
    most : int
        A level that the result is known not to exceed; the nearer to it, the less is looked at.
    heads : (256,) int32
        Scratch.
    state : (2 · nodes,) int32, stamp : int
        A workspace's memory, which the search that follows will touch too, and the number of a new search in it.

    Returns
    -------
    int
        In 0…255; -1 where no steps lead from one to the other.
    """
    heads[:] = -1
    goal_row, goal_col = goal // stride, goal % stride
    width = min(most, np.int64(levels[row_blocks[start // stride - 1], col_blocks[start % stride - 1]]))
    width = min(width, np.int64(levels[row_blocks[goal_row - 1], col_blocks[goal_col - 1]]))
    seen = stamp << STAMP_SHIFT
    state[2 * start], state[2 * start + 1] = -1, seen
    heads[width] = start
    while True:
        while heads[width] == -1:
            width -= 1
            if width < 0:
                return -1
        node = np.int64(heads[width])
        heads[width] = state[2 * node]
        if node == goal:
            return width
        row, col = node // stride, node % stride
        ahead = 3 * ((goal_row > row) - (goal_row < row)) + (goal_col > col) - (goal_col < col) + 4
        for nth in range(8):
            k = TOWARDS[ahead, nth]
            there = node + ROW_STEP[k] * stride + COL_STEP[k]
            if state[2 * there + 1] != seen and linked(weights, links, node, k, stride, corner_cutting):
                level = np.int64(levels[row_blocks[there // stride - 1], col_blocks[there % stride - 1]])
                bucket = min(width, level)
                state[2 * there], state[2 * there + 1] = heads[bucket], seen
                heads[bucket] = there


@kernel
def fill_region(levels, threshold, start_row, start_col, goal_row, goal_col, stamp, radius, bitmap):
    """Number the blocks of {levels >= threshold}, and those within `radius` of them; start and goal always.

    The last row and column of `levels` are left out.
    """
    rows, cols = levels.shape[0] - 1, levels.shape[1] - 1
    for row in range(rows):
        for col in range(cols):
            ends = (row == start_row and col == start_col) or (row == goal_row and col == goal_col)
            if levels[row, col] >= threshold or ends:
                for i in range(max(row - radius, 0), min(row + radius + 1, rows)):
                    for j in range(max(col - radius, 0), min(col + radius + 1, cols)):
                        bitmap[i, j] = stamp


@kernel
def first_regions(
    probability, row_blocks, col_blocks, weights, links, stride, corner_cutting, start, goal, start_row, start_col,
    goal_row, goal_col, touching, factor, stamp, levels, heads, following, done, state, search, at_td, bitmap,
):  # fmt: skip
    """What a plan needs of a network's answer, in one call: td and the blocks at it and at `factor` times it.

    `quantise`, then `walkable_threshold`, then `fill_region` twice; the result is the second's. With `touching`, a
    step of the grid leads to the same block or one that touches it: then blocks joined bound what cells are.
    """
    quantise(probability, levels)
    most = LEVELS - 1
    if touching:  # by the cells' own blocks: those of `start_row` to `goal_col` may be their neighbours
        most = adaptive_threshold(
            levels, row_blocks[start // stride - 1], col_blocks[start % stride - 1], row_blocks[goal // stride - 1],
            col_blocks[goal % stride - 1], heads, following, done,
        )  # fmt: skip
    td = walkable_threshold(
        levels, row_blocks, col_blocks, weights, links, stride, corner_cutting, start, goal, most, heads, state,
        search,
    )  # fmt: skip
    fill_region(levels, max(td, 0), start_row, start_col, goal_row, goal_col, stamp, 0, at_td)
    if td > 0:
        fill_region(levels, lowered(td, factor), start_row, start_col, goal_row, goal_col, stamp, 0, bitmap)
    return td


class RegionFinder:
    """Turns probabilities into regions; holds the scratch memory for one size."""

    def __init__(self, blocks: int) -> None:
        padded = (blocks + 1, blocks + 1)
        self._levels: NDArray[np.uint8] = np.zeros(padded, np.uint8)
        self._bitmaps: NDArray[np.int32] = np.zeros((2, *padded), np.int32)
        self.at_td: NDArray[np.int32] = np.zeros(padded, np.int32)
        """The region at td itself, by `first`; it stays while wider ones are searched."""
        self.stamp = 0
        self._heads = np.empty(LEVELS, np.int32)
        self._following = np.empty(self._levels.size, np.int32)
        self._done = np.empty(self._levels.size, np.uint8)

    @property
    def bitmap(self) -> NDArray[np.int32]:
        """(B + 1, B + 1) int32, where the blocks of `stamp` were marked; it holds until the marking after the next.

        The last row and column belong to no region: cells that the network is not shown lie there.
        """
        return self._bitmaps[self.stamp % 2]

    @property
    def levels(self) -> NDArray[np.uint8]:
        """Level of each block: (B, B) uint8."""
        return self._levels[:-1, :-1]

    def read(self, probability: NDArray[np.float32]) -> None:
        """Take over a network's answer, (B, B) float32 in [0, 1]."""
        quantise(probability, self._levels)

    def threshold(self, start: tuple[int, int], goal: tuple[int, int]) -> int:
        """The adaptive threshold td between two blocks, as a level."""
        return int(adaptive_threshold(self._levels, *start, *goal, self._heads, self._following, self._done))

    def first(
        self, probability: NDArray[np.float32], grid: Grid, links: NDArray[np.uint8] | None, workspace: Workspace,
        lookup: tuple[NDArray[np.int32], NDArray[np.int32]], cells: tuple[tuple[int, int], tuple[int, int]],
        blocks: tuple[tuple[int, int], tuple[int, int]], corner_cutting: bool, factor: float, *,
        touching: bool = False,
    ) -> int:  # fmt: skip
        """Take over an answer, find td, and number the blocks at it in `at_td` and at `factor` of it in `bitmap`.

        Parameters
        ----------
        probability : (B, B) float32
            In [0, 1].
        grid, links
            What is walked on, and which steps it allows.
        workspace : Workspace
            Of the grid.
        lookup
            The block that each of the grid's rows and columns lies in.
        cells, blocks
            Start and goal on the grid, and the blocks that belong to any region.
        corner_cutting : bool
            Whether a step may cut corners where there are no links.
        factor : float
            In (0, 1].
        touching : bool
            Whether each step on the grid leads to the same block or one that touches it; saves time.

        Returns
        -------
        int
            td as a level, along steps that the grid allows; -1 where there is no way. Where it is not above 0,
            `at_td` is every block and `bitmap` is left alone. The number is `stamp`.
        """
        self.stamp += 1
        return int(
            first_regions(
                probability, *lookup, grid.weights, links, grid.stride, corner_cutting, grid.node(*cells[0]),
                grid.node(*cells[1]), *blocks[0], *blocks[1], touching, factor, self.stamp, self._levels,
                self._heads, self._following, self._done, workspace.meta, workspace.next_stamp(), self.at_td,
                self.bitmap,
            )
        )  # fmt: skip

    def mark(self, threshold: int, start: tuple[int, int], goal: tuple[int, int], radius: int = 0) -> None:
        """Number the blocks at or above a threshold in `bitmap`; the number is `stamp`."""
        self.stamp += 1
        fill_region(self._levels, threshold, *start, *goal, self.stamp, radius, self.bitmap)

    def region(self, lookup: tuple[NDArray[np.int32], NDArray[np.int32]]) -> Region:
        """The blocks marked last, as a region of the grid whose rows and columns lie in the blocks of `lookup`."""
        return Region(self.bitmap, *lookup, self.stamp)
