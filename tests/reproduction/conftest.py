"""The tiny network in both of its roles."""

import pytest

from nnpp_edge.reproduction.regions import NetworkPair
from nnpp_edge.runtime import NetworkModel


@pytest.fixture(scope="session")
def tiny_networks(tiny_model):
    """The tiny network in both roles."""
    model = NetworkModel(tiny_model)
    return NetworkPair(model, model)
