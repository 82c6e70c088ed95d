"""Vehicles from TOML, and how they get up and down: those that travel with the package, and a
user's own.
"""

from collections.abc import Iterable, Mapping
from importlib.resources import files
from inspect import signature
from pathlib import Path
from typing import TypeVar

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.options import KINDS
from nnpp_edge.runtime.reading import converted, read_toml
from nnpp_edge.runtime.robots.slope.cost import SLOPE_COSTS, Mobility
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_SHIPPED = Path(str(files("nnpp_edge.profiles"))) / "vehicles"
T = TypeVar("T")


class VehicleError(InvalidQueryError):
    """A vehicle that cannot be used; the message names the file and the value."""


def shipped_vehicles() -> list[str]:
    """Names of the vehicles that travel with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def load_vehicle(name: str | Path) -> Vehicle:
    """A shipped vehicle by its name, or one from a TOML file of `Vehicle`'s values.

    Raises VehicleError where there is none, or a value is missing, unknown, of the wrong type or
    out of range.
    """
    return vehicle_of(read_vehicle(name), Path(name).name)


def load_mobility(name: str | Path, gravity_m_s2: float | None = None) -> Mobility:
    """How a vehicle gets up and down: the table ``[mobility]`` of its file, which may hold nothing
    else.

    A gravity takes the place of the file's, such as `coordinates.gravity_of` a map. Raises
    VehicleError as `load_vehicle`, and where there is no such table.
    """
    found = mobility_of(read_mobility(name), Path(name).name)
    return found if gravity_m_s2 is None else found.under(gravity_m_s2)


def read_mobility(name: str | Path) -> object:
    """The table ``[mobility]`` of a vehicle's file, not yet checked; VehicleError where there is
    none.
    """
    found = read_vehicle(name).get("mobility")
    if found is None:
        raise VehicleError(f"{Path(name).name}: wanted a table [mobility], got none")
    return found


def mobility_of(values: object, source: str) -> Mobility:
    """A mobility of the values of its table; VehicleError, which begins with `source`, says what
    was wrong.
    """
    source = f"{source}: mobility"
    tables = values if isinstance(values, dict) else {}
    _refuse_unknown(tables, SLOPE_COSTS, source)
    for name, model in SLOPE_COSTS.items():
        table = tables.get(name)
        if isinstance(table, dict):
            _refuse_unknown(table, signature(model).parameters, f"{source}.{name}")
    return _converted(values, Mobility, source)


def read_vehicle(name: str | Path) -> dict[str, object]:
    """A vehicle's values as its file has them, not yet checked; VehicleError if there is no file in
    TOML.
    """
    return read_toml(name, _SHIPPED, "vehicle", VehicleError)[1]


def vehicle_of(values: Mapping[str, object], source: str) -> Vehicle:
    """The vehicle with these values; VehicleError, which begins with `source`, says what was wanted
    and what came.
    """
    values = dict(values)
    if "mobility" in values:
        mobility_of(values.pop("mobility"), source)
    _refuse_unknown(values, Vehicle.__annotations__, source)
    on_cells = any(kind.key in values for kind in KINDS if not kind.by_heights)
    for name in () if on_cells else ("length_m", "width_m", "clearance_m"):
        if name not in values:
            raise VehicleError(f"{source}: {name} is missing")
    return _converted(values, Vehicle, source)


def _refuse_unknown(values: Mapping[str, object], known: Iterable[str], source: str) -> None:
    for name in values:
        if name not in known:
            raise VehicleError(f"{source}: {name} is unknown: wanted one of {', '.join(known)}")


def _converted(values: object, kind: type[T], source: str) -> T:
    try:
        return converted(values, kind)
    except InvalidQueryError as error:
        raise VehicleError(f"{source}: {error}") from None
