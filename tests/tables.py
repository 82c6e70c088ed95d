"""Tables of cases in tests: a line a case, its cells between bars."""

import pytest


def cases(table, columns=2):
    """A parameter set for each line of a table, whose last cell keeps what further bars divide.

    A `\\n` in a cell is the end of a line. A case is called by its line.
    """
    lines = table.strip("\n").splitlines()
    return [pytest.param(*_cells(line, columns), id=line.strip()) for line in lines]


def keywords(text, names=None):
    """The arguments that a cell gives as a call does, such as ``a=1, b=x``."""
    return eval(f"dict({text})", dict(names or {}))


def _cells(line, columns):
    cells = line.replace("\\n", "\n").split("|", columns - 1)
    return [cell.strip(" ") for cell in cells]
