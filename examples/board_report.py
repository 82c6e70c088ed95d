"""Your board against a budget: what `nnpp-edge profile` measures, how to read it, and how a build fails by it.

All planners answer the same queries in turns. The picture shows where the time of a query goes, stage by stage, what
each planner gains over exact A* and what its paths cost more. A CI job needs one line, `nnpp-edge profile --profile
ci.toml`: exit code 0 where all budgets are met, 1 where one is missed, 3 where the machine was too noisy to tell.

Run time: 15 s; 10 s with --small. Figures with --small mean nothing.
Data: moon_highlands, LROC WAC GLD100, public domain; details: nnpp_edge/terrain/samples/README.md.
"""

from pathlib import Path

from drawing import panels, run, save
from matplotlib.patches import Patch

from nnpp_edge.profiling.profile_file import overridden, read_profile
from nnpp_edge.profiling.report import profile_machine

PROFILE = """
title = "What our robot needs"
planner = "corridor"
budgets = [
  { name = "a plan", quantity = "time_ms_p90", limit = 20.0, direction = "at most", unit = "ms" },
  { name = "faster than exact A*", quantity = "speedup_total", limit = 1.2, direction = "at least", unit = "x" },
  { name = "mean gap", quantity = "gap_mean", limit = 2.0, direction = "at most", unit = "%" },
]
workload = { terrain = "sample", rescale = 20.0, workloads = ["limit20"], sizes = [256] }
"""


def main(folder: Path, small: bool = False) -> Path:
    """Write the profile, measure by it, and draw what matters of the report."""
    (folder / "ci.toml").write_text(PROFILE)
    profile = read_profile(folder / "ci.toml")
    report = profile_machine(overridden(profile, queries=2, near=1)[0] if small else profile)
    figure, (times, words) = panels(2, width=5.2)
    stages = list(dict.fromkeys(stage for row in report["results"] for stage in row["stages_ms"]))
    for row in report["results"]:
        end = 0.0
        for stage, figures in row["stages_ms"].items():
            times.barh(row["planner"], figures["mean"], left=end, color=f"C{stages.index(stage)}")
            end += figures["mean"]
        gain = f" x {row['speedup_total']:.1f}, +{100 * (row['gap_mean'] or 0.0):.2f} %"
        times.text(end, row["planner"], gain, va="center", fontsize=8)
    times.set(title="a query's time by stage, ms\n(times as fast as A*, mean cost above it)", xmargin=0.35)
    times.legend([Patch(color=f"C{at}") for at in range(len(stages))], stages, fontsize=7, loc="upper right")
    words.set_axis_off()
    lines = [f"verdict: {report['verdict']}", report["environment"]["cpu"]]
    for budget in report["budgets"]:
        wanted = f"{budget['direction']} {budget['limit']:g} {budget['unit']}"
        lines.append(f"\n{budget['verdict']:<8}{budget['name']}\n{'':<8}{budget['value']:.3g}, wanted {wanted}")
    words.text(0.0, 1.0, "\n".join(lines), va="top", family="monospace", fontsize=8)
    print(report["summary"])
    return save(figure, folder, "board_report")


if __name__ == "__main__":
    run(main)
