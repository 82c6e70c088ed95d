"""The report of `nnpp-edge profile` and the comparison of two, key by key. Meanings are in docs/profile.md."""

from typing import TypedDict


class Spread(TypedDict):
    """Of times in milliseconds."""

    median: float
    p90: float
    p99: float
    max: float
    mean: float


class QueryFacts(TypedDict):
    """A value for each query."""

    time_ms: list[float]
    distance: list[int]
    judged: list[bool]


class ResultRow(TypedDict):
    """One planner at one workload and size."""

    workload: str
    size: int
    terrain: str
    planner: str
    n: int
    time_ms: Spread
    worst_call_ms: float
    fps: float
    stages_ms: dict[str, Spread]
    stages_share: dict[str, float]
    speedup_median: float
    speedup_total: float
    gap_mean: float | None
    gap_p99: float | None
    gap_max: float | None
    cc_excess: float | None
    success_first: float
    success: float
    expansions_median: float
    energy_mj: float | None
    inference_ms_median: float | None
    inference_fps: float | None
    int8_speedup: float | None
    map_ms: Spread | None
    patch_ms: Spread | None
    halves: dict[str, list[float]]
    queries: QueryFacts


class LoopRow(TypedDict):
    """The onboard loop at one workload and size, with a patch of elevations at each tick."""

    workload: str
    size: int
    method: str
    rate_hz: float
    patch_side: int
    n: int
    reaction_ms: Spread
    planned: int
    kept: int
    without_path: int
    halves: dict[str, list[float]]


class BudgetLine(TypedDict):
    """One budget at one workload and size."""

    name: str
    quantity: str
    planner: str
    workload: str | None
    size: int | None
    direction: str
    limit: float
    unit: str
    value: float | None
    halves: list[float] | None
    halves_unit: str | None
    halves_differ: float | None
    verdict: str
    why: str


class BreakEven(TypedDict):
    """Where one planner starts to pay over another."""

    planner: str
    over: str
    size_from: int | None
    distance_from: dict[str, int | None]


class HalfFacts(TypedDict):
    """Time of others in one half of the run."""

    waited_share: float
    others_share: float | None
    stolen_share: float | None
    measured_s: float


class DisturbanceFacts(TypedDict):
    """Time of others."""

    words: str
    halves: list[HalfFacts]


class SensorFacts(TypedDict):
    """Clocks and temperatures, as the kernel told, while planners ran; empty tables where it tells nothing."""

    readings: int
    throttled: str
    clock_mhz: dict[str, dict[str, float | None]]
    temperature_c: dict[str, dict[str, float | None]]


class LoadedRow(TypedDict):
    """Times of one planner, or the loop, alone and beside what `contention` ran."""

    workload: str
    size: int
    planner: str
    idle_ms: Spread
    loaded_ms: Spread
    factor: float


class ContentionFacts(TypedDict):
    """A second run of the work, with something beside it."""

    beside: str
    rows: list[LoadedRow]
    halves: list[HalfFacts]


class MachineFacts(TypedDict):
    """The machine of a run; None for what Linux hides."""

    cpu: str
    architecture: str
    flags: list[str]
    cores_online: int | None
    clock_mhz: float | None
    governor: list[str] | None
    memory_mb: int | None
    kernel: str
    system: str | None
    python: str
    packages: dict[str, str | None]
    load_average: list[float]


WholeRun = dict[str, dict[str, float]]
"""By quantity and planner, what there is one figure of for the run."""


class Report(TypedDict):
    """The whole report."""

    schema: int
    version: str
    made: str
    profile: dict[str, object]
    verdict: str
    summary: str
    budgets: list[BudgetLine]
    results: list[ResultRow]
    loop: list[LoopRow]
    break_even: list[BreakEven]
    disturbance: DisturbanceFacts
    contention: ContentionFacts | None
    sensors: SensorFacts
    besides: WholeRun
    profiler_peak_memory_mb: float
    energy_problem: str | None
    cores: list[int]
    environment: MachineFacts
    notes: list[str]


class ComparedLine(TypedDict):
    """One figure in two reports."""

    workload: str
    size: int
    planner: str
    figure: str
    before: float
    after: float
    change: float | None
    verdict: str


class Comparison(TypedDict):
    """Two reports beside each other."""

    verdict: str
    tolerance: float
    notes: list[str]
    lines: list[ComparedLine]


def find(results: list[ResultRow], workload: str, size: int, planner: str) -> ResultRow | None:
    """The row of a planner."""
    for row in results:
        if (row["workload"], row["size"], row["planner"]) == (workload, size, planner):
            return row
    return None
