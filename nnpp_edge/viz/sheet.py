"""A map brought to a handy size, what is drawn on it, and a legend below. OpenCV alone.

Lengths in pixels. Text is ASCII: OpenCV 4 has no other.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Array, Cells, Floats
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.terrain.facts import metres
from nnpp_edge.viz.palette import (
    BODY,
    GOAL,
    INK,
    PAPER,
    START,
    UNKNOWN,
    Colour,
)

Picture = NDArray[np.uint8]
Shape = tuple[Sequence[Sequence[float]] | Array, Colour, float]
"""A line of points (x, y), its colour and its width; of width 0 a filled polygon with a rim."""

MARGIN = 18
"""Of paper around the map."""
_LINE = 28
"""Of the legend: from one line to the next."""
LEAST_PIXELS = 800
_LARGE = 1200
"""Longer sides, in pixels, below which a map is enlarged and above which it is reduced."""
SHADES = np.uint8(0xF8)
"""Of a ground's colours, the bits that are kept: nobody sees the others, and a file is half as
large without them.
"""
_SHIFT = 4
"""Points are drawn to 1/16 pixel."""
_LEAST_BODY = 7.0
"""Of a vehicle's length: below, it would be a dot."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TURN = np.linspace(0.0, 2.0 * math.pi, 33)
CIRCLE = np.column_stack((np.cos(_TURN), np.sin(_TURN)))
"""Of radius 1."""


_SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
_PATCH = np.multiply(np.add(_SQUARE, (1, 0)), (11.0, 7.0))


class Key(NamedTuple):
    """Words in the strip below the map, with a symbol before them of this width."""

    words: str
    width: float = 0.0
    shapes: Sequence[Shape] = ()


def swatch(colour: Colour, words: str) -> Key:
    """A key: a patch of colour."""
    return Key(words, 22.0, [(_PATCH, colour, 0.0)])


class MapDrawing:
    """A map at a handy size with a margin, what is drawn on it, and a legend below.

    Its ground (H, W, 3) may show a part of a map, from the cell `origin` on, and of it each
    `step`-th cell; all else is given in cells of the map. Its longer side has at `least` so many
    pixels.
    """

    def __init__(
        self, ground: Picture, origin: Cell = (0, 0), step: int = 1, *, least: int = LEAST_PIXELS
    ) -> None:
        rows, cols = ground.shape[:2]
        longest = max(rows, cols)
        factor = max(math.ceil(least / longest), 1) if longest < _LARGE else _LARGE / longest
        height = max(1, round(rows * factor))
        width = max(1, round(cols * factor))
        self.sides = (height / rows / step, width / cols / step)
        """Pixels of a cell of the map."""
        across = max(width, least)
        self._cells_across = across / self.sides[1]
        self._origin = origin

        # the map in the middle of a strip of paper
        self._left = left = MARGIN + (across - width) // 2
        self.picture = _paper(height + 2 * MARGIN, across + 2 * MARGIN)
        self._map = self.picture[MARGIN : MARGIN + height, left : left + width]
        self._map[:] = self._enlarged(ground) & SHADES

    def _enlarged(self, cells: Picture) -> Picture:
        height, width = self._map.shape[:2]
        how = cv2.INTER_NEAREST if height > cells.shape[0] else cv2.INTER_AREA
        return cv2.resize(cells, (width, height), interpolation=how)  # type: ignore[return-value]

    def _points(self, cells: Array) -> Floats:
        """(N, 2) x and y of the middles of cells."""
        places: Floats = (cells.astype(np.float64) - self._origin + 0.5) * self.sides - 0.5
        return np.add(places[:, ::-1], (self._left, MARGIN))

    def hatched(self, mask: NDArray[np.bool_]) -> None:
        """Draw ground, (H, W) as that of the map, that is unknown: stripes on paper."""
        height, width = self._map.shape[:2]
        on = self._enlarged(mask.astype(np.uint8)) > 0
        down, across = np.ogrid[:height, :width]
        stripe = (down + across) % 9 < 2
        self._map[on] = PAPER
        self._map[on & stripe] = UNKNOWN

    def line(self, cells: Array, colour: Colour, width: float) -> None:
        """A path of this width."""
        self._stroke(self._points(cells), colour, width)

    def bodies(self, outlines: Sequence[Array]) -> bool:
        """Draw outlines of a vehicle, rows and columns; whether they are large enough to be
        drawn.
        """
        sizes = [np.ptp(outline * self.sides, axis=0).max() for outline in outlines]
        if max(sizes, default=0.0) < _LEAST_BODY:
            return False
        for outline in outlines:
            self.line(outline, PAPER, 3.0)
            self.line(outline, BODY, 1.2)
        return True

    def ends(self, start: Cell, goal: Cell | None = None) -> None:
        """Draw a square at the start, and a star at the goal, below it."""
        if goal is not None:
            turns = np.arange(10) * math.pi / 5
            tips = np.column_stack([np.sin(turns), -np.cos(turns)])
            self.mark(goal, tips * np.array([[11.0], [4.4]] * 5), GOAL)
        self.mark(start, 6.5 * _SQUARE, START)

    def mark(self, cell: Cell, corners: Array, colour: Colour, sign: str = "") -> None:
        """Draw a place by a polygon, with a number or a sign in it."""
        x, y = self._points(np.array([cell]))[0].tolist()
        self._draw((corners, colour, 0.0), x, y)
        self._text(sign, x - 0.5 * _text_width(sign), y)

    def north(self, degrees: float | None) -> list[Key]:
        """A key: an arrow to the map's north, degrees clockwise from up; none where that is
        unknown.
        """
        if degrees is None:
            return []
        turn = math.radians(degrees)
        tip = 9.0 * np.array((math.sin(turn), -math.cos(turn)))
        side = 0.5 * np.array((-tip[1], tip[0]))
        turned = np.array([-tip, tip, 0.2 * tip - side, tip, 0.2 * tip + side])
        return [Key("grid north", 18.0, [(np.add(turned, (9.0, 0.0)), INK, 1.5)])]

    def scale(self, cell_size_m: float | None) -> list[Key]:
        """A key: a bar of a round length; none where the size of a cell is not known."""
        if cell_size_m is None:
            return []
        most = 0.22 * self._cells_across * cell_size_m
        decade = 10.0 ** math.floor(math.log10(most))
        length_m = max(n * decade for n in (1, 2, 5) if n * decade <= most)
        right = length_m / cell_size_m * self.sides[1]
        bar = [(0.0, -5.0), (0.0, 5.0), (0.0, 0.0)]
        bar += [(right, 0.0), (right, -5.0), (right, 5.0)]
        return [Key(metres(length_m), right, [(bar, INK, 1.5)])]

    def finish(self, lines: Sequence[Sequence[Key]]) -> Picture:
        """Add lines of keys below the map, broken where they are too long for it."""
        bottom, width = self.picture.shape[:2]
        row = 0
        placed = []
        for keys in lines:
            x: float = MARGIN
            for key in keys:
                before = key.width + 8 * bool(key.shapes)
                wide = before + _text_width(key.words)
                if x > MARGIN and x + wide > width - MARGIN:
                    row += 1
                    x = MARGIN
                placed.append((x, row, before, key))
                x += wide + 26
            row += bool(keys)
        strip = _paper(_LINE * row + MARGIN // 2, width)
        self.picture = np.concatenate([self.picture, strip])
        for x, at, before, key in placed:
            y = bottom + _LINE * (at + 0.5) - MARGIN / 2
            for shape in key.shapes:
                self._draw(shape, x, y)
            self._text(key.words, x + before, y)
        return self.picture

    def _text(self, words: str, x: float, y: float) -> None:
        place = (round(x), round(y + 5))
        cv2.putText(self.picture, words, place, _FONT, 0.5, INK, 1, cv2.LINE_AA)

    def _draw(self, shape: Shape, x: float, y: float) -> None:
        points, colour, width = shape
        placed = np.add(points, (x, y))
        if not width:
            cv2.fillPoly(self.picture, [_fixed(placed)], colour, cv2.LINE_AA, _SHIFT)
            placed = np.vstack((placed, placed[:1]))
        self._stroke(placed, colour if width else INK, width or 1.0)

    def _stroke(self, points: Array, colour: Colour, width: float) -> None:
        thickness = max(1, round(width))
        cv2.polylines(self.picture, [_fixed(points)], False, colour, thickness, cv2.LINE_AA, _SHIFT)


def _text_width(words: str) -> int:
    return cv2.getTextSize(words, _FONT, 0.5, 1)[0][0]


def _paper(height: int, width: int) -> Picture:
    return np.full((height, width, 3), PAPER, np.uint8)


def _fixed(points: Array) -> Cells:
    return np.asarray(np.rint(points * 2**_SHIFT), np.int32)
