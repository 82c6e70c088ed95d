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

Picture = NDArray[np.uint8]
Cells = NDArray[np.int32]
Colour = tuple[int, int, int]
"""Blue, green, red."""
Point = tuple[float, float]

START: Colour = (0, 215, 255)
GOAL: Colour = (30, 20, 225)
INK: Colour = (30, 30, 30)
PAPER: Colour = (250, 250, 250)
_SMALL = 800
_LARGE = 2000
"""Longer sides, in pixels, below which a map is enlarged and above which it is reduced."""
_SHORTEST_M = 1e-12
_LONGEST_M = 1e12
"""Sides of cells between which a bar of a round length can be drawn."""
_SHIFT = 4
"""Points are drawn to 1/16 pixel."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TURN = np.linspace(0.0, 2.0 * math.pi, 33)


class Item(NamedTuple):
    """A symbol and its words, in the strip below the map."""

    width: float
    draw: Callable[[float, float], None]
    """Called with the left edge and the middle line."""


class MapDrawing:
    """A map at a handy size with a margin, what is drawn on it, and a legend below."""

    def __init__(self, ground: Picture) -> None:
        rows, cols = ground.shape[:2]
        longest = max(rows, cols)
        factor = float(math.ceil(_SMALL / longest))
        how = cv2.INTER_NEAREST
        if longest >= _SMALL:
            factor = min(1.0, _LARGE / longest)
            how = cv2.INTER_AREA
        height = max(1, round(rows * factor))
        width = max(1, round(cols * factor))
        if factor != 1.0:
            ground = cv2.resize(ground, (width, height), interpolation=how)  # type: ignore[assignment]
        self.unit = max(1.0, max(height, width) / 1000.0)
        """Pixels to a point: text, lines and symbols are larger on a larger map."""
        self.margin = round(18 * self.unit)
        self.sides = (height / rows, width / cols)
        across = max(width, _SMALL)
        self.left = self.margin + (across - width) // 2
        self.picture: Picture = np.full(
            (height + 2 * self.margin, across + 2 * self.margin, 3), PAPER, np.uint8
        )
        self.picture[self.margin : self.margin + height, self.left : self.left + width] = ground
        self._cells_across = cols * across / width

    def at(self, cell: tuple[int, int]) -> Point:
        """Where the middle of a cell lies, (x, y)."""
        x, y = self._points(np.array([cell]))[0].tolist()
        return x, y

    def _points(self, cells: NDArray[np.generic]) -> NDArray[np.float64]:
        rows, cols = (cells.astype(np.float64) + 0.5).T
        return np.column_stack(
            [cols * self.sides[1] - 0.5 + self.left, rows * self.sides[0] - 0.5 + self.margin]
        )

    def line(self, cells: NDArray[np.generic], colour: Colour, width: float) -> None:
        """A path, `width` points wide."""
        self._stroke(self._points(cells), colour, width)

    def square(self, middle: Point) -> None:
        """The start's symbol."""
        self._polygon(np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 6.5, middle, START)

    def star(self, middle: Point) -> None:
        """The goal's symbol."""
        turns = np.arange(10) * math.pi / 5
        radii = np.where(np.arange(10) % 2, 4.4, 11.0)
        self._polygon(
            np.column_stack([np.sin(turns), -np.cos(turns)]) * radii[:, None], middle, GOAL
        )

    def numbered(self, middle: Point, number: str = "1") -> None:
        """A place between start and goal, by its number."""
        self._polygon(np.column_stack((np.cos(_TURN), np.sin(_TURN))) * 9.0, middle, PAPER)
        self._text(number, middle[0] - 0.5 * self._text_width(number), middle[1])

    def swatch(self, colour: Colour, words: str) -> Item:
        """A key: a patch of colour."""
        corners = np.array([(0, -7), (22, -7), (22, 7), (0, 7)])
        return self._key(22.0, lambda x, y: self._polygon(corners, (x, y), colour), words)

    def grey_bar(self) -> Item:
        """A key: the greys from 0 to 1."""

        def draw(x: float, y: float) -> None:
            width = round(150 * self.unit)
            half = round(7 * self.unit)
            left = round(x)
            top = round(y) - half
            self.picture[top : top + 2 * half, left : left + width] = np.linspace(0, 255, width)[
                :, None
            ]
            cv2.rectangle(self.picture, (left, top), (left + width, top + 2 * half), INK, 1)

        return self._key(150.0, draw, "traversability cost, 0 to 1")

    def scale(self, cell_size_m: float | None) -> list[Item]:
        """A key: a bar of a round length; none where the size of a cell is not known, or absurd."""
        if cell_size_m is None or not _SHORTEST_M < cell_size_m < _LONGEST_M:
            return []
        most = 0.22 * self._cells_across * cell_size_m
        decade = 10.0 ** math.floor(math.log10(most))
        length_m = max(n * decade for n in (1, 2, 5) if n * decade <= most)
        right = length_m / cell_size_m * self.sides[1] / self.unit
        bar = np.array([(0, -5), (0, 5), (0, 0), (right, 0), (right, -5), (right, 5)])

        def draw(x: float, y: float) -> None:
            self._stroke(np.array([x, y]) + bar * self.unit, INK, 1.5)

        return [self._key(right, draw, metres(length_m))]

    def text_item(self, words: str) -> Item:
        """Words alone."""
        return Item(self._text_width(words), lambda x, y: self._text(words, x, y))

    def finish(self, lines: Sequence[Sequence[Item]]) -> Picture:
        """The picture with lines of keys below the map, broken where they are too long for it."""
        gap = 26 * self.unit
        height = round(28 * self.unit)
        right = self.picture.shape[1] - self.margin
        top = self.picture.shape[0]
        half = self.margin / 2
        placed: list[tuple[float, float, Item]] = []
        row = 0
        for items in lines:
            x: float = self.margin
            for item in items:
                if x > self.margin and x + item.width > right:
                    row = row + 1
                    x = self.margin
                placed.append((x, top + height * (row + 0.5) - half, item))
                x += item.width + gap
            row += bool(items)
        strip = np.full(
            (height * row + self.margin // 2, self.picture.shape[1], 3), PAPER, np.uint8
        )
        self.picture = np.concatenate([self.picture, strip])
        for x, y, item in placed:
            item.draw(x, y)
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

    def _polygon(self, corners: NDArray[np.generic], middle: Point, colour: Colour) -> None:
        points = np.array(middle) + corners * self.unit
        cv2.fillPoly(self.picture, [_fixed(points)], colour, cv2.LINE_AA, _SHIFT)
        self._stroke(np.vstack((points, points[:1])), INK, 1.0)

    def _stroke(self, points: NDArray[np.float64], colour: Colour, width: float) -> None:
        thickness = max(1, round(width * self.unit))
        cv2.polylines(self.picture, [_fixed(points)], False, colour, thickness, cv2.LINE_AA, _SHIFT)


def _fixed(points: NDArray[np.float64]) -> Cells:
    return np.asarray(np.rint(points * 2**_SHIFT), np.int32)


def metres(length_m: float) -> str:
    """A length for people, in m or km."""
    return f"{length_m / 1000.0:.4g} km" if length_m >= 1000.0 else f"{length_m:.4g} m"
