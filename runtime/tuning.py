"""Every number that steers a search, a region or a choice: value, unit, why, and the figure that
chose it.
"""

import math
from typing import NamedTuple


class CorridorWidth(NamedTuple):
    """How much around a coarse path is searched on the next finer level."""

    radius: int
    """Quarters of coarse cells around the path's own that are searched, as the king moves."""
    band: float
    """Share of the path's cost: cells on coarse paths that cost at most so much more are searched,
    too.
    """
    nearby: float
    """Added to the band for short paths, divided by the coarse cells between start and goal."""
    coarse_radius: int = 0
    coarse_band: float = 0.0
    """Added to radius and band between two coarse levels, where room costs little. A vehicle's body
    searches one coarse level alone."""


# Changes of a map

MOST_LOGGED_CHANGES = 64
"""Changes that wait for a reader unmerged. More would let a reader that is never asked hold
memory; with fewer, merged rectangles cover much that did not change."""

# Cost map

THREADS_FROM = 200_000
"""Cells from which on a map is computed by a thread a core: to start one takes as long as some ten
thousand cells.
"""
STRIPE_CELLS = 1 << 18
"""Cells of a map that are made ready between two readings of the clock: about half a
millisecond.
"""
TILE_ROWS, TILE_COLS = 32, 64
"""Cells of the pieces in which a map of heights is computed: powers of two. In smaller ones rows
are too short for the compiler's loops; of larger ones a search looks at a small part."""
MOST_SAMPLED = 16
"""Cells to the side of the sample by which it is judged, roughly, whether most of a map lies at a
term's limit.
"""

# Exact search

BUCKET_WIDTH, BUCKET_WIDTH_BY_LANDMARKS = 1.0 / 4.0, 1.0 / 256.0
"""Cheapest steps to a bucket of the open list. By landmarks, nearly optimal cells have nearly
the same f: a wide bucket, which is not in order within, would expand many of them again and
again."""
DIRECTED_BUCKET_WIDTH = 1.0 / 1024.0
"""That of steps that cost by their slope, as all gentle ones cost nearly alike: on lunar
terrain, 256², a search by ``energy`` expanded 4,200 cells (median) in place of 290,000, by
``tobler`` 5,300 in place of 19,000."""
MOST_RATIO_FOR_LANDMARKS, MOST_RATIO_FOR_DSTAR = 1e6, 1e8
"""Of the dearest step to the cheapest. float32 rounds off a few cheap steps of a cost: with 1e15
cells were expanded hundreds of times. D* Lite's keys are in order on paths of 20,000 dear steps."""

# Coarse levels

ANOTHER_LEVEL_FROM = 256
"""Cells of a coarse level's longer side from which on another level is put on top of it."""
CELLS_APART = 16
"""The coarsest level that is searched is the last on which start and goal are so many
cells apart.
"""

# Corridors and regions

CORRIDOR = CorridorWidth(1, 0.0015, nearby=0.12, coarse_radius=2, coarse_band=0.04)
"""At first: mean gap 0.11 to 0.19 % on lunar terrain."""
WIDENED_CORRIDOR = CorridorWidth(8, 0.02, nearby=0.12, coarse_radius=2, coarse_band=0.04)
"""Where the first held no path, or not one good enough."""
LEARNED_CORRIDOR = CorridorWidth(1, 0.0005, nearby=0.08, coarse_radius=2, coarse_band=0.02)
"""Inside a learned region, which is searched for speed: mean gap 0.28 to 0.31 %."""
BODY_WEIGHT = 4.0
"""For a vehicle, whose poses coarse levels can only guess, means count so many times there:
where cells are dear on average, poses fail."""
BODY_CORRIDOR = CorridorWidth(2, 0.04, nearby=2.5)
"""For a vehicle: mean gap 0.0 to 0.2 % with up to a tenth of the ground under rocks
(docs/decisions/bodies.md).
"""
WIDENED_BODY_CORRIDOR = CorridorWidth(4, 0.1, nearby=6.0)
"""Where the first held no path for a vehicle, or not one good enough."""
BODY_BAND_UP_TO = 1024
"""Cells from start to goal up to which a body's corridor has all of its band; beyond, the band
shrinks with the root of the distance: over 7,300 cells a car's region is 0.15 of the map, not 0.37.
"""
TURNS_IN_FIELD = 0.7
"""Share of what turns cost that the field of a body's region counts: with 1 paths lie 2.1 %
above the optimum (1.1 % among rocks) in place of 1.1 (0.3); with 0.5 0.4 (0.3) %, for four times
the states of the last search among rocks."""
ARC_TURNS_IN_FIELD = ((1800.0, 0.35), (4096.0, 0.5), (math.inf, 0.7))
"""That of a body that drives arcs, which cost less than turns on the spot do, up to so many cells
from start to goal times cells of its turning radius. Among many small rocks (256², ends across the
map, radius 8 cells) paths lie 0.7 % above the optimum in place of 1.9, with 0.5 1.1. From far, and
with large arcs, the states of the last search grow too many: at 512² 0.35 up to 256 cells and 0.5
up to 600 cost a tenth more time with a radius of 16 cells."""
AT_ENDS = 64
"""Expansions of a body's states from each end before anything else: of 24 queries without a path
22 had an end from which at most 22 states are reached, which took the field 80 to 200 ms."""
LATE_IN_REGION, LATE_ON_MAP = 32768, 16384
"""Expansions of a body's search, of arcs in a region and else, from which on the last metres are
searched from the goal, or as many as filled the field, if those are more: it is filled again then.
With 16,384 alone exact search took 1.15 times as long at 512². In a region after 8,192, 65,536,
never, 512², radius 4 m: median 67, 54, 54 ms, slowest 354, 404, 615; after 16,384, small rocks,
256², p95 1.2 times as long.
"""
CHECKED_SHARE, PROOF_SHARE, RISEN = 0.125, 0.5, 1.01
"""How many expansions of its own that search may take then for each, and for each of a region's
whose states hold no path: where it ends there is none, and the slowest such answer took 1.5 s, not
5.5, with 1.0 as long; and how many times more must be promised by these last metres for the search
to begin again."""
REOPENED_WITHIN = 16384.0
"""Expansions in a body's region after which an expanded state must become cheaper by a cell of the
cheapest ground to be expanded again; after twice as many by two. A field of cells, with turns,
judges states inconsistently: where no path was nearly as cheap as its legs had promised, each was
expanded 34 times (9.0 million expansions for 0.3). With twice as many costs change by 0.01 %."""
AROUND_GOAL = 4096
"""Expansions from a goal with a heading, by which the field of a body's costs to go begins:
without them a first plan took 38 ms (256², radius 2 m), with 4,096 22, with half or four times
as many as long as with these or longer."""
JOIN_WITHIN = 8
"""Cells from a path within which a robot is led back to it."""
BEFORE_BLOCK, MOST_AHEAD = 8, 16
"""Cells before what blocks the standing path, and ahead of the robot, at which a search that takes
longer than a slice starts: so far the robot drives meanwhile, and waits there."""
ON_ARC, ON_ARC_DEG = 1.5, 30.0
"""Distance from an arc's pose, in sides of a cell or at least 0.25 m, and turn up to which a body
counts as driving along it, the one or the other; or as much of each as leaves of the other. Where
each plan began in the body's cell and the nearest of the sixteen headings instead, a car (R = 2 m,
1 m/s, cells of 0.2 m) that took every new path came to no goal, and 111 of 1,010 ticks were late,
for 2 goals and none."""
JOIN_EXPANSIONS, AGAIN_EXPANSIONS = 16384, 8192
"""Expansions of a search that joins a path; and of the cells that a change of the map has opened,
where there was no path.
"""
JOIN_AT = (16, 64)
"""States from the ends of a path at which it is joined to where the robot, or the goal, is by now;
where that needs too many expansions, at the next.
"""
JOIN_MS, GOAL_MOVES = 3.0, 0.25
"""Time in which a path is joined to a goal that has moved; and how far that may have moved, as a
share of the cells from the robot to it, so that the path is joined, and not searched for anew.
"""
ARC_CORRIDOR = CorridorWidth(6, 0.03, nearby=4.5)
"""For a vehicle that drives arcs, which swing out. With a radius of 2 quarters paths of a radius
of 2.7 bodies are 0.2 % dearer and 20 of 60 corridors are widened, not 12. Room counts where the way
is short, and the band costs time where it is long: at 512² (radius 8 cells) paths lie 0.24 % above
the optimum (p95 0.4), with a band of 0.05 and 4 nearby 0.6 (2.8), with 0.02 and 3 0.7 (2.6)."""
ROOMY_ARC_CORRIDOR = CorridorWidth(6, 0.04, nearby=6.0)
"""To a goal with a heading, and for a body that only goes forwards: paths lie 0.13 and 0.33 % above
the optimum to a heading (p95 0.5 and 1.4; radius 8 and 16 cells), as narrow as others 0.3 and 0.6
(2.2 and 4.5); forwards 0.12 and 0.18, as narrow 0.24 and 0.27."""
WIDENED_ARC_CORRIDOR = CorridorWidth(12, 0.1, nearby=6.0)
"""Where the first held no path of arcs, or a doubtful one. With a radius of 4 quarters, less room
at a start than in the first, the whole map was searched for 10 of 148 queries on a crater's rim,
not for 4."""
SWING, MOST_SWING = 3.0, 32
"""Turning radii around an end with a heading that corridors hold for arcs, too, and cells at most.
With a radius of 8 cells 2 in place of 3 came to 1.03 % above the optimum at p95, not 0.82; with 16
cells, where 3 held 0.26 % in the mean and 2 0.34 (512²), first plans took 1.48 and 1.37 times the
older median. Not for bodies that only go forwards: they turned there, 1.44 % (9.1) above the
optimum, where links were corrected, 0.23 (1.0).
"""
MOST_ABOVE_FIELD, DOUBTED_EVERY = 1.25, 1024
"""A path of arcs that costs more times what the legs of its region promised is looked for in a
wider one; and after how many expansions each, unless it takes very long, the region is given up.
Where it was searched to its end, from 1.3 times on, plans among small rocks (256², radius 16 cells)
took 1.3 times as long at p95 and paths lay 1.25 % above the optimum, now 1.14; with 1.1 medians are
1.2 times as long with a radius of 8 cells. Given up late, too, the slowest took 1.6 times as long.
"""
MOST_CORRECTIONS, MOST_ARC_CORRECTIONS = 3, 9
"""How many times a vehicle's region is searched, links corrected in between, before a
wider one is; with arcs their states show where no way leads on. Without corrections 7 of 121 first
plans needed the wider region or the whole map (256², 303 ms for 196 at most), with them 2.
"""
REFINE_FROM = 192
"""Cells of a map's longer side from which on a learned region is searched coarsely first."""
WIDENED_THRESHOLD, WIDENED_BLOCKS = 0.25, 1
"""To widen a learned region, its threshold is multiplied by the first, and so many blocks are added
all around.
"""
WINDOW_ROUNDING, WINDOW_SHARE = 32, 0.6
"""Corner and side of the window that the network is shown are multiples of so many cells; from
so large a share of the map's longer side on, it is shown the whole map instead."""

# Any angle

ANY_ANGLE = (
    (24.0, 6.0, 12, 6, True),
    (16.0, 4.0, 6, 4, True),
    (8.0, 1.8, 4, 2, True),
    (4.5, 0.6, 4, 2, False),
    (3.5, 0.2, 2, 2, False),
)
"""Stages in which stations are moved across a path: cells between stations; cells between a
station's places; places to each side; samples of each half of a leg; whether stations are smoothed.
The first reaches 72 cells, as the paper's diagonal steps draw its paths so far aside
(docs/decisions/any-angle.md)."""
WAY_POINT_SAVES = 0.015
"""Cells of mean ground whose cost each way point saves at least: with 0.01 there are 7 % more, for
0.01 % less; with 0.1 half as many, for 0.1 % more.
"""

# Choice of a method

NEAR = 48
"""Cells: A* finds goals nearer than this before anything else has begun, unless the way is long."""
BRIEF_EXPANSIONS = 1024
"""Expansions that A* may take for a near goal, and twice the square of the distance more."""
SPARSE_FROM = 1 << 25
"""States of a map from which on a corridor's search has small pages. For a car at 8000² planning
took 4.9 s with huge ones, which the system clears whole, and 0.34 without; a point at 2048² took
1.2 times as long with small ones."""
LARGE_MAP, FAR = 1536, 512
"""Size of a map, and cells to the goal, from which on the learned region is clearly the fastest."""

# Planning on a map that changes

UNSEEN_CHANGE = 0.02
"""Change of its view, as a share, that a network need not see: what is passable is read from the
newest map anyway, and to run the network takes as long as a short search."""
REPAIRED_FROM, MOST_CELLS_TO_REPAIR = 0.25, 1 << 20
"""How far from the goal all lies that changed, as a share of the robot's way there, where ``auto``
repairs its last search by D* Lite; and cells of such a map. A tick with a patch near the robot
takes 0.12, 0.12 and 0.15 ms (256², 512², 1024²), with a new corridor 0.3, 0.9 and 2.6. But repairs
near the goal take as long as exact A*, as does the first search for a goal (2, 7, 45 ms), and 32 B
a cell are kept.
"""
MOST_JOINED = 3
"""Regions of D* Lite are joined as long as they hold at most so many times the blocks of the
newest.
"""
MOST_DRIFT, MOST_CHANGED = 1.02, 0.25
"""A path that is joined to the standing one is taken until it may cost so many times what one of a
new search would; and, where no old costs are kept, until so large a share of the map has changed.
"""

# Network

TWO_THREADS_FROM = 256
"""Cells to the side of a network's input from which on two threads are faster than one."""

# Unseen ground

BLOCKED_PRICE, MOST_PRICE = 3.0, 6.0
"""Price of a block whose cells are all impassable, beyond that of T = 1, by the coarse slope,
and of any block, in T a cell. Lunar terrain at 20 m, factor 8, sight of 16 cells, limit20, 200
drives: the driven cost is 6.2 % above the optimum if impassable cells count as T = 1, 4.9 at 1,
4.2 at 2 to 4, 5.2 at 8."""
PRICE_SCALE = 6.1
"""A price divided by it is a cost of a map of blocks: the highest is none that is impassable."""
BLOCKED_PRICES = 2.0, 3.0
"""By a network: that of the share of impassable cells, and that of the chance that a block
cannot be crossed. The same drives: 2.9 % at 1 and 1, 1.9 at 2 and 3; by boosted trees 2.6 and
2.2."""

BLOCKS_AROUND, BLOCKS_BEYOND = 3, 3
"""Blocks to each side of the way over blocks in which cells are searched; and blocks beyond what
has been seen from which on the way leads over their middles."""
MOST_BLOCK_WAYS = 4
"""Ways over blocks that are tried, each around the obstacles that the one before was stopped by,
before all cells are searched."""


class SlopePrice(NamedTuple):
    """Price of a block by its slope, fitted on lunar terrain at 20 m, factors 4 to 16: it explains
    T to 0.08.
    """

    floor: float = 0.15
    """T of level ground."""
    gain: float = 0.76
    """T from level ground to the limit of the slope."""
    spread: float = 0.095
    """Width of the rise of the share of impassable cells, as a share of the limit, at factor 8."""
