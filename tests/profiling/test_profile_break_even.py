import pytest

from nnpp_edge.profiling.break_even import bins_by_size, break_even

DISTANCES = [5, 6, 7, 8, 20, 21, 22, 23, 60, 61, 62, 63, 200, 201, 202]


def results(times, sizes=(256,)):
    """A row for each planner, whose time is a function of size and distance; queries from 60 cells on count."""
    told = []
    for size in sizes:
        for name, time in times.items():
            ms = [time(size, distance) for distance in DISTANCES]
            judged = [distance >= 60 for distance in DISTANCES]
            mean = sum(t for t, counts in zip(ms, judged, strict=True) if counts) / sum(judged)
            queries = {"time_ms": ms, "distance": DISTANCES, "judged": judged}
            told.append(
                {"size": size, "planner": name, "n": sum(judged), "time_ms": {"mean": mean}, "queries": queries}
            )
    return told


TIMES = {
    "astar": lambda size, distance: 0.01 * distance * size / 256,
    "corridor": lambda size, distance: 0.3 + 0.001 * distance,
    "nnpp": lambda size, distance: 2.0,
}


def test_bins_hold_every_query_once():
    (bins,) = bins_by_size(results(TIMES)).values()
    assert sum(len(each.times_ms["astar"]) for each in bins) == len(DISTANCES)
    assert bins[0].first == 0 and all(len(each.times_ms["astar"]) >= 3 for each in bins)
    assert [each.first for each in bins] == sorted(each.first for each in bins)


def test_where_each_planner_starts_to_pay():
    found = {(line["planner"], line["over"]): line for line in break_even(results(TIMES, (128, 256, 2048)))}
    corridor = found["corridor", "astar"]
    # astar passes the corridor at 33 cells at 256²: between the queries of 20 and of 60 cells
    assert 20 < corridor["distance_from"]["256"] <= 60
    assert corridor["distance_from"]["2048"] == 0  # 5 cells take astar 0.4 ms there
    assert corridor["size_from"] == 128
    assert found["nnpp", "astar"]["distance_from"]["128"] is None
    assert found["nnpp", "astar"]["size_from"] == 2048
    assert found["nnpp", "corridor"] == {
        "planner": "nnpp",
        "over": "corridor",
        "size_from": None,
        "distance_from": {"128": None, "256": None, "2048": None},
    }


def test_a_win_that_is_lost_again_does_not_count():
    times = TIMES | {"corridor": lambda size, distance: 0.01 if distance < 10 else 99.0}
    found = {(line["planner"], line["over"]): line for line in break_even(results(times))}
    assert found["corridor", "astar"]["distance_from"] == {"256": None}


@pytest.mark.parametrize("times", [{"astar": TIMES["astar"]}, {"astar": TIMES["astar"], "auto": TIMES["astar"]}])
def test_planners_that_were_not_measured_are_left_out(times):
    assert break_even(results(times)) == []
