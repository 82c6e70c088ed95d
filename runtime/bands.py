"""A map's rows shared out over the cores, where that pays."""

import os
import threading
from collections.abc import Callable, Iterator

from nnpp_edge.runtime.tuning import STRIPE_CELLS, THREADS_FROM


def in_bands(
    work: Callable[[int, int], None],
    first: int,
    last: int,
    cols: int,
    multiple: int = 1,
    threads_from: int = 0,
) -> None:
    """Call `work` for rows from `first` on, as (first, one past the last), once or, on larger maps,
    on each core.

    Threads are started for the occasion: a pool that waits between two maps costs as much, and has
    to be minded when the process forks. `work` releases the interpreter's lock and writes to rows
    of its own; bands but the last have multiples of so many rows; `threads_from` is in cells,
    `THREADS_FROM` if 0.
    """
    cores = (
        len(os.sched_getaffinity(0))
        if (last - first) * cols >= (threads_from or THREADS_FROM)
        else 1
    )
    height = -(-(last - first) // (cores * multiple)) * multiple
    bands = [(row, min(row + height, last)) for row in range(first, last, height)]
    failed: list[BaseException] = []

    def guarded(band: tuple[int, int]) -> None:
        try:
            work(*band)
        except BaseException as error:  # raised below, in the thread that asked
            failed.append(error)

    threads = [threading.Thread(target=guarded, args=(band,), daemon=True) for band in bands[1:]]
    for thread in threads:
        thread.start()
    guarded(bands[0])
    for thread in threads:
        thread.join()
    if failed:
        raise failed[0]


def stripes(
    rows: int, cols: int, multiple: int = 1, *, whole: bool = False
) -> Iterator[tuple[int, int]]:
    """A map's rows, as (first, one past the last): a few at a time, so that the clock can be read,
    or the `whole`.

    Stripes begin at multiples of so many rows.
    """
    height = rows if whole else max(STRIPE_CELLS // max(cols * multiple, 1), 1) * multiple
    return ((first, min(first + height, rows)) for first in range(0, rows, height))
