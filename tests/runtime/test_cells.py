"""Rectangles of a map, against sets of their cells."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime.cells import apart, common

rectangles = st.tuples(st.integers(-5, 5), st.integers(-5, 5), st.integers(1, 6), st.integers(1, 6))


def cells(part):
    row, col, rows, cols = part
    return set(itertools.product(range(row, row + rows), range(col, col + cols)))


@given(rectangles, rectangles)
def test_what_two_rectangles_share(one, other):
    both = common(one, other)
    assert (cells(both) if both else set()) == cells(one) & cells(other)


@given(rectangles, st.tuples(st.integers(-9, 9), st.integers(-9, 9)))
def test_cells_between_a_rectangle_and_a_cell(part, cell):
    assert apart(part, cell) == min(max(abs(r - cell[0]), abs(c - cell[1])) for r, c in cells(part))
