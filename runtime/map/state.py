"""A map that is planned on: its grid, its coarse levels, and the log of its changes."""

import math
from typing import TYPE_CHECKING

from nnpp_edge.runtime.arrays import Bool, Cells, Float2D
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.records import Packed
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.along import Along, Line
    from nnpp_edge.runtime.map.pyramid import Pyramid
    from nnpp_edge.runtime.map.unseen import Unseen


class MapState:
    """The newest map. Serves one thread at a time. Made by `map.kinds.map_state`.

    Whoever keeps something that depends on it reads the log of changes when asked. The kinds of
    maps are `map.kinds.CostState`, `map.heights.HeightState`, `map.coarse.CoarseState` and
    `map.disc.DiscState`.
    """

    grid: Grid
    unseen: "Unseen | None" = None
    """Blocks that are known by their means; None where cells are known, or nothing."""
    told: Float2D | None = None
    """(H, W) costs that were told, on a map of heights; None while none were. To be read only."""
    has_heights = False
    """Whether the map was made from heights."""
    room: Packed | None = None
    """Obstacles that a disc's lines must keep away from, see `records.Room`."""
    shut_alone = False
    """Whether a cost below 1 that was told says nothing but that the cell is not shut."""
    _lazy = True
    """Whether what the grid holds is computed as a search reads it."""
    _made_anew: tuple[str, ...] = ("log", "_pyramid", "_unpooled")
    """Attributes that a copy makes of its own."""

    def __init__(self, ground: Ground) -> None:
        self.vehicle = ground.vehicle
        """Whose path it is; None for a point."""
        self.sides_m = None if ground.cell_size_m is None else ground.sides_m
        """Height and width of a cell; None where it is not known."""
        self._start_log()

    def _start_log(self) -> None:
        self.log = ChangeLog()
        self._pyramid: Pyramid | None = None
        self._unpooled: ChangeReader = self.log.reader()

    def begin_anew(self) -> None:
        """Forget all but the layers. Whoever read the log must be made anew."""
        self._start_log()

    def __getstate__(self) -> dict[str, object]:
        """The layers: a copy starts a log of its own."""
        return {name: value for name, value in vars(self).items() if name not in self._made_anew}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self.begin_anew()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pyramid(self) -> "Pyramid":
        """The coarse levels, as the map is now. Made when first read, and brought up to date when
        read again.
        """
        return self.pyramid_by(NEVER)

    def pyramid_by(self, deadline: Deadline) -> "Pyramid":
        """As `pyramid`; at the deadline OutOfTimeError, and the next call goes on from there."""
        changes = self._unpooled.read()
        if self._pyramid is None:
            from nnpp_edge.runtime.map.pyramid import Pyramid

            self._pyramid = Pyramid(self.grid)
            if not self._lazy:
                self.grid.complete(deadline)
        elif any(change.rescaled for change in changes):
            self._pyramid.update((0, 0, *self.shape))
        else:
            for change in changes:
                self._pyramid.update(change.part)
        return self._pyramid.finish(deadline)

    def update(self, row: int, col: int, patch: Float2D, seen: Bool | None = None) -> Change:
        """Put new costs (h, w) into the map at (row, col), and what that changed into the log.

        Where nothing is known (NaN) a map of costs becomes impassable, and on a map of heights
        nothing is told. `seen` are the cells that get new costs, by default all. InvalidMapError as
        for `Grid.update`; the map is as it was.
        """
        raise NotImplementedError

    def update_elevation(
        self, row: int, col: int, patch: Float2D, seen: Bool | None = None
    ) -> Change:
        """Put new elevations into a map that was made from such, and what that changed into the
        log; as `update`.

        Metres, NaN where unknown; heights that the map has already change nothing.
        """
        raise InvalidMapError("wanted costs, as the map was made from such: update takes them")

    def _noted(self, change: Change, part: Rectangle, *, heights: bool = False) -> Change:
        """Put a change into the log, once all that depends on it follows: `part` is where new
        heights, or else costs, were put.
        """
        change = self.grid.robot.follow(change, part, self, heights=heights)
        if change.cells:
            self.log.append(change)
        return change

    def cost(self) -> Float2D:
        """(H, W) float32, a copy of what each cell costs: inf where impassable, NaN where a map of
        costs is unknown.

        By Eq. 1 on a map of heights, whatever vehicle stands on it. Any thread may ask, while
        another changes the map or plans on it: then it is some of the old map and some of the new.
        """
        raise NotImplementedError

    def elevation(self) -> Float2D | None:
        """(H, W) metres, NaN where unknown, a copy; None for a map of costs. Any thread may ask, as
        for `cost`.
        """
        return None

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> Bool:
        """Cells of which nothing is known, of the map or a part; a map of costs tells only if it
        was to keep them.
        """
        raise NotImplementedError

    def known_heights(self, part: Rectangle) -> Float2D:
        """Heights of a part of a map of heights, NaN where they mean nothing."""
        raise NotImplementedError

    def known_along(self, path: Cells) -> int:
        """Number of the cells of a path (N, 2), from its first on, that are known, with all under a
        body.
        """
        return len(path)

    def along(self, line: "Line", at: "Line | None" = None) -> "Along | None":
        """Ground under a line (N, 2) inside the map; None on a map of costs, whose heights are not
        known.

        It is told at places `at` (M, 2), by default where the line crosses rows and columns of
        cells' middles.
        """
        return None

    @property
    def reach_cells(self) -> int:
        """From the vehicle's middle to its farthest corner; 0 for a point."""
        if self.vehicle is None or self.sides_m is None:
            return 0
        return math.ceil(self.vehicle.reach_m / min(self.sides_m))

    @property
    def checked(self) -> int:
        """Poses of a vehicle that have been checked so far."""
        return self.grid.robot.checks

    @property
    def costs_computed(self) -> float:
        """Share of the map's cells whose cost is there, in [0, 1]."""
        tiles = self.grid.tiles
        return 1.0 if tiles is None else tiles.cells_computed / self.grid.cells
