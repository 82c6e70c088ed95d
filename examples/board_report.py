"""Your board's report, explained: what `nnpp-edge profile` measures, and how to read it.

All planners answer the same queries in turns. The picture shows where the time of a query goes, stage by stage,
what each planner gains over exact A* and what its paths cost more; the budgets below say whether the board keeps
them. The run has two halves: where these differ too much, or others used the cores, a budget is called noisy,
neither kept nor missed.

Run time: 15 s; 10 s with --small. Figures with --small mean nothing.
Data: moon_highlands, LROC WAC GLD100, public domain (nnpp_edge/terrain/samples/README.md), with cells as if they
were 20 m.
"""

import json
from pathlib import Path

from drawing import panels, run, save

from nnpp_edge.files import write_whole
from nnpp_edge.profiling.profile_file import overridden, read_profile
from nnpp_edge.profiling.report import profile_machine


def main(folder: Path, small: bool = False) -> Path:
    """Measure by the shipped profile `quick`, keep the report, and draw what matters of it."""
    profile = read_profile("quick")
    if small:
        profile, _ = overridden(profile, queries=2, near=1)
    report = profile_machine(profile)
    write_whole(folder / "board_report.json", json.dumps(report, indent=1).encode())

    figure, (times, words) = panels(2, width=5.2)
    rows = report["results"]
    left = [0.0] * len(rows)
    names = [row["planner"] for row in rows]
    for stage in dict.fromkeys(stage for row in rows for stage in row["stages_ms"]):
        means = [row["stages_ms"][stage]["mean"] if stage in row["stages_ms"] else 0.0 for row in rows]
        times.barh(names, means, left=left, label=stage)
        left = [begun + mean for begun, mean in zip(left, means, strict=True)]
    for at, row in enumerate(rows):
        gap = row["gap_mean"] or 0.0
        times.text(left[at], at, f" x {row['speedup_total']:.1f}, +{100 * gap:.2f} %", va="center", fontsize=8)
    times.set(
        title="a query's time by stage, ms\n(times as fast as A*, mean cost above it)", xlim=(0, 1.35 * max(left))
    )
    times.legend(fontsize=7, loc="upper right")
    words.set_axis_off()
    lines = [f"verdict: {report['verdict']}", report["environment"]["cpu"], ""]
    for budget in report["budgets"]:
        value = "not measured" if budget["value"] is None else f"{budget['value']:.3g} {budget['unit']}"
        wanted = f"{budget['direction']} {budget['limit']:g} {budget['unit']}"
        lines.append(f"{budget['verdict']:<13}{budget['name']}\n{'':<13}{value}, wanted {wanted}")
    words.text(0.0, 1.0, "\n".join(lines), va="top", family="monospace", fontsize=8)
    print(report["summary"])
    return save(figure, folder, "board_report")


if __name__ == "__main__":
    run(main)
