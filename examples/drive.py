"""A drive among obstacles that come and go, through the loop that runs on a robot.

The robot begins with a blurred survey, sees the true ground around it, and is told at each tick of obstacles that
appear, move and vanish. The loop keeps its path while that is valid and good, and else plans anew; every path is
checked apart from it. Beside the film there is a recording, drive.rrd, with the map, the paths and the patches over
time: `rerun drive.rrd` opens it.

Run time: 10 s.
Data: moon_highlands, LROC WAC GLD100, public domain (nnpp_edge/terrain/samples/README.md), with cells as if they
were 20 m.
"""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from drawing import run

from nnpp_edge.robot.transports.rerun_view import RerunSink
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.simulation.drive_picture import Film
from nnpp_edge.simulation.scene import SurveyedGround
from nnpp_edge.simulation.simulate import SimulationSettings, random_drive, simulate
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.workloads import workload


def main(folder: Path, small: bool = False) -> Path:
    """Drive, film it, and record it."""
    side = 64 if small else 200
    dem = sample_dem("moon_highlands").rescaled(20.0)
    dem = replace(dem, elevation=dem.elevation[100 : 100 + side, 60 : 60 + side].copy())
    ground = SurveyedGround.of(Ground.of_elevation(dem.elevation, dem.cell_size_m, workload("limit20")), block=8)
    start, goal = random_drive(ground, seed=3)
    film = Film()

    with ExitStack() as opened:

        def sinks(state: MapState) -> list[RerunSink]:
            return [opened.enter_context(RerunSink(folder / "drive.rrd", state=state, map_every_s=0.02))]

        drive = simulate(ground, start, goal, SimulationSettings(seed=3), make_sinks=sinks, watch=film)

    print(
        f"{'reached' if drive.reached else 'not reached'} after {drive.counters.ticks} ticks: "
        f"{drive.counters.planned} plans, {drive.counters.kept} times the standing path was kept"
    )
    print(
        f"an answer took {drive.planning_ms['p50']:.2f} ms, at most {drive.planning_ms['max']:.2f}; "
        f"{drive.forbidden} paths crossed what the map forbade"
    )
    film.save(folder / "drive.gif")
    return folder / "drive.gif"


if __name__ == "__main__":
    run(main)
