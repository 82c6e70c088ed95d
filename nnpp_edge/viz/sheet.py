"""A map brought to a handy size, what is drawn on it, and a legend below. OpenCV alone.

Lengths in points: a pixel on maps of up to 1000 pixels, more on larger ones. Text is ASCII: OpenCV
4 has no other.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Cells, Floats
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.viz.palette import (
    BODY,
    ENDED,
    GOAL,
    INK,
    PAPER,
    START,
    UNKNOWN,
    Colour,
)

Picture = NDArray[np.uint8]
Point = tuple[float, float]
Points = NDArray[np.generic]

_SMALL = 800
_LARGE = 2000
"""Longer sides, in pixels, below which a map is enlarged and above which it is reduced."""
_SHIFT = 4
"""Points are drawn to 1/16 pixel."""
_LEAST_BODY = 7.0
"""Points of a vehicle's length below which it would be a dot."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TURN = np.linspace(0.0, 2.0 * math.pi, 33)
CIRCLE = np.column_stack((np.cos(_TURN), np.sin(_TURN)))
"""Of radius 1."""


class Item(NamedTuple):
    """A symbol and its words, in the strip below the map."""

    width: float
    draw: Callable[[float, float], None]
    """Called with the left edge and the middle line."""


class MapDrawing:
    """A map at a handy size with a margin, what is drawn on it, and a legend below.

    Its ground (H, W, 3) may show a part of a map, from the cell `origin` on, and of it each
    `step`-th cell; all else is given in cells of the map. Its longer side has at `least` so many
    pixels.
    """

    def __init__(
        self, ground: Picture, origin: Cell = (0, 0), step: int = 1, *, least: int = _SMALL
    ) -> None:
        rows, cols = ground.shape[:2]
        longest = max(rows, cols)
        factor = max(math.ceil(least / longest), 1) if longest < _LARGE else _LARGE / longest
        height = max(1, round(rows * factor))
        width = max(1, round(cols * factor))
        self.unit = max(1.0, max(height, width) / 1000.0)
        """Pixels to a point: text, lines and symbols are larger on a larger map."""
        self.sides = (height / rows / step, width / cols / step)
        """Pixels of a cell of the map."""
        across = max(width, least)
        self._cells_across = across / self.sides[1]
        self._origin = origin
        self._corner: tuple[int, int, Picture] | None = None

        # the map in the middle of a strip of paper
        self.margin = top = round(18 * self.unit)
        self.left = left = top + (across - width) // 2
        self.picture = _paper(height + 2 * top, across + 2 * top)
        self.map = self.picture[top : top + height, left : left + width]
        """The map's pixels."""
        self.map[:] = self._enlarged(ground)

    def _enlarged(self, cells: Picture) -> Picture:
        height, width = self.map.shape[:2]
        how = cv2.INTER_NEAREST if height > cells.shape[0] else cv2.INTER_AREA
        return cv2.resize(cells, (width, height), interpolation=how)  # type: ignore[return-value]

    def _points(self, cells: Points) -> Floats:
        """(N, 2) x and y of the middles of cells."""
        places: Floats = (cells.astype(np.float64) - self._origin + 0.5) * self.sides - 0.5
        return np.add(places[:, ::-1], (self.left, self.margin))

    def _at(self, cell: Cell) -> Point:
        """Where the middle of a cell lies, (x, y)."""
        return tuple(self._points(np.array([cell]))[0].tolist())

    def hatched(self, mask: NDArray[np.bool_]) -> None:
        """Draw ground, (H, W) as that of the map, that is unknown: stripes on paper."""
        height, width = self.map.shape[:2]
        on = self._enlarged(mask.astype(np.uint8)) > 0
        down, across = np.ogrid[:height, :width]
        stripe = (down + across) % round(9 * self.unit) < 2 * self.unit
        self.map[on] = PAPER
        self.map[on & stripe] = UNKNOWN

    def overview(self, whole: Picture, part: Rectangle, away: Points) -> None:
        """Have the whole map drawn, small, in the corner that is farthest `away` from these cells,
        with the part (in pixels of it) that the picture shows.
        """
        height, width = whole.shape[:2]
        row, col, rows, cols = part
        cv2.rectangle(whole, (col, row), (col + cols - 1, row + rows - 1), PAPER, 4)
        cv2.rectangle(whole, (col, row), (col + cols - 1, row + rows - 1), INK, 2)
        bordered = cv2.copyMakeBorder(whole, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=INK)
        framed = np.asarray(bordered, np.uint8)
        high, wide = framed.shape[:2]
        down, across = (self.map.shape[0] - high, self.map.shape[1] - wide)
        if min(down, across) < 0:
            return
        places = np.subtract(self._points(away)[:, ::-1], (self.margin, self.left))

        def room(corner: Cell) -> float:
            middle = np.add(corner, (high / 2, wide / 2))
            return float(np.abs((places - middle) / (high, wide)).max(1).min())

        top, left = max([(0, across), (0, 0), (down, across), (down, 0)], key=room)
        self._corner = (top, left, framed)

    def line(self, cells: Points, colour: Colour, width: float) -> None:
        """A path, `width` points wide."""
        self._stroke(self._points(cells), colour, width)

    def bodies(self, outlines: Sequence[Points]) -> bool:
        """Draw outlines of a vehicle, rows and columns; whether they are large enough to be
        drawn.
        """
        sizes = [np.ptp(outline * self.sides, axis=0).max() for outline in outlines]
        if max(sizes, default=0.0) < _LEAST_BODY * self.unit:
            return False
        for outline in outlines:
            self.line(outline, PAPER, 3.0)
            self.line(outline, BODY, 1.2)
        return True

    def cross(self, cell: Cell) -> None:
        """Draw where a search ended."""
        x, y = self._at(cell)
        for colour, width in ((INK, 6.0), (PAPER, 4.5), (ENDED, 3.0)):
            for side in (-8.0, 8.0):
                ends = np.array([(-side, -8.0), (side, 8.0)]) * self.unit
                self._stroke(np.add(ends, (x, y)), colour, width)

    def ends(self, start: Cell, goal: Cell | None = None) -> None:
        """Draw a square at the start, and a star at the goal, below it."""
        if goal is not None:
            turns = np.arange(10) * math.pi / 5
            tips = np.column_stack([np.sin(turns), -np.cos(turns)])
            radii = np.array([11.0, 4.4] * 5)
            self._polygon(tips * radii[:, None], self._at(goal), GOAL)
        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        self._polygon(square * 6.5, self._at(start), START)

    def numbered(self, cell: Cell, number: str) -> None:
        """Draw a place between start and goal, by its number."""
        x, y = self._at(cell)
        self._polygon(CIRCLE * 9.0, (x, y), PAPER)
        self._text(number, x - 0.5 * self._text_width(number), y)

    def swatch(self, colour: Colour, words: str) -> Item:
        """A key: a patch of colour."""
        corners = np.array([(0, -7), (22, -7), (22, 7), (0, 7)])
        return self._key(22.0, lambda x, y: self._polygon(corners, (x, y), colour), words)

    def line_key(self, colour: Colour, width: float, words: str) -> Item:
        """A key: a piece of a line, as it is drawn."""

        def draw(x: float, y: float) -> None:
            ends = np.array([(0.0, 0.0), (26.0, 0.0)]) * self.unit
            ends = np.add(ends, (x, y))
            self._stroke(ends, INK, width + 2.0)
            self._stroke(ends, colour, width)

        return self._key(28.0, draw, words)

    def unknown_key(self) -> Item:
        """A key: stripes."""
        corners = np.array([(0, -7), (22, -7), (22, 7), (0, 7)])

        def draw(x: float, y: float) -> None:
            self._polygon(corners, (x, y), PAPER)
            for at in (0.0, 9.0):
                ends = np.array([(at, 7.0), (at + 13.0, -6.0)]) * self.unit
                self._stroke(np.add(ends, (x, y)), UNKNOWN, 2.0)

        return self._key(22.0, draw, "unknown")

    def ended_key(self, words: str) -> Item:
        """A key: the cross."""
        cross = np.array([(-6, -6), (6, 6), (0, 0), (-6, 6), (6, -6)])

        def draw(x: float, y: float) -> None:
            middle = np.add(cross * self.unit, (x + 8 * self.unit, y))
            self._stroke(middle, INK, 4.5)
            self._stroke(middle, ENDED, 3.0)

        return self._key(16.0, draw, words)

    def north(self, degrees: float | None) -> list[Item]:
        """A key: an arrow to the map's north, degrees clockwise from up; none where it is not
        known.
        """
        if degrees is None:
            return []
        turn = math.radians(degrees)
        arrow = np.array([(0, 9), (0, -9), (-5, -2), (0, -9), (5, -2)])
        cos = math.cos(turn)
        sin = math.sin(turn)
        turned = arrow @ np.array([(cos, sin), (-sin, cos)])

        def draw(x: float, y: float) -> None:
            self._stroke(np.add(turned * self.unit, (x + 9 * self.unit, y)), INK, 1.5)

        return [self._key(18.0, draw, "grid north")]

    def cost_bar(self, colours: Picture) -> Item:
        """A key: colours (N, 3) of costs from 0 to 1."""

        def draw(x: float, y: float) -> None:
            half = round(7 * self.unit)
            left = round(x)
            top = round(y) - half
            right = left + round(120 * self.unit)
            bottom = top + 2 * half
            at = np.linspace(0, len(colours) - 1, right - left).astype(int)
            self.picture[top:bottom, left:right] = colours[at]
            cv2.rectangle(self.picture, (left, top), (right, bottom), INK, 1)

        return self._key(120.0, draw, "traversability cost, 0 to 1")

    def scale(self, cell_size_m: float | None) -> list[Item]:
        """A key: a bar of a round length; none where the size of a cell is not known."""
        if cell_size_m is None:
            return []
        most = 0.22 * self._cells_across * cell_size_m
        decade = 10.0 ** math.floor(math.log10(most))
        length_m = max(n * decade for n in (1, 2, 5) if n * decade <= most)
        right = length_m / cell_size_m * self.sides[1] / self.unit
        across = np.array([0.0, 0.0, 0.0, right, right, right])
        bar = np.column_stack((across, [-5, 5, 0, 0, -5, 5]))

        def draw(x: float, y: float) -> None:
            self._stroke(np.array([x, y]) + bar * self.unit, INK, 1.5)

        return [self._key(right, draw, metres(length_m))]

    def text_item(self, words: str) -> Item:
        """Words alone."""
        return Item(self._text_width(words), lambda x, y: self._text(words, x, y))

    def finish(self, lines: Sequence[Sequence[Item]]) -> Picture:
        """Add lines of keys below the map, broken where they are too long for it."""
        if self._corner is not None:
            top, left, framed = self._corner
            self.map[top : top + framed.shape[0], left : left + framed.shape[1]] = framed
        bottom, width = self.picture.shape[:2]
        row = 0
        placed = []
        for items in lines:
            x: float = self.margin
            for item in items:
                if x > self.margin and x + item.width > width - self.margin:
                    row += 1
                    x = self.margin
                placed.append((x, row, item))
                x += item.width + 26 * self.unit
            row += bool(items)
        height = round(28 * self.unit)
        strip = _paper(height * row + self.margin // 2, width)
        self.picture = np.concatenate([self.picture, strip])
        for x, at, item in placed:
            item.draw(x, bottom + height * (at + 0.5) - self.margin / 2)
        return self.picture

    def _key(self, symbol_width: float, symbol: Callable[[float, float], None], words: str) -> Item:
        """A symbol, `symbol_width` points wide, with words to its right."""
        beside = (symbol_width + 8) * self.unit

        def draw(x: float, y: float) -> None:
            symbol(x, y)
            self._text(words, x + beside, y)

        return Item(beside + self._text_width(words), draw)

    def _text_width(self, words: str) -> float:
        return float(cv2.getTextSize(words, _FONT, 0.5 * self.unit, 1)[0][0])

    def _text(self, words: str, x: float, y: float) -> None:
        place = (round(x), round(y + 5 * self.unit))
        weight = max(1, round(0.7 * self.unit))
        cv2.putText(self.picture, words, place, _FONT, 0.5 * self.unit, INK, weight, cv2.LINE_AA)

    def _polygon(self, corners: Points, middle: Point, colour: Colour) -> None:
        points = np.array(middle) + corners * self.unit
        cv2.fillPoly(self.picture, [_fixed(points)], colour, cv2.LINE_AA, _SHIFT)
        self._stroke(np.vstack((points, points[:1])), INK, 1.0)

    def _stroke(self, points: Points, colour: Colour, width: float) -> None:
        thickness = max(1, round(width * self.unit))
        cv2.polylines(self.picture, [_fixed(points)], False, colour, thickness, cv2.LINE_AA, _SHIFT)


def _paper(height: int, width: int) -> Picture:
    return np.full((height, width, 3), PAPER, np.uint8)


def _fixed(points: Points) -> Cells:
    return np.asarray(np.rint(points * 2**_SHIFT), np.int32)


def metres(length_m: float) -> str:
    """A length for people, in m or km."""
    if length_m < 1000.0:
        return f"{length_m:.4g} m"
    return f"{length_m / 1000.0:.4g} km"
