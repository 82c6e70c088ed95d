"""Profiles: what is read from a file, and which values are refused with which words."""

import pytest

from nnpp_edge.profiling.profile_file import SHIPPED, ProfileError, overridden, read_profile
from nnpp_edge.runtime.errors import InvalidQueryError
from tests.tables import cases

GOOD = """
planner = "corridor"
budgets = [
  { name = "fast", quantity = "fps", limit = 10, direction = "at least", unit = "1/s" },
  { name = "gap", quantity = "gap_mean", limit = 1, direction = "at most", unit = "%", planner = "nnpp", size = 128 },
]
[device]
cores = [0, 1]
threads = 1
[workload]
sizes = [64, 128]
workloads = ["soft"]
"""


BAD = r"""
planner = "corridor" | planner = "dijkstra" | planner: wanted one of astar, | 'dijkstra'
planner = "corridor" | plan = 1 | field plan: wanted one of title, planner, | workload, model
[device] | [devices] | unknown field devices
threads = 1 | thread = 1 | device: | unknown field thread: wanted one of cores, threads
threads = 1 | threads = 0 | device.threads | int >= 1 | got 0
cores = [0, 1] | cores = [0, 0] | device.cores | different
cores = [0, 1] | cores = [-1] | device.cores
cores = [0, 1] | cores = [] | device.cores
sizes = [64, 128] | sizes = [4, 128] | workload.sizes[0] | int >= 16 | got 4
["soft"] | ["hard"] | workload.workloads | 'hard'
["soft"] | ["body"] | workload.vehicle: wanted a vehicle for the workload body
["soft"] | ["body-rocks30"] | workload.workloads | 0 to 20 percent | 'body-rocks30'
workloads = ["soft"] | vehicle = "tracked" | workload.vehicle: wanted none without
workloads = ["soft"] | queries = 0 | workload.queries | int >= 1
workloads = ["soft"] | rescale = -1.0 | workload.rescale | -1.0
workloads = ["soft"] | rescale = nan | workload.rescale
workloads = ["soft"] | min_distance = 1.5 | workload.min_distance
workloads = ["soft"] | terrain = ["synthetic", "a.tif"] | workload.terrain
name = "fast", |  | budgets[0] | missing required field name
"fps" | "frames" | budgets[0].quantity | 'frames' | speedup_total
"1/s" | "ms" | budgets[0].unit | '1/s' | 'ms'
"at least" | "over" | budgets[0].direction | 'over'
limit = 10, | limit = inf, | budgets[0].limit
size = 128 } | size = 256 } | budgets[1].size | 64, 128 | 256
size = 128 } | workload = "limit20" } | budgets[1].workload | 'limit20'
size = 128 } | colour = 1 } | budgets[1]: | field colour: wanted one of name, quantity, limit
planner = "nnpp", size | planner = "nnpp-fp32", size | budgets[1].planner
"gap_mean", limit = 1, direction = "at most", unit = "%" | "reaction_ms", limit = 3.0, direction = "at most", unit = "ms" | budgets[1].planner | loop | 'nnpp'
"1/s" }, | "1/s", planner = "loop" }, | budgets[0].planner | 'loop'
budgets = [ | budgets = ["all", | budgets[0] | 'all'
budgets = [ | budgets = [[ | mine.toml
[device] | [loop]\nrate_hz = 0\n[device] | loop.rate_hz: Expected float >= 0.001, got 0
[device] | [loop]\nmethod = 'magic'\n[device] | loop.method: wanted one of auto
[device] | [loop]\nrefine = 'x'\n[device] | loop.refine: wanted 'any-angle' or '', got 'x'
[device] | [loop]\npriority = 100\n[device] | loop.priority
[device] | [loop]\ntolerance = -0.1\n[device] | loop.tolerance
[device] | [loop]\ncorner_cutting = 1\n[device] | loop.corner_cutting: Expected bool, got 1
[device] | [loop]\nspeed = 1\n[device] | loop: Object contains unknown field speed
"""
"""What takes whose place in `GOOD`, and words of the refusal."""


def test_what_is_shipped_can_be_read_and_has_budgets():
    names = [path.stem for path in SHIPPED.glob("*.toml")]
    assert len(names) == 5
    for name in names:
        profile = read_profile(name)
        assert profile.name == name and profile.budgets and profile.title != name


def test_a_profile_says_what_stands_in_it(write_toml):
    profile = read_profile(write_toml(GOOD))
    assert (profile.name, profile.planner) == ("mine", "corridor")
    assert (profile.device.cores, profile.device.threads) == ((0, 1), 1)
    assert profile.load.sizes == (64, 128)
    assert (profile.load.workloads, profile.load.terrain) == (("soft",), ("sample",))
    fast, gap = profile.budgets
    assert (fast.planner, fast.size, fast.limit) == ("corridor", None, 10.0)
    assert (gap.planner, gap.size, gap.direction) == ("nnpp", 128, "at most")


@pytest.mark.parametrize(("old", "new", "words"), cases(BAD, 3))
def test_a_bad_profile_is_refused_with_the_key(write_toml, old, new, words):
    assert old in GOOD
    with pytest.raises(ProfileError) as refused:
        read_profile(write_toml(GOOD.replace(old, new, 1)))
    told = str(refused.value)
    assert "\n" not in told
    assert [word for word in ["mine.toml", *words.split(" | ")] if word not in told] == []


def test_a_vehicle_has_workloads_beside_a_points(write_toml):
    text = GOOD.replace(
        'workloads = ["soft"]',
        'workloads = ["body-rocks5", "soft", "body"]\nvehicle = "tracked"',
    )
    profile = read_profile(write_toml(text))
    assert profile.load.workloads == ("body-rocks5", "soft", "body")
    other, _ = overridden(profile, vehicle="a/folder/own.toml")
    assert (profile.load.vehicle, other.load.vehicle) == ("tracked", "a/folder/own.toml")
    assert other.facts()["load"]["vehicle"] == "own.toml"
    with pytest.raises(InvalidQueryError, match="vehicle: wanted none without"):
        overridden(read_profile(write_toml(GOOD)), vehicle="tracked")


def test_the_loop_is_run_where_a_budget_asks_for_its_reactions(write_toml):
    assert read_profile(write_toml(GOOD)).measured_at("reaction") == frozenset()
    assert read_profile(write_toml(GOOD)).arriving == {"corridor"}
    budgets = """budgets = [
  { name = "react", quantity = "reaction_ms", limit = 3, direction = "at most", unit = "ms", size = 64 },
  { name = "map", quantity = "map_ms_p99", limit = 3, direction = "at most", unit = "ms", planner = "nnpp" },
  { name = "fresh", quantity = "speedup_map", limit = 3, direction = "at least", unit = "x" },
"""
    profile = read_profile(write_toml(GOOD.replace("budgets = [\n", budgets)))
    assert profile.budgets[0].planner == "loop"
    assert profile.measured_at("reaction") == {("soft", 64)} and profile.arriving == {
        "astar",
        "corridor",
        "nnpp",
    }


def test_another_load_leaves_out_budgets_of_sizes_that_are_gone(write_toml):
    profile, notes = overridden(read_profile(write_toml(GOOD)), sizes=(64,), queries=None, seed=4)
    assert notes[0].endswith(": gap") and [budget.name for budget in profile.budgets] == ["fast"]
    assert (profile.load.sizes, profile.load.seed, profile.load.queries) == ((64,), 4, 60)
    with pytest.raises(InvalidQueryError, match="sizes"):
        overridden(profile, sizes=(64, 64))
