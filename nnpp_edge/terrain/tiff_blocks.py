"""Blocks of a TIFF that are not what was written: libtiff takes many a damaged deflate stream for whole ground.

It gives up on a stream when the block is full, whatever fills it, before the checksum at the stream's end is looked
at. So the streams are decompressed here as well, which takes as long as reading them (24 ns a cell).
"""

import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.tuning import THREADS_FROM
from nnpp_edge.terrain.heights import Window

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_FEW = 8
"""Blocks that are not worth threads."""


class DeflateBlocks:
    """The blocks of a TIFF whose checksums are to be right.

    Parameters
    ----------
    path : Path
        The file.
    dataset : DatasetReader
        The same, open; asked where the blocks lie.
    """

    def __init__(self, path: Path, dataset: "DatasetReader") -> None:
        self._path, self._dataset = path, dataset
        self._used = dataset.driver == "GTiff" and dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION") == "DEFLATE"
        self._right: set[tuple[int, int]] = set()

    def check(self, part: Window) -> None:
        """TerrainError where a block under a window is damaged; each block is looked at once."""
        if not self._used:
            return
        row, col, rows, cols = part
        high, wide = self._dataset.block_shapes[0]
        blocks = {
            (i, j)
            for i in range(row // high, -(-(row + rows) // high))
            for j in range(col // wide, -(-(col + cols) // wide))
        } - self._right
        places = [place for place in map(self._place, sorted(blocks)) if place is not None]
        if len(places) > _FEW:
            in_bands(lambda first, last: self._check_all(places[first:last]), len(places), THREADS_FROM)
        else:
            self._check_all(places)
        self._right |= blocks

    def _place(self, block: tuple[int, int]) -> tuple[int, int] | None:
        """Where a block begins in the file, and its bytes; None for one that was left out."""
        number = f"{block[1]}_{block[0]}"
        at, size = (
            self._dataset.get_tag_item(f"BLOCK_{what}_{number}", "TIFF", bidx=1) for what in ("OFFSET", "SIZE")
        )
        return (int(at), int(size)) if at and size else None

    def _check_all(self, places: Sequence[tuple[int, int]]) -> None:
        for place in places:
            self._check(place)

    def _check(self, place: tuple[int, int]) -> None:
        with self._path.open("rb") as file:
            stream = os.pread(file.fileno(), place[1], place[0])
        try:
            zlib.decompress(stream)
        except zlib.error as error:
            raise TerrainError(f"{self._path}: wanted whole blocks, got a damaged one at byte {place[0]}") from error
