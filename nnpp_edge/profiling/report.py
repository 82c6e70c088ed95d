"""A profile's report: the run, what it cost besides time, budgets and verdict. Keys as in docs/profile.md."""

import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from nnpp_edge import __version__
from nnpp_edge.profiling import break_even
from nnpp_edge.profiling.cold_start import cold_start
from nnpp_edge.profiling.contention import running
from nnpp_edge.profiling.disturbance import Disturbance, Instruments
from nnpp_edge.profiling.figures import loaded_rows, loop_rows, rows
from nnpp_edge.profiling.judge import ABSENT, FAIL, MET, MISSED, NOISY, THROTTLED, Noise, judged, verdict
from nnpp_edge.profiling.machine import busy_share, environment, pinned
from nnpp_edge.profiling.measure import Arriving, Run, queries_in, rivals_of, run
from nnpp_edge.profiling.memory import peak_memory_mb
from nnpp_edge.profiling.profile_file import SYNTHETIC, Networks, Profile
from nnpp_edge.profiling.profile_maps import ProfileMaps
from nnpp_edge.profiling.report_format import (
    BudgetLine,
    ContentionFacts,
    DisturbanceFacts,
    HalfFacts,
    Report,
    WholeRun,
)
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.sensors import KernelSensors, SensorLog, sensor_facts, throttling
from nnpp_edge.profiling.trace import Trace
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.terrain.workloads import body_rocks

SCHEMA = 1
_START_UP = ("astar", "corridor", "nnpp", "auto")
_PLACES = 2
"""A budget that is missed in more places is named with their number."""
_HALF_NAMES = ("first", "second")


@dataclass(frozen=True)
class Watchers:
    """Called while the run goes on."""

    progress: Callable[[int], None] = lambda done: None
    """With the number of queries that are done."""
    say: Callable[[str], None] = lambda line: None
    """With a line for people, at once."""
    trace: Trace | None = None
    """Is given every call, tick and reading."""


def profile_machine(
    profile: Profile, *, start_up: bool = False, notes: Sequence[str] = (), watchers: Watchers | None = None
) -> Report:
    """Pin, warm up, measure, judge: the report that docs/profile.md describes, ready for JSON.

    `start_up` also measures the time from import to first plan, which takes a minute; without it that is done only
    where a budget asks for it. `notes` are put before the report's own. NnppEdgeError if a terrain or model file
    cannot be used, or the terrain has too few queries with a path.
    """
    watchers = watchers or Watchers()
    said = list(notes)
    profile.contention.check()
    with pinned(profile.device.cores) as (cores, problems):
        if (busy := busy_share(cores)) is not None and busy > profile.stability.disturbance:
            problems.append(f"others use {100 * busy:.0f} % of the cores' time before the run begins")
        for line in problems:
            said.append(line)
            watchers.say(line)
        rivals = rivals_of(profile.networks, profile.device)
        arriving = Arriving(profile.arriving, profile.reactions_at, profile.loop)
        sensors = SensorLog(KernelSensors(cores))
        instruments = Instruments(sensors, watchers.trace)
        measured = run(
            rivals, profile.load, cores, arriving=arriving, instruments=instruments, progress=watchers.progress
        )
        contention = _contention(profile, rivals, cores, arriving, measured, watchers, said)
        own_peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1.024e-3
        whole_run = _whole_run(profile, rivals, start_up, watchers.say)
    results, loop = rows(measured), loop_rows(measured)
    if profile.load.terrain != (SYNTHETIC,):
        made = {row["size"] for row in results if row["terrain"] == SYNTHETIC}
        said += [f"no terrain has {size} × {size} cells: synthetic ground in its place" for size in sorted(made)]
    slowed = throttling(sensors.readings, sensors.sensors.limits)
    noise = replace(_noise(measured.disturbance, profile.stability.disturbance), throttling=slowed)
    if watchers.trace is not None:
        watchers.trace.sensors(sensors.readings)
    lines = judged(profile, results, whole_run, noise, loop)
    of_points = [row for row in results if body_rocks(row["workload"]) is None]
    ending = verdict(lines, noise)
    return Report(
        schema=SCHEMA,
        version=__version__,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        profile=profile.facts(),
        verdict=ending,
        summary=summary(ending, lines, noise.words),
        budgets=lines,
        results=results,
        loop=loop,
        break_even=break_even.break_even(of_points or results),
        disturbance=DisturbanceFacts(words=noise.words, halves=_halves(measured)),
        contention=contention,
        sensors=sensor_facts(sensors),
        besides=whole_run,
        profiler_peak_memory_mb=own_peak_mb,
        energy_problem=measured.energy_problem or None,
        cores=cores,
        environment=environment(cores),
        notes=said,
    )


def summary(ending: str, lines: Sequence[BudgetLine], noise: str) -> str:
    """One line: the verdict, and the budgets that are to blame for it."""
    if not lines:
        return f"no budgets; the run was disturbed: {noise}" if noise else "no budgets"
    blame = {MISSED: (FAIL,), MET: (), THROTTLED: (THROTTLED,)}.get(ending, (NOISY, ABSENT))
    names = []
    for name in dict.fromkeys(line["name"] for line in lines):
        places = [_place(line) for line in lines if line["name"] == name and line["verdict"] in blame]
        if places:
            many = f"{len(places)} times" if len(places) > _PLACES else ", ".join(filter(None, places))
            names.append(f"{name} ({many})" if many else name)
    passed = sum(line["verdict"] == "pass" for line in lines)
    heads = {MET: "all budgets met", MISSED: "budgets missed", THROTTLED: "throttled"}
    head = heads.get(ending, "too noisy to tell")
    return f"{head}: {passed} of {len(lines)} pass" + (f"; not {', '.join(names)}" if names else "")


def _place(line: BudgetLine) -> str:
    return "" if line["size"] is None else f"{line['workload']} {line['size']}²"


def _whole_run(
    profile: Profile, rivals: Sequence[RivalPlanner], start_up: bool, say: Callable[[str], None]
) -> WholeRun:
    """Figures of the whole run, by quantity and planner."""
    say("peak memory, in processes of their own")
    found = {"model_mb": _model_mb(profile.networks), "peak_memory_mb": _peak_memory_mb(profile, rivals)}
    wanted = [budget.planner for budget in profile.budgets if budget.quantity.startswith("start_up")]
    names = [name for name in _START_UP if start_up or name in wanted]
    if names:
        say("start-up, in new processes")
        measured = {name: cold_start(name) for name in names}
        found["start_up_cold_s"] = {name: start.cold_s for name, start in measured.items()}
        found["start_up_warm_s"] = {name: start.warm_s for name, start in measured.items()}
    return found


def _peak_memory_mb(profile: Profile, rivals: Sequence[RivalPlanner]) -> dict[str, float]:
    """By planner, on a map of the greatest size whose first query has a path."""
    for on_map in ProfileMaps(profile.load).maps(profile.load.workloads[0], max(profile.load.sizes)):
        query = on_map.queries[0]
        if on_map.connections()(query):
            break
    found = {}
    for rival in rivals:
        model = rival.model.path if rival.model is not None else model_path(profile.networks.int8)
        if (peak := peak_memory_mb(on_map, query, rival.method, str(model))) is not None:
            found[rival.name] = peak
    return found


def _model_mb(networks: Networks) -> dict[str, float]:
    named = {"nnpp": networks.int8, "nnpp-fp32": networks.fp32, "auto": networks.int8}
    return {name: 1e-6 * model_path(model).stat().st_size for name, model in named.items() if model is not None}


def _contention(
    profile: Profile,
    rivals: Sequence[RivalPlanner],
    cores: Sequence[int],
    arriving: Arriving,
    idle: Run,
    watchers: Watchers,
    said: list[str],
) -> ContentionFacts | None:
    """A second run beside what the profile names, if it names anything."""
    if not profile.contention.wanted:
        return None
    watchers.say(f"once more, beside {profile.contention.words}")
    done = queries_in(profile.load)
    with running(profile.contention, cores) as ended_early:
        loaded = run(
            rivals, profile.load, cores, arriving=arriving, progress=lambda more: watchers.progress(done + more)
        )
        said += ended_early()
    return ContentionFacts(beside=profile.contention.words, rows=loaded_rows(idle, loaded), halves=_halves(loaded))


def _halves(measured: Run) -> list[HalfFacts]:
    return [
        HalfFacts(
            waited_share=half.waited_share(),
            others_share=half.cores.others_share(),
            stolen_share=half.cores.stolen_share(),
            measured_s=half.cores.elapsed,
        )
        for half in measured.disturbance
    ]


def _noise(halves: Sequence[Disturbance], allowed: float) -> Noise:
    """Time of others in the half in which they took most, in words; no words where that is allowed."""
    at, worst = max(enumerate(halves), key=lambda half: half[1].share())
    if worst.share() <= allowed:
        return Noise("", worst.share())
    others = worst.cores.others_share()
    signs = []
    if others is not None and others > allowed:
        signs.append(f"others took {100 * others:.0f} % of the cores' time")
    if worst.waited_share() > allowed:
        signs.append(f"the planners stood still for {100 * worst.waited_share():.0f} % of theirs")
    return Noise(f"{' and '.join(signs)} in the {_HALF_NAMES[at]} half of the run", worst.share())
