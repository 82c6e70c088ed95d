"""A map's rows shared out over the cores, where that pays."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

from nnpp_edge.runtime.tuning import STRIPE_CELLS, THREADS_FROM


def in_bands(
    work: Callable[[int, int], None],
    first: int,
    last: int,
    cols: int,
    multiple: int = 1,
    threads_from: int = THREADS_FROM,
) -> None:
    """Call `work` for rows from `first` on, as (first, one past the last), once or, on larger maps,
    on each core.

    Threads are started for the occasion: ones that wait between two maps cost as much, and have
    to be minded when the process forks. `work` releases the interpreter's lock and writes to rows
    of its own; bands but the last have multiples of so many rows; `threads_from` is in cells.
    """
    shared = (last - first) * cols >= threads_from
    cores = len(os.sched_getaffinity(0)) if shared else 1
    height = -(-(last - first) // (cores * multiple)) * multiple
    own, *others = [(row, min(row + height, last)) for row in range(first, last, height)]
    if not others:
        work(*own)
        return
    with ThreadPoolExecutor(len(others)) as threads:
        at_work = threads.map(work, *zip(*others, strict=True))
        work(*own)
        list(at_work)  # raises what was raised there


def stripes(
    rows: int, cols: int, multiple: int = 1, *, whole: bool = False
) -> Iterator[tuple[int, int]]:
    """A map's rows, as (first, one past the last): a few at a time, so that the clock can be read,
    or the `whole`.

    Stripes begin at multiples of so many rows.
    """
    height = rows if whole else max(STRIPE_CELLS // max(cols * multiple, 1), 1) * multiple
    return ((first, min(first + height, rows)) for first in range(0, rows, height))
