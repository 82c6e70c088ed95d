"""By what the blocks of a map of heights are priced for a vehicle, before any of its poses is checked.

To check all poses would take longer than the search itself, so prices are guessed from what is cheap: they decide how
many poses are checked later, and never what path is allowed.
"""

from enum import StrEnum


class Price(StrEnum):
    """By what blocks are priced."""

    EQ1 = "eq1"
    """Eq. 1 of each cell's own 3 × 3 patch, as for a point."""
    NETWORK = "network"
    """The passage network's prices of the ways from block to block, see `region.looked`."""
