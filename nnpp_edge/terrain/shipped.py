"""The elevation maps that travel with the package; sources and licences are in `samples/README.md`."""

from importlib.resources import files
from pathlib import Path

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import Dem, read_dem

SAMPLES = ("earth_hummocks", "mars_victoria", "moon_highlands", "moon_rocks")


def sample_path(name: str) -> Path:
    """The file of a map in `SAMPLES`; InvalidQueryError if there is none of that name."""
    if name not in SAMPLES:
        raise InvalidQueryError(f"sample must be one of {', '.join(SAMPLES)}, got {name!r}")
    return Path(str(files("nnpp_edge.terrain") / "samples" / f"{name}.npz"))


def sample_dem(name: str) -> Dem:
    """A map in `SAMPLES`, to try things with.

    Examples
    --------
    >>> dem = sample_dem("mars_victoria")
    >>> dem.shape, dem.cell_size_m
    ((256, 176), 1.0)
    """
    return read_dem(sample_path(name))
