"""Which files GDAL may open: rasters of known formats that hold their heights themselves.

GDAL opens far more than elevation maps, and reads files and addresses that some formats name, or
that lie beside a raster. So the driver is one of `DRIVERS`, and what it would open besides is
checked here before GDAL sees it.
"""

import re
from pathlib import Path

from nnpp_edge.runtime.errors import TerrainError

DRIVERS = ("GTiff", "AAIGrid", "PDS", "SRTMHGT", "EHdr", "HFA")
FORMATS = "GeoTIFF, ESRI ASCII grid, PDS3, SRTM .hgt, ESRI .bil, Erdas .img"
NO_NETWORK = {"CPL_VSIL_CURL_ALLOWED_FILENAME": "none"}
"""GDAL's options under which its file system knows no addresses."""

_RECORDINGS = (".mcap", ".db3", ".bag")
"""Endings of files of ROS messages."""
_HEAD_BYTES = 1 << 20
"""Of a file that are looked at; GDAL tells formats apart by less."""
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PLAIN_STARTS = (*_TIFF_STARTS, b"EHFA_HEADER_TAG")
"""Of TIFF, BigTIFF and Erdas files."""
_XML_FORMATS = re.compile(
    rb"<(VRTDataset|GDAL\w*Dataset|GDAL_W\w+|WCS_GDAL|MRF_META)",
    re.IGNORECASE,
)
"""GDAL looks for some of these anywhere in a file's head, whatever the file begins with."""
_SIDECARS = (".msk", ".ovr", ".aux", ".rrd")
"""Masks, overviews and statistics: GDAL opens those beside a raster with any driver there is."""
_LABEL_END = re.compile(rb"^\s*END\s*$", re.MULTILINE)


def openable(path: Path) -> Path:
    """The name for GDAL to open for an elevation map: of a PDS3 image with a detached label, that
    of the label.

    TerrainError where GDAL would open what is no plain raster: XML, or a label or a sidecar that
    leads elsewhere.
    """
    if path.suffix.lower() in _RECORDINGS:
        hint = "`GridMap` of nnpp_edge.ros.maps makes an .npz of one (docs/how-to-maps.md)"
        raise TerrainError(f"{path}: wanted an elevation map, got a recording of messages; {hint}")
    opened = path
    if path.suffix.lower() == ".img":
        labels = [path.with_suffix(ending) for ending in (".lbl", ".LBL")]
        opened = next(filter(Path.is_file, labels), path)
    # GDAL takes names in a file as they stand where the file's own has no folder: `/vsicurl/…`, say
    opened = opened.absolute()

    head = _head(opened)
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        hint = "; gdal_translate -of COG makes a GeoTIFF of a VRT" if b"<VRTDataset" in head else ""
        raise TerrainError(f"{path}: wanted {FORMATS}, got XML that names other files{hint}")
    if b"PDS_VERSION_ID" in head:
        end = _LABEL_END.search(head)
        # GDAL opens a compressed file with any driver
        if end is None or b"COMPRESSED_FILE" in head[: end.start()].upper():
            raise TerrainError(
                f"{path}: wanted a PDS3 label of at most 1 MiB of an image that is not compressed"
            )
    # libtiff would print on stderr
    if head.startswith(_TIFF_STARTS) and _first_directory(head) >= opened.stat().st_size:
        raise TerrainError(
            f"{path}: wanted a whole TIFF, got one whose first directory lies beyond its end"
        )
    _check_sidecars(path, opened)
    return opened


def _first_directory(head: bytes) -> int:
    """Where a TIFF or BigTIFF file says that its first directory begins."""
    place = head[8:16] if b"+" in head[2:4] else head[4:8]
    return int.from_bytes(place, "little" if head.startswith(b"II") else "big")


def _check_sidecars(path: Path, opened: Path) -> None:
    """TerrainError for a file beside a raster that GDAL would open with it, and that is no plain
    raster.
    """
    start = f"{opened.stem.lower()}."
    for other in opened.parent.iterdir():
        if other.suffix.lower() not in _SIDECARS or not other.name.lower().startswith(start):
            continue
        head = _head(other)
        if not head.startswith(_PLAIN_STARTS) or _XML_FORMATS.search(head):
            raise TerrainError(
                f"{path}: wanted a plain raster in {other.name} beside it, got another kind of file"
            )


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)
