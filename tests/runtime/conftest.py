"""A small network, loaded once."""

import pytest

from nnpp_edge.runtime import NetworkModel


@pytest.fixture(scope="session")
def network(tiny_model):
    """A small network, loaded once."""
    return NetworkModel(tiny_model)
