"""Which method `auto` picks: by figures measured on this machine where there are any, else by the shipped ones.

`nnpp-edge profile --save-choice` writes the file, `choice_path` says where. It is read once in a process.
"""

import functools
import json
import math
import os
import warnings
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.query import Query
from nnpp_edge.runtime.reading import parse, read_text, reason
from nnpp_edge.runtime.tuning import FAR, FAR_FOR_BODY, LARGE_MAP, LARGE_MAP_FOR_BODY, NEAR

FORMAT = "nnpp-edge-choice-1"
VARIABLE = "NNPP_EDGE_CHOICE"
_MEASURED = "edge"
"""The network that they were measured with."""


@dataclass(frozen=True)
class MapChoice:
    """What to pick on maps of one size, by the cells between start and goal."""

    starts: tuple[int, ...]
    """Rising, from 0."""
    picks: tuple[tuple[Method, str], ...]
    """Method and reason from each start on."""

    def pick(self, apart: int) -> tuple[Method, str]:
        """Method and reason for a goal `apart` cells away, as the king moves."""
        return self.picks[bisect_right(self.starts, apart) - 1]


SHIPPED = MapChoice(
    (0, NEAR),
    (
        (Method.ASTAR, f"the goal is less than {NEAR} cells away"),
        (
            Method.CORRIDOR,
            "by the shipped figures about as fast as the learned region, and closer to optimal",
        ),
    ),
)
SHIPPED_FOR_LARGE = MapChoice(
    (*SHIPPED.starts, FAR),
    (*SHIPPED.picks, (Method.NNPP, f"by the shipped figures the fastest from {FAR} cells on a large map")),
)


SHIPPED_FOR_BODY = MapChoice(
    SHIPPED.starts,
    (
        SHIPPED.picks[0],
        (
            Method.CORRIDOR,
            "by the shipped figures running the network takes as long as the checks that it saves",
        ),
    ),
)
SHIPPED_FOR_BODY_ON_LARGE = MapChoice(
    (*SHIPPED.starts, FAR_FOR_BODY),
    (
        *SHIPPED_FOR_BODY.picks,
        (Method.NNPP, f"by the shipped figures the fastest for a body from {FAR_FOR_BODY} cells on a large map"),
    ),
)
"""For a vehicle with a body, by the prices of the passage network."""


@dataclass(frozen=True)
class Rule:
    """From so many cells between start and goal on, on maps about so large, this method is soonest done."""

    size: int
    start: int
    method: Method


@dataclass(frozen=True)
class Choice:
    """Rules measured on a machine."""

    measured: str
    """Date."""
    machine: str
    model: str
    """Name of the network that ``nnpp`` was measured with."""
    rules: tuple[Rule, ...]
    """By size, then by distance; the first of each size starts at 0."""

    def for_map(self, shape: tuple[int, int], model: str) -> MapChoice:
        """The rules of the size nearest to the map's longer side, by ratio.

        Where another network than the measured one would run, ``corridor`` takes the place of ``nnpp``.
        """
        side = max(*shape, 1)
        size = min({rule.size for rule in self.rules}, key=lambda each: abs(math.log(each / side)))
        picks = []
        rules = [rule for rule in self.rules if rule.size == size]
        for rule in rules:
            method, other = rule.method, ""
            if method is Method.NNPP and model != self.model:
                method, other = Method.CORRIDOR, f", but with the network {self.model}"
            measured = f"measured on this machine {self.measured}"
            picks.append((method, f"{measured}: {rule.method} soonest from {rule.start} cells at {size}²{other}"))
        return MapChoice(tuple(rule.start for rule in rules), tuple(picks))

    def to_json(self) -> str:
        """The file's content."""
        told = {"format": FORMAT, "measured": self.measured, "machine": self.machine, "model": self.model}
        lines = [{"size": rule.size, "from": rule.start, "method": str(rule.method)} for rule in self.rules]
        return json.dumps(told | {"rules": lines}, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> "Choice":
        """Read and check; ValueError says what was wanted."""
        stored = parse(text)
        if not isinstance(stored, dict) or stored.get("format") != FORMAT:
            raise ValueError(f"wanted the format {FORMAT}")
        try:
            rules = [
                Rule(_count(line["size"], 1), _count(line["from"], 0), _method(line["method"]))
                for line in stored["rules"]
            ]
            measured, machine, model = (str(stored[key]) for key in ("measured", "machine", "model"))
        except (KeyError, TypeError) as error:
            raise ValueError(f"wanted rules with size, from and method, got {error}") from error
        rules.sort(key=lambda rule: (rule.size, rule.start))
        by_size = {size: [rule.start for rule in rules if rule.size == size] for size in {r.size for r in rules}}
        if not rules or any(starts[0] or len(set(starts)) < len(starts) for starts in by_size.values()):
            raise ValueError("wanted rules for each size that start at 0, each at another distance")
        return cls(measured, machine, model, tuple(rules))


def choice_path() -> Path | None:
    """Where this user's figures are kept; None where NNPP_EDGE_CHOICE is set to nothing, or there is no home.

    NNPP_EDGE_CHOICE if set, else nnpp-edge/choice.json in XDG_CONFIG_HOME or ~/.config.
    """
    if (named := os.environ.get(VARIABLE)) is not None:
        return Path(named) if named else None
    if base := os.environ.get("XDG_CONFIG_HOME"):
        return Path(base) / "nnpp-edge" / "choice.json"
    home = os.environ.get("HOME")
    return Path(home) / ".config" / "nnpp-edge" / "choice.json" if home else None


class MethodChooser:
    """Picks methods on maps of one shape.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the map.
    model : str, Path or NetworkModel
        The network that ``nnpp`` would use.
    has_body : bool
        Whether it is a vehicle's poses that are searched.
    """

    def __init__(self, shape: tuple[int, int], model: str | Path | NetworkModel, has_body: bool = False) -> None:
        self._shape, self._model, self._has_body = shape, model, has_body

    def choose(self, method: str, query: Query) -> tuple[Method, str]:
        """The method of that name, for ``auto`` the one to pick and why; InvalidQueryError for another name."""
        try:
            wanted = Method(method)
        except ValueError:
            raise InvalidQueryError(f"method must be one of {', '.join(Method)}, got {method!r}") from None
        return (wanted, "") if wanted is not Method.AUTO else self._choice.pick(query.apart)

    @functools.cached_property
    def _choice(self) -> MapChoice:
        return choice_for_body(self._shape) if self._has_body else choice_for(self._shape, self._model)


def expects_network(method: str, shape: tuple[int, ...], model: str | Path | NetworkModel, apart: int) -> bool:
    """Whether a plan by `method` to a goal `apart` cells away is expected to ask the network.

    `shape` is the map's; for one that is no map ``auto`` is not expected to.
    """
    if apart < NEAR:
        return False
    if method == Method.AUTO and len(shape) == 2:
        method, _ = choice_for((shape[0], shape[1]), model).pick(apart)
    return method == Method.NNPP


def choice_for(shape: tuple[int, int], model: str | Path | NetworkModel) -> MapChoice:
    """What ``auto`` picks on a map of this shape with this model."""
    saved, name = saved_choice(choice_path()), Path(model.path if isinstance(model, NetworkModel) else model).stem
    if saved is not None:
        return saved.for_map(shape, name)
    return SHIPPED_FOR_LARGE if max(shape) >= LARGE_MAP and name == _MEASURED else SHIPPED


def choice_for_body(shape: tuple[int, int]) -> MapChoice:
    """What ``auto`` picks on a map of this shape for a vehicle with a body: nobody's own figures are of such."""
    return SHIPPED_FOR_BODY_ON_LARGE if max(shape) >= LARGE_MAP_FOR_BODY else SHIPPED_FOR_BODY


@functools.lru_cache(maxsize=8)
def saved_choice(path: Path | None) -> Choice | None:
    """What the file says; None where there is none, or where it cannot be used, which is warned of once."""
    try:
        return None if path is None else Choice.from_json(read_text(path))
    except FileNotFoundError:
        if VARIABLE not in os.environ:
            return None
        problem = "there is no such file"
    except (OSError, ValueError) as error:
        problem = reason(error)
    warnings.warn(f"{path}: cannot be used, auto goes by the shipped figures ({problem})", stacklevel=8)
    return None


def _count(value: object, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise TypeError(f"{value!r}, no whole number of at least {least}")
    return value


def _method(value: object) -> Method:
    if not isinstance(value, str) or value not in tuple(Method) or value == Method.AUTO:
        raise TypeError(f"{value!r}, no method")
    return Method(value)
