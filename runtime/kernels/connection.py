"""Which cells of a map are connected, row after row. See `planners.windowed`."""

from nnpp_edge.runtime.compiled.kernel import helper, kernel


@helper
def _root(parents, label):
    """The label that stands for all that are connected to this one."""
    while parents[label] != label:
        parents[label] = parents[parents[label]]
        label = parents[label]
    return label


@helper
def _joined(parents, one, other):
    """Connect two labels, of which either may be 0 for none; the label that stands for both."""
    if one == 0 or other == 0:
        return one + other
    one, other = _root(parents, one), _root(parents, other)
    least, most = min(one, other), max(one, other)
    parents[most] = least
    return least


@kernel
def label_rows(cost, ceiling, diagonally, above, parents, used, first, ends, found):
    """Label the passable cells of a band of rows, and connect the labels of neighbours.

    Parameters
    ----------
    cost : (h, w) float32
        Passable below `ceiling`.
    ceiling, diagonally : float, bool
        Whether cells at a corner are connected.
    above : (w,) int32
        Labels of the row above, 0 where impassable. Those of the last row, written.
    parents : (n,) int32
        The label that each is connected to, or itself; room for one more a cell. Written.
    used : int
        Labels in use, 0 included.
    first : int
        Row of the map that the band begins with.
    ends : ((row, col), (row, col))
        Cells of the map.
    found : (2,) int32
        Their labels, 0 as long as they have not been come to. Written.

    Returns
    -------
    int
        Labels in use now.
    """
    rows, cols = cost.shape
    for row in range(rows):
        corner = above[0] * 0  # the label above and to the left, before it is overwritten
        for col in range(cols):
            straight, label = above[col], above[0] * 0
            if cost[row, col] < ceiling:
                label = _joined(parents, straight, label)
                if col > 0:
                    label = _joined(parents, above[col - 1], label)
                if diagonally:
                    label = _joined(parents, corner, label)
                    if col + 1 < cols:
                        label = _joined(parents, above[col + 1], label)
                if label == 0:
                    label += used
                    parents[label] = label
                    used += 1
            above[col] = label
            corner = straight

        for n in range(2):
            if ends[n][0] == first + row:
                found[n] = above[ends[n][1]]
    return used


@kernel
def renumber(parents, above, found, numbers):
    """Number what the last row and the ends are connected to anew from 1 on; labels in use, 0 included.

    `numbers` (n,) int32 is 0, and is so again afterwards; `parents` becomes each label itself.
    """
    used = 1
    for n in range(len(above) + 2):
        label = above[n] if n < len(above) else found[n - len(above)]
        if label == 0:
            continue
        root = _root(parents, label)
        if numbers[root] == 0:
            numbers[root] = used
            used += 1
    for n in range(len(above) + 2):
        label = above[n] if n < len(above) else found[n - len(above)]
        if label == 0:
            continue
        number = numbers[_root(parents, label)]
        if n < len(above):
            above[n] = number
        else:
            found[n - len(above)] = number
    numbers[:] = 0
    for label in range(used):
        parents[label] = label
    return used
