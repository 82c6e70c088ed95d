"""Memory that is there before it is needed.

The system backs an array's pages with memory when they are first written to. For a loop that is to keep its rate for
days this is the wrong moment: the first search that comes to a part of the map would wait, and what the process holds
would seem to grow.
"""

import mmap

import numpy as np


def touch(*owners: object) -> None:
    """Write to every page of the arrays among these objects' attributes; their values stay.

    Read-only and strided arrays are left out.
    """
    for owner in owners:
        for value in vars(owner).values():
            if isinstance(value, np.ndarray) and value.flags.c_contiguous and value.flags.writeable:
                value.reshape(-1).view(np.uint8)[:: mmap.PAGESIZE] += 0
