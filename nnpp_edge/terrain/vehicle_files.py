"""Vehicles from TOML: those that travel with the package, and a user's own."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from importlib.resources import files
from pathlib import Path

import msgspec

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, reason
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_SHIPPED = Path(str(files("nnpp_edge.profiles"))) / "vehicles"
_KINDS = {"float": "a number", "int": "a whole number", "bool": "true or false", "float | null": "a number"}
"""What is wanted, in msgspec's words and in ours."""


class VehicleError(InvalidQueryError):
    """A vehicle that cannot be used; the message names the file and the value."""


def shipped_vehicles() -> list[str]:
    """Names of the vehicles that travel with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def load_vehicle(name: str | Path) -> Vehicle:
    """A shipped vehicle by its name, or one from a TOML file of `Vehicle`'s values.

    Raises
    ------
    VehicleError
        There is no such vehicle, or a value is missing, unknown, of the wrong type or out of range.
    """
    return vehicle_of(read_vehicle(name), Path(name).name)


def read_vehicle(name: str | Path) -> dict[str, object]:
    """A vehicle's values as its file has them, not yet checked; VehicleError if there is no file in TOML."""
    path = _SHIPPED / f"{name}.toml" if name in shipped_vehicles() else Path(name)
    if (problem := problem_with_file(path)) is not None:
        wanted = f"wanted a vehicle's file or the name of a shipped one ({', '.join(shipped_vehicles())})"
        raise VehicleError(f"{wanted}, got {str(name)!r} ({problem})")
    try:
        content: dict[str, object] = parse(read_text(path), tomllib.loads)
    except (OSError, ValueError) as error:
        raise VehicleError(f"{path}: wanted a vehicle in TOML ({reason(error)})") from error
    return content


def vehicle_of(values: Mapping[str, object], source: str) -> Vehicle:
    """The vehicle with these values; VehicleError, which begins with `source`, says what was wanted and what came."""
    known = [field.name for field in fields(Vehicle)]
    for name in values:
        if name not in known:
            raise VehicleError(f"{source}: {name} is unknown: wanted one of {', '.join(known)}")
    if "radius_m" not in values:
        for name in ("length_m", "width_m", "clearance_m"):
            if name not in values:
                raise VehicleError(f"{source}: {name} is missing")
    try:
        return msgspec.convert(values, Vehicle)
    except msgspec.ValidationError as error:
        raise VehicleError(f"{source}: {_explained(str(error), values)}") from None


def _explained(problem: str, values: Mapping[str, object]) -> str:
    """msgspec's sentence on a value as ours, with the value that came; ours, from `Vehicle` itself, as it is."""
    if wrong := re.fullmatch(r"Expected `(.+?)`, got `.+` - at `\$\.(\w+)`", problem):
        return f"{wrong[2]}: wanted {_KINDS[wrong[1]]}, got {values[wrong[2]]!r}"
    return problem
