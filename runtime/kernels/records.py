"""The records that kernels are given, by name, with the type, shape and unit of each field.

They are handed over as plain tuples, so that a call takes what one with plain tuples does. A kernel
that says which record a parameter is, ``grid: GridRecord``, reads its fields by name. A record
within another is a plain tuple as well, and named with it where its field is annotated; arrays of
more than one dimension in records that lie in memory are annotated with these. They stand
here, as compiled kernels hold the places of their fields (`compiled.places`).
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Words = NDArray[np.uint16]
Int32s = NDArray[np.int32]
Int64s = NDArray[np.int64]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Packed = tuple[object, ...]
"""A record as a plain tuple."""


class Area(NamedTuple):
    """Rows and columns of a rectangle: from the first up to, but not including, the second. Kernels
    return it as a plain tuple, too: to make another in Python takes 0.5 µs.
    """

    row0: int
    row1: int
    col0: int
    col1: int


# A map


class StepTerms(NamedTuple):
    """What a step costs: a length, and its weight times the sum of the weights of both ends."""

    length_straight: float
    length_diagonal: float
    weight_straight: float
    weight_diagonal: float


class TileSource(NamedTuple):
    """A map of heights, and what is computed from them (`map.tiles`)."""

    heights: Floats
    """(rows · cols,) metres; not finite where unknown."""
    rule: Doubles
    """(RULE_SLOTS,) how heights become costs (`kernels.traversability`)."""
    weights: Floats
    """(nodes,) of the map."""
    rows: int
    cols: int
    row_shift: int
    col_shift: int
    """By how many bits a row, and a column, of the map is shifted to give its tile's."""
    corner_cutting: bool
    levels: Annotated[Int64s, 2]
    """(L, 4) `LEVEL_ROWS` and the others below, of each coarse level."""
    coarse: Floats
    """(…,) weights of all coarse levels, one after another."""
    pieces: Words
    links: Bytes
    """(…,) likewise."""
    costed: Int64s
    """(1,) cells of computed tiles."""
    told: Floats
    """(rows · cols,) costs that were told: a cell weighs by the greater of both."""
    tells: Bools
    """(1,) whether any was."""
    added: Floats
    """(rows · cols,) what layers add to the cost by heights, or (0,)."""
    block_side: int
    """Cells, on a map of which blocks are known by their means; else 0."""
    block_cols: int
    block_prices: Floats
    """(blocks,) T a cell that is not known."""
    block_states: Floats
    """(blocks,) what is known of a block's cells (`kernels.tiles.BLOCK_UNTOUCHED`)."""


LEVEL_ROWS = 0
LEVEL_COLS = 1
LEVEL_STRIDE = 2
LEVEL_FIRST = 3
LEVEL_COLUMNS = 4
"""Of `TileSource.levels`: rows, columns, stride and first node."""


class TilesRecord(NamedTuple):
    """Which tiles of a map of heights have been computed, for a search of one of its levels."""

    state: Annotated[Bytes, 2]
    """(I, J) what has been done to each tile, as bits (`kernels.tiles`)."""
    wanted: int
    """The bit without which a cell of a tile may not be left."""
    row_shift: int
    col_shift: int
    """By how many bits a row, and a column, of the level is shifted to give the tile's."""
    source: Int64s
    """A `TileSource` in memory (`kernels.by_address`)."""
    open_tile: int
    """Address of `open_tile`."""


class GridRecord(NamedTuple):
    """The map that is searched (`map.grid.Grid`)."""

    weights: Floats
    """(nodes,) within a border of impassable cells; inf where impassable."""
    stride: int
    """Nodes from one row to the next."""
    steps: Annotated[Packed, StepTerms]
    corner_cutting: bool
    """Whether a diagonal step may pass beside an impassable cell."""
    tiles: Annotated[Packed, TilesRecord]
    edges: Annotated[Floats, 2]
    """(nodes, 8) what the step that leaves a node in each direction costs, inf where there is none;
    (0, 8) where steps cost by the weights of their ends."""


class LevelRecord(NamedTuple):
    """A level of a map (`map.pyramid`)."""

    weights: Floats
    """(nodes,)"""
    pieces: Words
    """(nodes,) cells of the finer level that each cell stands for, as bits."""
    links: Bytes
    """(nodes,) directions in which each cell is linked to its neighbour, as bits."""
    stride: int
    rows: int
    cols: int


class Terms(NamedTuple):
    """The terms of Eq. 1 (`terrain.traversability.TERMS`), or a factor of each."""

    slope: float
    """rad"""
    roughness: float
    step: float
    """Elevation difference, m."""


class Spans(NamedTuple):
    """Factors that make differences of heights slopes, 1/m, along a row or a side and across it."""

    along: float
    across: float


class CostFactors(NamedTuple):
    """How heights become costs, in float32."""

    inverse: Terms
    """1 over the limit of each term."""
    weights: Terms
    hard: Terms
    """Cells beyond one of these are impassable."""
    scale: float
    """Weight of a cost of 1."""
    whole: Spans
    """Of a cell all of whose patch is known."""
    by_row: Spans
    by_col: Spans
    """Of a cell at a side of the map that is a row, or a column."""


class HeightsRecord(NamedTuple):
    """Of a map."""

    heights: Floats
    """(rows · cols,) metres, row by row; not finite where unknown."""
    rows: int
    cols: int


class CostLimits(NamedTuple):
    """What a passable cell may cost, and how costs become weights."""

    floor: np.float32
    most: np.float32
    """Least and most of a passable cell."""
    scale: np.float32
    """Weight of a cost of 1."""
    ceiling: np.float32
    """NaN and costs from here up are impassable."""


class Rectangle(NamedTuple):
    """A part of a map by its first cell and its size."""

    row: int
    col: int
    rows: int
    cols: int


class RegionRecord(NamedTuple):
    """The cells that a search may enter: (row, col) where
    ``bitmap[row_block[row], col_block[col]] == stamp``. An empty bitmap stands for the whole map.
    """

    bitmap: Annotated[Int32s, 2]
    """(I, J) the number that each block was marked with last."""
    row_block: Int32s
    """(H,) row of the bitmap for each row of the map."""
    col_block: Int32s
    """(W,) column of the bitmap for each column of the map."""
    stamp: int


# A search


class Ends(NamedTuple):
    """Nodes that a search leads from and to; a start of -1: go on where the last call stopped."""

    start: int
    goal: int


class Limits(NamedTuple):
    """When a call of a search ends, at the latest."""

    most: int
    """Expansions in this call."""
    until: float
    """A reading of the clock, s."""


class Memory(NamedTuple):
    """Scratch memory of a search, and its number (`search.workspace.Workspace`)."""

    g: Floats
    """(2 · nodes,) g of node n at 2n, in memory shared with `meta`."""
    meta: Int32s
    """(2 · nodes,) at 2n + 1 the search's number, flags, and the direction from the parent."""
    stamp: int
    heads: Int32s
    """(BUCKETS,) first entry of each bucket of the open list (`kernels.open_list`)."""
    entries: Int32s
    """(2 · room,) the node of entry e at 2e, the next entry of its chain at 2e + 1."""
    control: Int64s
    reals: Doubles
    """What `FREE` and `BASE`, and the others below them, say."""
    path: Annotated[Int32s, 2]
    """(N, 2 or 3) cells of the path found, goal first, and of a body the state on each."""


FREE = 0
USED = 1
FINE_AT = 2
BLOCK = 3
LENGTH = 4
EXPANSIONS = 5
BEST_NODE = 6
GOAL_STATE = 7
CONTROL_SLOTS = 8
"""Of `Memory.control`: the fields of a `Queue` that are whole numbers; expansions so far; the
expanded node nearest the goal, in the end the goal itself; the body's state at the goal, -1 until
it has been reached."""
BASE = 0
INVERSE_WIDTH = 1
REFUSED = 2
BEST_H = 3
BOUND = 4
REAL_SLOTS = 5
"""Of `Memory.reals`: those that are not; the least f of a node that the region refused; h of the
best node; the bound on f."""


class Queue(NamedTuple):
    """Where an open list stands. A kernel holds it in registers, and in `Memory` between calls."""

    free: int
    """First of the entries that were taken off, as a chain; -1 without any."""
    used: int
    """Entries that have been used so far."""
    fine_at: int
    """Fine bucket that is being emptied."""
    block: int
    """Coarse bucket that has been dealt out into the fine ones."""
    length: int
    """Entries on the list."""
    base: float
    """Least f of the first bucket."""
    inverse_width: float
    """Buckets to an f of 1."""


class Rule(NamedTuple):
    """How nodes are searched (`kernels.expansion.expand`)."""

    h_straight: float
    h_diagonal: float
    """Prices of a straight and of a diagonal step, by which the octile distance is h."""
    width: float
    """Of a bucket of the open list at first, in units of f."""
    successors: Int64s
    """(16,) of the grid, one of `SUCCESSORS`."""


class Hints(NamedTuple):
    """Landmarks that sharpen h (`search.landmarks`)."""

    fields: Floats
    """(nodes, MOST_LANDMARKS) cost from each landmark; (0, MOST_LANDMARKS) without any."""
    at_goal: Floats
    """(MOST_LANDMARKS,) costs at the goal."""
    slack: float
    """What they may be off by."""


class Judge(NamedTuple):
    """By what the cost that is left from a node is judged."""

    stride: int
    goal: int
    goal_row: int
    goal_col: int
    """The node, and its row and column within the border."""
    h_straight: float
    h_diagonal: float
    hints: Hints


class Task(NamedTuple):
    """What stays the same while nodes are expanded."""

    grid: GridRecord
    terms: StepTerms
    """In float32."""
    region: RegionRecord
    judge: Judge
    beyond: float
    memory: Memory


class Frontier(NamedTuple):
    """How far a search has come."""

    queue: Queue
    bound: float
    """Nodes whose f is not below it are left out; inf until the goal has been reached."""
    last_bucket: int
    """The last bucket of the open list with an f below the bound."""
    refused: float
    """Least f of a node that the region refused."""


# D* Lite


class DStar(NamedTuple):
    """What D* Lite searches, and what it knows (`search.dstar_lite`)."""

    grid: Annotated[Packed, GridRecord]
    region: Annotated[Packed, RegionRecord]
    goal: int
    start: int
    start_row: int
    start_col: int
    """The node, and its row and column within the border."""
    h_straight: float
    h_diagonal: float
    """Prices of the octile distance."""
    km: float
    g: Doubles
    rhs: Doubles
    """(nodes,)"""
    keys: Doubles
    nodes: Int32s
    """(nodes + SPARE_SLOTS,) of each entry of the open list; a key of inf where there is none."""
    slots: Int32s
    """(nodes,) the entry of each node; `ABSENT` without."""
    size: Int64s
    """(1,) entries on the list."""


# Directed steps


class SlopePrices(NamedTuple):
    """What a metre of a directed step costs by its slope, less what its rise is worth
    (`robots.slope.cost.Table`).
    """

    kinks: Doubles
    """(K,) slopes at which it jumps or bends."""
    level: Doubles
    gradient: Doubles
    """(N,) of each segment of slopes: cost a metre, and cost a metre of rise."""
    least_per_m: float
    """The cheapest metre."""
    height_price: float
    """Worth of a metre of rise."""


class Ways(NamedTuple):
    """The step in each direction: the eight neighbours', or a body's sixteen legs."""

    leads: Int64s
    """(K, 2) rows and columns that it leads."""
    lengths: Doubles
    """(K,) metres."""
    by_weights: bool
    """Whether it may enter no impassable cell; of legs, poses decide."""
    corner_cutting: bool
    """Whether a diagonal step may pass beside one."""


class FinerSteps(NamedTuple):
    """Steps of a finer level, or of the map, that are averaged."""

    steps: Floats
    """(H + 2, W + 2, K) by cell and direction."""
    neighbours: Int64s
    """(8,) which of the K lead to the neighbours."""


# Corridors


class FloodMemory(NamedTuple):
    """Scratch memory of a flood."""

    reached: Floats
    """(nodes,) least cost from the start so far."""
    queued: Bytes
    """(nodes,) whether a node is in the queue, 0 at first and in the end."""
    queue: Int32s
    """(2^n,) nodes."""


class Width(NamedTuple):
    """How wide a corridor is."""

    radius: int
    """The quarters of cells within so many of the path's are marked, as the king moves."""
    band: float
    """And cells on paths that cost at most 1 + `band` times as much."""
    coarse_radius: int
    coarse_band: float
    """Added between two coarse levels."""


class CoarseLevel(NamedTuple):
    """A coarse level, as `kernels.corridor.descend` searches it."""

    grid: Annotated[Packed, GridRecord]
    """With the edges of steps that come to a node: it is searched from the goal."""
    links: Bytes
    edges: Annotated[Floats, 2]
    """Of steps that leave a node."""
    rule: Annotated[Packed, Rule]
    memory: Annotated[Packed, Memory]
    flood: Annotated[Packed, FloodMemory]
    bitmap: Annotated[Int32s, 2]
    """(2 rows, 2 cols) over the quarters of its cells: where to search the next finer level."""
    marked: Int64s
    """(1,) the number that was marked last."""
    row_block: Int32s
    col_block: Int32s
    """The quarter of its cells in which each row, and each column, of the next finer level lies."""
    expand: int
    """Address of `expand`."""


TOP = 0
LEVEL_AT = 1
BEGUN = 2
SPENT = 3
DESCENT_SLOTS = 4
"""Of a descent: its first level, the level that is searched, whether its search has begun, and the
expansions so far."""


# Regions of a network


class Lookup(NamedTuple):
    """The block that each row, and each column, of a grid lies in."""

    row_block: Int32s
    col_block: Int32s
    """(H,) and (W,)"""


class RegionQuery(NamedTuple):
    """Start and goal as nodes, the blocks that belong to any region, and how regions are found."""

    start: int
    goal: int
    blocks: tuple[tuple[int, int], tuple[int, int]]
    touching: bool
    """Whether each step of the grid leads to the same block or one that touches it: then blocks
    joined bound what cells are.
    """
    factor: float
    """The share of td, in (0, 1], down to which the second region goes."""


class ThresholdMemory(NamedTuple):
    """Scratch memory of a `region.learned.RegionFinder`."""

    levels: Bytes
    """(B + 1, B + 1) level of each block, 0 in the last row and column."""
    heads: Int32s
    """(LEVELS,) first block, or node, that waits at each level."""
    following: Int32s
    """(blocks,) the next that waits there."""
    done: Bytes
    """(blocks,)"""


class RegionMarks(NamedTuple):
    """Where regions are marked, and the number that is written."""

    stamp: int
    at_td: Int32s
    """(B + 1, B + 1) of the region at td."""
    bitmap: Int32s
    """(B + 1, B + 1) of the second one."""


# Lines


class Room(NamedTuple):
    """Obstacles that lines must keep away from (`map.state.MapState.room`); a radius of 0 for a
    point and a body.
    """

    weights: Floats
    """(nodes,) a point's, inf where a cell is an obstacle or off the map."""
    rows: int
    cols: int
    radius: float
    """Of a disc, m."""
    cell_height: float
    cell_width: float
    """Sides of a cell, m."""


class GroundRecord(NamedTuple):
    """What lines are priced by, and where they may lead."""

    weights: Floats
    """(nodes,) of the grid."""
    stride: int
    per_cell: float
    per_weight: float
    """A cell's length costs so much, and so much for each unit of weight."""
    corner_cutting: bool
    room: Room


class Leg(NamedTuple):
    """The straight way between two places, (row, col) in cells."""

    row: float
    col: float
    to_row: float
    to_col: float


class Stage(NamedTuple):
    """How stations are moved (`kernels.stations`): a row of `tuning.ANY_ANGLE`."""

    spacing: float
    """Cells between stations."""
    step: float
    """Cells between a station's places."""
    half: int
    """Places to each side of the path."""
    samples: int
    """Of the weight along each half of a leg."""
    smooths: bool
    """Whether each station is the mean of three."""


class Places(NamedTuple):
    """The places of all stations."""

    rows: Doubles
    cols: Doubles
    """(stations, places)"""


# Bodies


class PoseTables(NamedTuple):
    """What the check samples of the ground, motion by motion (`robots.body.motions.Motions`)."""

    poses_of: Int64s
    """(motions + 1,) where each motion's poses begin."""
    groups_of: Int64s
    """(poses + 1,) where each pose's groups of samples begin: of its wheels, then of its belly."""
    groups: Int64s
    """(groups + 1, 5) `SAMPLES_OF_FOUR` and the others below, of each group; last where all
    cells end.
    """
    ahead: Floats
    left: Floats
    """(samples,) metres from the body's middle."""
    offsets: Int64s
    shares: Floats
    """(cells,) places of samples' cells among the heights, from that of the motion's cell, and
    shares of their heights.
    """
    fit_of: Int64s
    """(poses + 1,) where the cells begin by which each pose's plane is fitted."""
    fit_offsets: Int64s
    """(fitted,) places of these."""
    fit_shares: Floats
    """(fitted, 2) what each height adds to the plane's slopes ahead and to the left."""
    raised_of: Int64s
    """(groups + 1,) where each group's wheels begin whose greatest heights make the plane lowest
    there.
    """
    raised: Int64s
    """Those wheels."""
    swept: Floats
    """(poses, 3) `SWEPT_AHEAD` and the others below, of each pose."""
    gradients: Floats
    """(5, wheels) `LEVEL` and the others below: what a wheel's height adds to the plane."""
    carried: Floats
    """(8,) pairs, `CARRIED_ALONG` and the others below."""


class PosesRecord(NamedTuple):
    """A body's motions on a map: what is known of them, and what it takes to check the others
    (`robots.body.poses`).
    """

    codes: Words
    """(nodes, M) of each motion that begins on a node: `UNCHECKED`, 1 + T · `MOST_CODE`, rounded
    up, or `FAILS` + the limit that refuses it (`kernels.poses`).
    """
    heights: Floats
    """(H, width) metres, within a margin of unknown cells, as one row."""
    added: Floats
    """(H, width) what layers add to T, likewise; (0,) without any."""
    tables: Annotated[Packed, PoseTables]
    limits: Floats
    """(9,) of the vehicle, by `REFUSALS`, and `TILT_SHARE` and the others."""
    scratch: Floats
    """(wheels · LANES,)"""
    counts: Int64s
    """(1,) poses checked so far."""
    rows: int
    cols: int
    """Of the map."""
    width: int
    """Numbers from one row of heights to the next."""
    margin: int
    block_side: int
    """Cells, on a map of which blocks are known by their means; else 0."""
    block_prices: Floats
    """(blocks,) T a cell that is not known."""
    check_run: int
    """Address of `check_run`."""


FIT_AHEAD = 0
FIT_LEFT = 1
"""Columns of `PoseTables.fit_shares`."""
SAMPLES_OF_FOUR = 0
SAMPLES_OF_TWO = 1
SAMPLES_OF_ONE = 2
SAMPLES_END = 3
FIRST_CELL = 4
"""Of a group: its first sample, the first that is a mean of two cells, and that is one, their end;
its first cell."""
SWEPT_AHEAD = 0
SWEPT_LEFT = 1
SWEPT_TURN = 2
"""Of a pose: metres by which a point under the body may lie elsewhere, and its turn in rad."""
LEVEL = 0
ALONG = 1
ACROSS = 2
MOST_ALONG = 3
MOST_ACROSS = 4
"""Of a wheel's height: what it adds at the body's middle, to the slopes ahead and to the left, and
to these two whatever its sign."""
CARRIED_ALONG = 0
CARRIED_ACROSS = 2
CARRIED_DOWN = 4
CARRIED_STEP = 6
"""By each unit of slope ahead, and to the left, by which contacts depart from the plane: what they
may add to the slopes, to how low the belly comes, and to the step, as a wheel may touch anywhere in
its patch. First of each pair."""


class Figures(NamedTuple):
    """Of a run's poses: bounds of the steepest slope, of pitch and roll (as slopes), of the step
    and of the rise under the belly, m; and slopes with the wheels in the middle of their ranges.
    """

    slope: Floats
    pitch: Floats
    roll: Floats
    step: Floats
    rise: Floats
    ahead: Floats
    left: Floats


class Plane(NamedTuple):
    """Of a run's poses: its height at the body's middle, m, and its slopes."""

    level: Floats
    along: Floats
    across: Floats


# States of a body


class Legs(NamedTuple):
    """Least costs of straight, diagonal and knight's legs."""

    straight: float
    diagonal: float
    knight: float


class FrameRecord(NamedTuple):
    """How states are numbered: a node's come one after another."""

    bits: int
    """Binary digits of a state's number among those of its node."""
    stride: int


class Prices(NamedTuple):
    """A body's motion primitives and what they cost, in cells of level ground
    (`robots.body.primitives`).
    """

    unit: np.float32
    """By how much each step of a code makes a motion dearer, as a share."""
    moves: Int32s
    """(S, P, 5) `DOWN` and the others below, of each primitive of each state of a cell."""
    fares: Floats
    """(S, P, 2) `BY_LENGTH` and `FIXED`, of each."""
    origins: Int32s
    """(S, P) the state from which a primitive leads to each; -1 where none does."""
    rays: Int32s
    """(R, 5) ways from cell to cell whatever the direction, as `moves`."""
    ray_fares: Floats
    """(R,) cells that each costs by its code."""
    turns: Floats
    """(16, 16) what turns between directions cost."""


DOWN = 0
RIGHT = 1
TO = 2
MOTION = 3
THERE = 4
MOVE_COLUMNS = 5
"""Of a primitive: rows and columns to the cell that it leads to, the state there among those of
a cell (-1 where no such primitive is); the motion that is checked, and whether that begins
there."""
BY_LENGTH = 0
FIXED = 1
FARE_COLUMNS = 2
"""Of what a primitive costs: cells on the best ground, which its code makes dearer, and what comes
to it always.
"""


class Seeds(NamedTuple):
    """Cells that a field begins with."""

    nodes: Int32s
    costs: Floats
    """What each costs."""
    onwards: Int32s
    """Direction in which the way on leaves each."""


class FieldRule(NamedTuple):
    """How a field is filled."""

    legs: Annotated[Packed, Legs]
    """By which what is left is judged."""
    width: float
    """Of a bucket of the open list at first."""
    between: Floats
    """(16, 16) costs of turns between directions: each cell's cost is then that of a way with its
    turns. As the cell's best way on is what counts for all that come to it, nearly the least.
    (0, 16): turns are free, and no way costs less.
    """


class Field(NamedTuple):
    """Costs to the goal of cells, as `fill_field` left them; no g without any."""

    g: Floats
    meta: Int32s
    stamp: int
    row: int
    col: int
    """Where it was to end, the start, within the border."""
    floor: float
    """What it costs from there."""
    between: Annotated[Floats, 2]
    """As of the rule that it was filled by."""


class StateRule(NamedTuple):
    """How states are searched (`kernels.lattice.expand_states`)."""

    legs: Annotated[Packed, Legs]
    """By which what is left is judged."""
    width: float
    beyond: float
    """As of a `Rule`."""
    again: float
    """By how much an expanded state must become cheaper to be expanded again, for each expansion so
    far: 0 where what is left is judged consistently.
    """
    gear_change: float
    """What it costs, of a body whose states have gears."""
    frame: Annotated[Packed, FrameRecord]
    starting: Bools
    """(S,) states in which it may start, one at least."""
    wanted: Bools
    """(S,) states that will do at the goal."""


class CellJudge(NamedTuple):
    """By what the cost that is left from a cell is judged: distances alone."""

    stride: int
    row: int
    col: int
    legs: Legs


class StateJudge(NamedTuple):
    """By what the cost that is left from a state is judged."""

    frame: FrameRecord
    row: int
    col: int
    """The goal, within the border."""
    legs: Legs
    field: Field


class FieldTask(NamedTuple):
    """What stays the same while a field is filled."""

    poses: PosesRecord
    edges: Floats
    prices: Prices
    region: RegionRecord
    judge: CellJudge
    start: int
    between: Floats
    memory: Memory


class StateTask(NamedTuple):
    """What stays the same while states are expanded."""

    poses: PosesRecord
    edges: Floats
    prices: Prices
    region: RegionRecord
    judge: StateJudge
    goal: int
    rule: StateRule
    memory: Memory
