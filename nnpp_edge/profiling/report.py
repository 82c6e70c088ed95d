"""A profile's report: the run, what it cost besides time, budgets and verdict. Keys as in docs/profile.md."""

import resource
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from nnpp_edge import __version__
from nnpp_edge.profiling import break_even
from nnpp_edge.profiling.cold_start import cold_start
from nnpp_edge.profiling.figures import rows
from nnpp_edge.profiling.judge import ABSENT, FAIL, MET, MISSED, NOISY, Noise, judged, verdict
from nnpp_edge.profiling.machine import busy_share, environment, pinned
from nnpp_edge.profiling.measure import Contender, Disturbance, Run, contenders, run
from nnpp_edge.profiling.memory import peak_memory_mb
from nnpp_edge.profiling.profile_cases import Ground
from nnpp_edge.profiling.profile_file import Networks, Profile
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.planners.choice import Choice, Rule
from nnpp_edge.runtime.planners.plan import Method

SCHEMA = 1
_START_UP = ("astar", "corridor", "nnpp", "auto")
_PLACES = 2
"""A budget that is missed in more places is named with their number."""
_HALF_NAMES = ("first", "second")
Report = dict[str, Any]


@dataclass(frozen=True)
class Watchers:
    """Whom to tell how the run goes."""

    progress: Callable[[int], None] = lambda done: None
    """How many queries are done."""
    say: Callable[[str], None] = lambda line: None
    """A line for people, at once."""


def profile_machine(
    profile: Profile, *, start_up: bool = False, notes: Sequence[str] = (), watchers: Watchers | None = None
) -> Report:  # fmt: skip
    """Pin, warm up, measure, judge.

    Parameters
    ----------
    profile : Profile
        What is measured and what is wanted of it.
    start_up : bool
        Also measure the time from import to first plan, which takes a minute; without it that is done only
        where a budget asks for it.
    notes : sequence of str
        What the report should say besides.
    watchers : Watchers
        Told how it goes.

    Returns
    -------
    dict
        As docs/profile.md describes it, ready for JSON.

    Raises
    ------
    NnppEdgeError
        A terrain or model file cannot be used, or the terrain has too few queries with a path.
    """
    watchers = watchers or Watchers()
    said = list(notes)

    def note(line: str) -> None:
        said.append(line)
        watchers.say(line)

    with pinned(profile.device.cores) as (cores, problems):
        for line in problems:
            note(line)
        if (busy := busy_share(cores)) is not None and busy > profile.stability.disturbance:
            note(f"others use {100 * busy:.0f} % of the cores' time before the run begins")
        planners = contenders(profile.networks, profile.device)
        measured = run(planners, profile.load, cores, progress=watchers.progress)
        own_peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1.024e-3
        besides = _besides(profile, planners, start_up, watchers.say)
    results = rows(measured)
    noise = _noise(measured.disturbance, profile.stability.disturbance)
    lines = judged(profile, results, besides, noise)
    report: Report = {
        "schema": SCHEMA, "version": __version__, "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "profile": profile.facts(), "verdict": verdict(lines, noise), "summary": "", "budgets": lines,
        "results": results, "break_even": break_even.break_even(results), "rules": break_even.rules(results),
        "disturbance": _disturbance(measured, noise.words), "besides": besides,
        "profiler_peak_memory_mb": own_peak_mb, "energy_problem": measured.energy_problem or None,
        "cores": cores, "environment": environment(cores), "notes": said,
    }  # fmt: skip
    report["summary"] = summary(report)
    return report


def summary(report: Mapping[str, Any]) -> str:
    """One line: the verdict, and the budgets that are to blame for it."""
    lines = report["budgets"]
    if not lines:
        words = report["disturbance"]["words"]
        return f"no budgets; the run was disturbed: {words}" if words else "no budgets"
    blame = {MISSED: (FAIL,), MET: ()}.get(report["verdict"], (NOISY, ABSENT))
    names = []
    for name in dict.fromkeys(line["name"] for line in lines):
        places = [_place(line) for line in lines if line["name"] == name and line["verdict"] in blame]
        if places:
            many = f"{len(places)} times" if len(places) > _PLACES else ", ".join(filter(None, places))
            names.append(f"{name} ({many})" if many else name)
    passed = sum(line["verdict"] == "pass" for line in lines)
    head = {MET: "all budgets met", MISSED: "budgets missed"}.get(report["verdict"], "too noisy to tell")
    return f"{head}: {passed} of {len(lines)} pass" + (f"; not {', '.join(names)}" if names else "")


def _place(line: Mapping[str, Any]) -> str:
    return "" if line["size"] is None else f"{line['workload']} {line['size']}²"


def choice_of(report: Mapping[str, Any]) -> Choice:
    """What `auto` may go by from now on, from a report."""
    rules = tuple(Rule(line["size"], line["from"], Method(line["method"])) for line in report["rules"])
    model = Path(report["profile"]["networks"]["int8"]).stem
    return Choice(report["made"][:10], report["environment"]["cpu"], model, rules)


def _besides(
    profile: Profile, planners: Sequence[Contender], start_up: bool, say: Callable[[str], None]
) -> dict[str, dict[str, float]]:  # fmt: skip
    """What there is one figure of for the run, by quantity and planner."""
    say("peak memory, in processes of their own")
    found: dict[str, dict[str, float]] = {"model_mb": _model_mb(profile.networks), "peak_memory_mb": {}}
    size = max(profile.load.sizes)
    for sheet in Ground(profile.load).sheets(profile.load.workloads[0], size):
        question = sheet.questions[0]
        if not _has_path(sheet.cost, question):
            continue
        for p in planners:
            model = p.model.path if p.model is not None else model_path(profile.networks.int8)
            if (peak := peak_memory_mb(sheet.cost, question, p.method, str(model))) is not None:
                found["peak_memory_mb"][p.name] = peak
        break
    wanted = [budget.planner for budget in profile.budgets if budget.quantity.startswith("start_up")]
    names = [name for name in _START_UP if start_up or name in wanted]
    if names:
        say("start-up, in new processes")
        told = {name: cold_start(name) for name in names}
        for kind in ("cold", "warm"):
            found[f"start_up_{kind}_s"] = {name: each[f"{kind}_s"] for name, each in told.items()}
    return found


def _has_path(cost: Any, question: Any) -> bool:
    from nnpp_edge.runtime.planners.planner import Planner

    return Planner(cost).plan(question.start, question.goal, method=Method.CORRIDOR).ok


def _model_mb(networks: Networks) -> dict[str, float]:
    named = {"nnpp": networks.int8, "nnpp-fp32": networks.fp32, "auto": networks.int8}
    return {name: 1e-6 * model_path(model).stat().st_size for name, model in named.items() if model is not None}


def _disturbance(measured: Run, words: str) -> dict[str, Any]:
    return {
        "words": words,
        "halves": [
            {
                "waited_share": half.waited_share(), "others_share": half.cores.others_share(),
                "stolen_share": half.cores.stolen_share(), "measured_s": half.cores.elapsed,
            }
            for half in measured.disturbance
        ],
    }  # fmt: skip


def _noise(halves: Sequence[Disturbance], allowed: float) -> Noise:
    """What others took in the half in which they took most; no words where that is allowed."""
    at, worst = max(enumerate(halves), key=lambda half: half[1].share())
    if worst.share() <= allowed:
        return Noise("", worst.share())
    others = worst.cores.others_share()
    told = []
    if others is not None and others > allowed:
        told.append(f"others took {100 * others:.0f} % of the cores' time")
    if worst.waited_share() > allowed:
        told.append(f"the planners stood still for {100 * worst.waited_share():.0f} % of theirs")
    return Noise(f"{' and '.join(told)} in the {_HALF_NAMES[at]} half of the run", worst.share())
