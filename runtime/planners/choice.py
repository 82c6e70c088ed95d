"""Which method ``auto`` picks, by figures of docs/decisions.md: on a standing map, and on one that changes."""

from pathlib import Path

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.query import Query
from nnpp_edge.runtime.tuning import FAR, LARGE_MAP, NEAR

_MEASURED = "edge"
"""The network that the figures are of."""


class MethodChooser:
    """Picks methods on maps of one shape, for a network that ``nnpp`` would use, and for a vehicle's body or not."""

    def __init__(self, shape: tuple[int, int], model: str | Path | NetworkModel, has_body: bool = False) -> None:
        self._shape, self._model, self._has_body = shape, model, has_body

    def choose(self, method: str, query: Query) -> tuple[Method, str]:
        """The method of that name, for ``auto`` the one to pick and why; InvalidQueryError for another name."""
        try:
            wanted = Method(method)
        except ValueError:
            raise InvalidQueryError(f"method must be one of {', '.join(Method)}, got {method!r}") from None
        if wanted is Method.NNPP and self._has_body:
            return wanted, "no network is asked for a vehicle's body: the corridor is as fast, closer to optimal"
        return (wanted, "") if wanted is not Method.AUTO else self.pick(query.apart)

    def pick(self, apart: int) -> tuple[Method, str]:
        """Method and reason for a goal `apart` cells away, as the king moves."""
        if apart < NEAR:
            return Method.ASTAR, f"the goal is less than {NEAR} cells away"
        if self._has_body:
            return Method.CORRIDOR, "for a body as fast as exact search on small maps, faster on large ones"
        model = self._model.path if isinstance(self._model, NetworkModel) else self._model
        if max(self._shape) >= LARGE_MAP and apart >= FAR and Path(model).stem == _MEASURED:
            return Method.NNPP, f"the fastest from {FAR} cells on, on a large map"
        return Method.CORRIDOR, "as fast as the learned region, closer to optimal"


def expects_network(method: str, shape: tuple[int, ...], model: str | Path | NetworkModel, apart: int) -> bool:
    """Whether a plan by `method` to a goal `apart` cells away is expected to ask the network.

    `shape` is the map's; for one that is no map ``auto`` is not expected to.
    """
    if apart < NEAR:
        return False
    if method == Method.AUTO and len(shape) == 2:
        method, _ = MethodChooser((shape[0], shape[1]), model).pick(apart)
    return method == Method.NNPP
