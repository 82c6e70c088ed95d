"""A budget in continuous integration: a build that fails where planning has become too slow or too dear.

A CI job needs one line, `nnpp-edge profile --profile ci.toml`: exit code 0 where all budgets are met, 1 where one is
missed, 3 where the machine was too noisy to tell. `nnpp-edge profile compare` finds what became worse.

Run time: 10 s; 5 s with --small. Figures with --small mean nothing.
Data: moon_highlands, LROC WAC GLD100, public domain; details: nnpp_edge/terrain/samples/README.md.
"""

from pathlib import Path

from drawing import panels, run, save

from nnpp_edge.profiling.profile_file import overridden, read_profile
from nnpp_edge.profiling.report import profile_machine

PROFILE = """
title = "What our robot needs"
planner = "corridor"
budgets = [
  { name = "a plan", quantity = "time_ms_p90", limit = 20.0, direction = "at most", unit = "ms" },
  { name = "sooner than exact A*", quantity = "speedup_total", limit = 1.2, direction = "at least", unit = "x" },
  { name = "mean gap", quantity = "gap_mean", limit = 2.0, direction = "at most", unit = "%" },
  { name = "every query answered", quantity = "success", limit = 100.0, direction = "at least", unit = "%" },
]
[workload]
terrain = "sample"
rescale = 20.0
workloads = ["limit20"]
sizes = [256]
queries = 20
near = 4
"""
COLOURS = {"pass": "seagreen", "fail": "firebrick", "noisy": "goldenrod", "not measured": "grey"}
EXIT_CODES = {"met": 0, "missed": 1, "noisy": 3}


def main(folder: Path, small: bool = False) -> Path:
    """Write the profile, measure by it, and draw each figure as a share of its limit."""
    (folder / "ci.toml").write_text(PROFILE)
    profile = read_profile(folder / "ci.toml")
    report = profile_machine(overridden(profile, queries=2)[0] if small else profile)
    print(f"{report['summary']}: exit code {EXIT_CODES[report['verdict']]}")

    figure, (axes,) = panels(1, width=7.0, height=3.0)
    for budget in report["budgets"]:
        name = f"{budget['name']}\n{budget['direction']} {budget['limit']:g} {budget['unit']}"
        share = (budget["value"] or 0.0) / budget["limit"]
        axes.barh(name, share, color=COLOURS[budget["verdict"]])
        axes.text(
            share, name, f" {budget['value']:.3g} {budget['unit']}, {budget['verdict']}", va="center", fontsize=8
        )
    axes.set(title=f"budgets {report['verdict']}", xlabel="share of the limit", xlim=(0, axes.get_xlim()[1] * 1.3))
    axes.axvline(1.0, color="black", linewidth=1)
    return save(figure, folder, "budget_in_ci")


if __name__ == "__main__":
    run(main)
