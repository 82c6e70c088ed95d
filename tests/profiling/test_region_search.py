from nnpp_edge.benchmarks.region_search import by_map_size, per_expansion


def test_a_regions_search_is_timed_beside_the_whole_maps_and_on_a_larger_map():
    each = per_expansion(64, maps=1, rounds=1)
    assert each["ratio"] == each["region_ns"] / each["whole_map_ns"]
    assert by_map_size(64, 128, maps=1, rounds=1)["ratio"] > 0.0
