"""A map that is planned on: its grid, its coarse levels, and the log of its changes."""

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.map.changes import Change, ChangeLog, ChangeReader
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Pyramid
from nnpp_edge.runtime.map.step_cost import StepModel


class MapState:
    """The newest map. Whoever keeps something that depends on it reads the log of changes when asked.

    Serves one thread at a time.

    Parameters
    ----------
    cost : (H, W) float
        As for `Grid.of`.
    model : StepModel
        What a step costs.
    corner_cutting : bool
        Whether a diagonal step may pass beside an impassable cell.

    Raises
    ------
    InvalidMapError
        The map is not two-dimensional, is empty, or holds a cost out of range.
    """

    def __init__(self, cost: Float2D, model: StepModel, *, corner_cutting: bool = True) -> None:
        self.grid = Grid.of(cost, model, corner_cutting)
        self._forget()

    def __getstate__(self) -> dict[str, object]:
        """The weights: a copy starts a log of its own."""
        return {"grid": self.grid}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._forget()

    def begin_anew(self) -> None:
        """Forget all but the weights. Whoever read the log must be made anew."""
        self.grid.measure_bounds()
        self._forget()

    def _forget(self) -> None:
        self.log = ChangeLog()
        self._pyramid: Pyramid | None = None
        self._unpooled: ChangeReader | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pyramid(self) -> Pyramid:
        """The coarse levels, as the map is now. Made when first read, and brought up to date when read again."""
        if self._pyramid is None or self._unpooled is None:
            self._pyramid, self._unpooled = Pyramid(self.grid), self.log.reader()
        elif self._unpooled.behind:
            changes = self._unpooled.read()
            whole = (0, 0, *self.shape)
            for part in [whole] if any(c.rescaled for c in changes) else [c.part for c in changes]:
                self._pyramid.update(part)
        return self._pyramid

    def update(self, row: int, col: int, patch: Float2D) -> Change:
        """Put new costs into the map, and what that changed into the log, unless it changed nothing.

        Parameters
        ----------
        row, col : int
            Where the patch's first cell goes.
        patch : (h, w) float
            New costs; must lie inside the map.

        Raises
        ------
        InvalidMapError
            As for `Grid.update`; the map is as it was.
        """
        change = self.grid.update(patch, (row, col), keep_old_weights=self.log.keeps_old_weights)
        if change.cells:
            self.log.append(change)
        return change
