import pytest

from nnpp_edge.runtime.planners.choice import MethodChooser


@pytest.mark.parametrize(
    ("shape", "model", "has_body", "methods"),
    [
        ((256, 256), "edge", False, "astar corridor corridor corridor"),
        ((300, 2048), "edge", False, "astar corridor corridor nnpp"),
        ((2048, 2048), "edge-joint", False, "astar corridor corridor corridor"),
        ((512, 512), "edge", True, "astar corridor corridor corridor"),
        ((300, 2048), "edge", True, "astar corridor corridor corridor"),
    ],
)
def test_auto_goes_by_distance_size_network_and_body(shape, model, has_body, methods):
    chooser = MethodChooser(shape, model, has_body)
    picked = [chooser.pick(apart) for apart in (47, 48, 511, 512)]
    assert [str(method) for method, _ in picked] == methods.split()
    assert all(reason for _, reason in picked)
