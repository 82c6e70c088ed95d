"""A profile's report: the run, its costs other than time, budgets and verdict. Keys as in
docs/reference/figures.md.
"""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from nnpp_edge import __version__
from nnpp_edge.profiling.figures import loop_rows, results
from nnpp_edge.profiling.judge import WholeRun, judged, noise_of, summary, verdict
from nnpp_edge.profiling.machine import environment, pinned
from nnpp_edge.profiling.measure import maps_of, rivals_of, run
from nnpp_edge.profiling.processes import first_tick_s, peak_memory_mb, start_up_s
from nnpp_edge.profiling.profile_file import LOOP, SYNTHETIC, Profile
from nnpp_edge.profiling.quantities import STARTS
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.rows import Facts
from nnpp_edge.profiling.suites import solvable
from nnpp_edge.progress import Progress, ignore

SCHEMA = 1


def profile_machine(
    profile: Profile,
    *,
    notes: Sequence[str] = (),
    progress: Progress = ignore,
    say: Callable[[str], None] = ignore,
) -> Facts:
    """Pin, warm up, measure, judge: the report of docs/reference/figures.md, ready for JSON.

    New processes are measured up to their first plan, and the loop up to its first answer, where a
    budget asks for it. `notes` are put before the report's own. `progress` is called with the
    number of queries that are done, `say` with a line for people, at once. NnppEdgeError if a
    terrain or model file cannot be used, or the terrain has too few queries with a path.
    """
    said = list(notes)
    load = profile.load
    with pinned(profile.device.cores) as (cores, problems):
        said += problems
        for line in problems:
            say(line)
        rivals = rivals_of(profile.networks, profile.device)
        measured = run(profile, rivals, cores, progress)
        whole_run = _whole_run(profile, rivals, say)
    rows = results(measured.answers)
    loop = loop_rows(measured.reactions, profile.loop)
    if load.terrain != (SYNTHETIC,):
        made = {row["size"] for row in rows if row["terrain"] == SYNTHETIC}
        for size in sorted(made):
            said.append(f"no terrain has {size} × {size} cells: synthetic ground in its place")
    halves = [half.facts() for half in measured.disturbance]
    noise = noise_of(halves, measured.sensors.throttling())
    lines = judged(profile, rows, whole_run, noise, loop)
    ending = verdict(lines, noise)
    return {
        "schema": SCHEMA,
        "version": __version__,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "profile": profile.facts(),
        "verdict": ending,
        "summary": summary(ending, lines, noise.words),
        "budgets": lines,
        "results": rows,
        "loop": loop,
        "disturbance": {"words": noise.words, "halves": halves},
        "sensors": measured.sensors.facts(),
        "besides": whole_run,
        "cores": cores,
        "environment": environment(cores),
        "notes": said,
    }


def _whole_run(
    profile: Profile,
    rivals: Sequence[RivalPlanner],
    say: Callable[[str], None],
) -> WholeRun:
    """Figures of the whole run, by quantity and planner."""
    say("peak memory, in processes of their own")
    load = profile.load
    case = next(solvable(maps_of(load)(load.workloads[0], max(load.sizes)), 1))
    found: WholeRun = {"model_mb": {}, "peak_memory_mb": {}}
    methods = {rival.name: rival.method for rival in rivals}
    models = dict.fromkeys(methods, profile.networks.int8)
    for rival in rivals:
        if rival.model is not None:
            models[rival.name] = str(rival.model.path)
            found["model_mb"][rival.name] = 1e-6 * rival.model.path.stat().st_size
        peak = peak_memory_mb(case, rival.method, models[rival.name])
        if peak is not None:
            found["peak_memory_mb"][rival.name] = peak

    for budget in profile.budgets:
        planner = budget.planner
        if budget.quantity not in STARTS:
            continue
        say(f"the start of new processes, {planner}")
        if planner == LOOP:
            seconds = first_tick_s(profile.loop.method)
        else:
            seconds = start_up_s(methods[planner], models[planner])
        found.setdefault(budget.quantity, {})[planner] = seconds
    return found
