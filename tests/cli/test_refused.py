"""What makes no sense ends with exit code 2 and one line that says why, before anything
is written.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from rasterio import Affine

from tests.cli.grounds import LAID, with_a_hill
from tests.terrain.test_dem import geotiff

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
ENERGY = "[mobility.energy]\nmass_kg = 50\nrolling_resistance = 0.1\n"
SHORT = {
    "$PLAN": "plan hills.tif --start 5,5 --goal 70,80",
    "$HILL": "plan hill.npz --start 10,10 --goal 45,48 -o new",
    "$BODY": "plan hill.npz --start 10,10 --goal 45,48 -o new --vehicle small-rover",
    "$SMALL": "plan hills.tif --memory 100kB --start 5,5 --goal 70,80",
    "$REACH": "reach hills.tif --start 1,1",
    "$EVAL": "evaluate --terrain hill.npz --sizes 60 --queries 1",
    "$COST": "costmap hills.tif -o cost.tif",
    "$RUN": "run --map hills.npz --ticks 1",
    "$VIEW": "view --port 0 --no-browser",
}
CASES = """
fly                                            | no such command 'fly'; see nnpp-edge --help
plan                                           | missing argument 'DEM'; see nnpp-edge plan --help
costmap dem.tif                                | missing option '-o' / '--output'
plan hills.tif --start 1,1                     | missing option '--goal'
plan hills.tif --start 1 --goal 2,2            | wanted ROW,COL as two whole numbers, xy:X,Y
plan hills.tif --start xy:nan,1 --goal 2,2     | xy:X,Y
plan hills.tif --start 1.5,1 --goal 2,2        | two whole numbers
plan hills.tif --start xy:1e308,1e308 --goal 2,2 | near the map
plan hills.tif --start lonlat:-94.3,95 --goal 1,1 | latitude 95 of WGS 84 has no place in SVY21 / Singapore TM
plan hills.tif --start lonlat:10,50 --goal 1,1 | lies outside the map of 80 × 90 cells
plan hills.tif --start lonlat:103.83,1 --goal 1,1 | longitude 103.8333 to 103.8349 and latitude 1.3675
plan hills.tif --start 5,5 --goal xy:0,0       | lies outside the map of 80 × 90 cells, which spans x 28000 to 28180
plan hills.tif --start 5,5 --goal 9,86 --via 1,1 | goal (9, 86) is impassable
plan drive.mcap --start 1,1 --goal 2,2         | drive.mcap: wanted an elevation map, got a recording of messages; `G
$PLAN --time-limit 0                           | --time-limit
$PLAN --model nope                             | wanted a model file or the name of a shipped model | 'nope'
$PLAN --model text.txt --method nnpp           | text.txt: wanted an ONNX model
$PLAN --via 20,86                              | via 1, (20, 86), is impassable
$PLAN --via 1,1 --via 80,3                     | via 2, (80, 3), lies outside the map
$PLAN --best-order                             | --best-order orders the places of --via
$PLAN --step-cost energy                       | with mass_kg and rolling_resistance, such as the shipped vehicles
$PLAN --step-cost energy                       | step_cost='energy' needs a table [mobility.energy]
$PLAN --step-cost time --mobility mine.toml    | needs a table [mobility.time]
$PLAN --step-cost tobler --mobility nope       | wanted a vehicle's file | 'nope'
$PLAN --step-cost tobler --memory 1kB          | in memory alone | directed
$PLAN --step-cost tobler --refine any-angle    | refine='any-angle' prices lines by the map's cost
$PLAN --set radius_m=2 --set turning_radius_m=4 | is a disc: wanted no other values
$PLAN --gpkg                                   | --gpkg needs -o
$BODY --rescale 2                              | a body is checked on the ground itself: leave it out
$PLAN --rocks 0.1                              | no such option '--rocks'
$PLAN --workload body-rocks30                  | 0 to 20 percent
plan cost.npz --start 1,1 --goal 9,9 --vehicle small-rover | wanted heights, got costs
$HILL --vehicle none.toml                      | got 'none.toml' (no such file)
$HILL --set clearance_m=0.3                    | length_m is missing
$HILL --set clearance                          | wanted KEY=VALUE in TOML, such as clearance_m=0.3, got 'clearance'
$BODY --set "axles='two'"                      | axles: Expected int, got 'two'
$BODY --set clearance_m=nan                    | clearance_m must be
$HILL --set clearance=0.3                      | clearance is unknown: wanted one of length_m, width_m
$HILL --set radius_m=50                        | the map's edge lies within the vehicle's radius
$HILL --vehicle body.toml                      | wheels is unknown: wanted one of length_m
$HILL --step-cost energy --mobility heavy.toml | heavy.toml: mobility: energy.mass_kg must be a number above 0
$HILL --set length_m=50 --set width_m=2 --set clearance_m=1 | a map that the vehicle fits on
run --map hill.npz --ticks 1 --log log.mcap --vehicle body.toml | wheels is unknown: wanted one of length_m
$EVAL --step-cost energy --mobility body.toml  | body.toml: wanted a table [mobility], got none
$BODY --method nnpp --model none.onnx          | none.onnx
$BODY --workload body                          | is a vehicle's
$BODY --start 24,25                            | ; the nearest cell where it can stand is (
plan hill.npz --start 10,10 --goal 24,25 --vehicle small-rover | goal (24, 25) is impassable: in any heading
$BODY --start 0,0                              | start (0, 0) is impassable: in any heading unknown ground
$BODY --start 60,0                             | lies outside the map
$SMALL --vehicle small-rover                   | in memory alone
$SMALL --method astar                          | --method astar needs the whole map
$SMALL --compare                               | --compare needs the whole map
$SMALL --refine any-angle                      | --refine needs the whole map
$SMALL --start 400,5                           | start (400, 5) lies outside the map of 80 × 90 cells
$SMALL --start 9,86                            | start (9, 86) is impassable: its elevation is unknown; the nearest
$SMALL --memory much                           | a size such as 2GB
plan nothing.tif --memory 1kB --workload limit20 --start 1,1 --goal 2,2 | so is all around it
plan bare.tif --memory 1kB --start 1,1 --goal 2,2 | no cell size in the file
plan grid.asc --memory 1kB --start 1,1 --goal 2,2 | stored as text | gdal_translate
run --map cost.npz --ticks 1 --vehicle small-rover | holds costs: limits, a vehicle
run --map hills.npz --loop cores=x             | cores
run --map hills.npz --loop speed=3             | speed is unknown: wanted one of rate_hz, method
run --map hills.npz --output foo               | output must be stdout, zenoh[:ENDPOINT] or none, got 'foo'
run --map hills.npz --profile own.toml --ticks 1 | 'nope'
run --map hills.npz --method astar --model nope --ticks 1 | 'nope'
simulate --map hills.npz --method astar --model nope | 'nope'
$RUN --input nonsense                          | input must be stdin, replay:FILE or zenoh
$RUN --input replay                            | input must be
$RUN --input stdin:x                           | input must be
$RUN --input replay:none.jsonl                 | none.jsonl: wanted a recording
$RUN --fast                                    | only a replay can be fast
$RUN --output none --output stdout             | none goes with no other
$RUN --output stdout --output stdout           | outputs must differ
$RUN --input zenoh:tcp/a:1 --output zenoh:tcp/b:1 | one endpoint
$RUN --input replay:drive.jsonl --fast --fail-on-misses 0.1 | --fail-on-misses needs deadlines
$RUN --fail-on-misses 2                        | --fail-on-misses
$RUN --method magic                            | method: wanted one of auto, astar
$RUN --loop cores=[-1]                         | cores
$RUN --profile none                            | profile
$RUN --record no/such/folder.jsonl             | could not be written
$RUN --json                                    | --json prints on stdout
simulate --start 3,3                           | both --start and --goal
simulate --picture drive.jpg                   | .png or .gif file, got drive.jpg
simulate --map missing.tif                     | no such file
simulate --start 3,3 --goal 900,3 --size 32    | outside the map
simulate --start 3,3 --goal 90,3 --size 32     | nor further apart than --size 32
simulate --rate 0                              | --rate
simulate --set radius_m=1 --step-cost tobler   | a disc drives by costs here
simulate --vehicle bicycle                     | small-rover
simulate --rocks 0.3                           | --rocks
simulate --vehicle small-rover --rescale 0.02 --size 16 | that the vehicle fits on
$VIEW text.txt                                 | text.txt
$VIEW hills.npz --step-cost energy             | mobility.energy
$VIEW hills.npz --vehicle hovercraft           | hovercraft
$VIEW nothing.tif --workload limit20           | all impassable
$VIEW hills.npz --start lonlat:1,2             | coordinate system
simulate --seed -1                             | --seed
simulate --map hills.npz --log pipe.npy        | it is no plain file
reproduce table1 --quick --model nope          | 'nope'
reproduce fig99 -o new                         | wanted EXPERIMENT of table1
reproduce --model edge --model edge --model edge -o new | at most two of --model
reproduce fig12 --quick --terrain text.txt -o new | text.txt
reproduce fig7 --quick --terrain hill.npz -o new | wanted terrain of at least 64 cells a side, got 60
reproduce --terrain hills.npz -o text.txt/out  | wanted a folder to write to
profile compare none.json none.json            | none.json: wanted a report of nnpp-edge profile (no such file)
profile --profile quick --vehicle small-rover -o out | vehicle: wanted none without the workload body
profile --profile rover --vehicle none.toml -o out | got 'none.toml' (no such file)
profile --peers --vehicle small-rover          | --vehicle does not go with --peers
evaluate --synthetic --sizes 999999999         | sides of 2 to 32768 cells
evaluate --terrain hills.npz --methods astar --model nope | 'nope'
$COST --workload body-rocks5                   | 'body-rocks5' | evaluate
profile --profile quick --peers                | --peers
profile --peers --junit budgets.xml            | --junit does not go with --peers
profile --peers --junit budgets.xml            | --junit does not go with --peers
profile render none.json                       | none.json: wanted a report of nnpp-edge profile (no such file)
profile render text.txt                        | text.txt: wanted a report of nnpp-edge profile
profile render                                 | missing argument 'REPORT'
profile --queries 5 compare a.json b.json      | compare
profile --profile slow                         | 'slow' | quick
evaluate                                       | give either --terrain FILE or --synthetic
evaluate --terrain text.txt --methods astar    | text.txt: wanted GeoTIFF
$EVAL --methods best                           | --methods must be of auto, astar | got best
$EVAL --methods astar --sizes 512              | at least 512 × 512 cells
run --map text.txt --ticks 1                   | text.txt: wanted GeoTIFF
$EVAL --workload body                          | --workload body needs a vehicle
$EVAL --vehicle small-rover                    | for the workloads body and body-rocksN
$EVAL --set radius_m=1 --workload body         | a disc has no poses
$REACH                                         | give one of --within-cost, --within-time and --within-energy
$REACH --within-cost 3 --within-time 3         | give one of
$REACH --within-time soon                      | a time such as 90, 90s, 30min or 2h
$REACH --within-cost 3 --start 9,86            | start (9, 86) is impassable: its elevation is unknown; the nearest
$REACH --within-time 3 --step-cost linear      | --within-time counts time already: leave out --step-cost, or give
$REACH --within-energy 20MN                    | '--within-energy' | 500kJ, 20MJ or 2kWh
$REACH --within-energy 3 --step-cost tobler    | --within-energy counts energy already: leave out --step-cost
$REACH --within-energy 3                       | needs a table [mobility.energy]
$REACH --within-cost 3 --step-cost energy      | needs a table [mobility.energy]
costmap hills.tif -o cost.gif                  | must end in .tif
costmap hills.tif -o ''                        | wanted a path, got nothing
costmap hills.tif -o pipe.npy                  | it is no plain file
$COST --limit slope_limit_deg=95               | got 95
$COST --limit step_limit_m=high                | wanted KEY=VALUE in TOML, such as hard_slope_deg=20
$COST --limit "hard_slope_deg='x'"             | hard_slope_deg
$COST --limit slope_weight=0.5                 | the weights must be at least 0 and sum to 1
$COST --limit slope=3                          | slope is unknown: wanted one of slope_limit_deg
$COST --workload steep                         | steep
$COST --workload limit20 --limit slope_limit_deg=25 | leave out --limit slope_limit_deg
costmap sample:mars -o cost.npz                | moon_highlands | 'mars'
$PLAN -o out                                   | out/plan.json: could not be written (it is a folder)
dataset -o text.txt/set --maps 2               | text.txt/set | wanted a folder to write to
dataset hills.npz -o new --maps 2 --known 4    | wanted at least 128 cells on the shorter side
dataset hills.npz -o new/set --maps 2 --size 160 --known 2 | at least 320 cells on the shorter side | got 80 × 90
simulate hills.tif                             | extra argument (hills.tif); see nnpp-edge
profile --profile quick --json out.json        | no such command 'out.json'; see nnpp-edge profile --help
$PLAN -o loop                                  | symbolic links
$PLAN -o text.txt                              | text.txt | folder to write to
costmap hills.tif -o text.txt/cost.tif         | could not be written
costmap hills.tif -o none/cost.npy             | could not be written
costmap hills.npz -o hills.npz                 | --output would replace hills.npz, which is read
costmap hills.npz -o link.npz                  | would replace | which is read
costmap grey.png -o grey.npy --cell-size 1 | --output would replace grey.png | which is read
export hills.npz -o hills.npz                  | would replace | which is read
quantize hills.npz --dataset set --validation set -o link.npz | would replace | which is read
profile --profile set/report.json -o set       | would replace | which is read
profile --peers --terrain set/peers.json -o set | would replace | which is read
simulate --map hills.npz --log hills.npz       | would replace | which is read
simulate --map grey.png --picture grey.png     | would replace | which is read
"""


@pytest.fixture
def place(run, hills, tmp_path):
    """A folder of inputs of all kinds, in which commands run."""
    cliff = 50.0 * np.arange(90.0)
    geotiff("nothing.tif", (hills + cliff).astype(np.float32), **LAID)
    geotiff("bare.tif", hills, transform=Affine.identity())
    rows = "\n".join(" ".join(["0.0"] * 90) for _ in range(80))
    Path("grid.asc").write_text(
        f"ncols 90\nnrows 80\nxllcorner 0\nyllcorner 0\ncellsize 2\n{rows}\n"
    )
    np.savez("hill.npz", elevation_m=with_a_hill(), cell_size_m=0.25)
    np.savez("cost.npz", cost=np.full((60, 60), 0.2, np.float32), cell_size_m=0.25)
    Path("drive.mcap").write_bytes(b"\x89MCAP0\r\n" * 20)
    Path("set").mkdir()
    for name, text in {
        "mine.toml": ENERGY,
        "heavy.toml": ENERGY.replace("50", "-50"),
        "body.toml": "length_m = 1.0\nwidth_m = 0.8\nclearance_m = 0.3\nwheels = 6\n",
        "own.toml": "[loop]\nmodel = 'nope'\nmethod = 'astar'\n[workload]\nterrain = "
        "['hills.npz']\n",
        "set/report.json": "[workload]\nterrain = ['hills.npz']\n",
        **dict.fromkeys(("text.txt", "grey.png", "set/peers.json", "set/dataset.json"), "input"),
    }.items():
        Path(name).write_text(text)
    Path("link.npz").symlink_to("hills.npz")
    Path("loop").symlink_to("loop")
    Path("out/plan.json").mkdir(parents=True)
    os.mkfifo("pipe.npy")
    return tmp_path


def files(folder):
    """Contents by name; of folders nothing."""
    found = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return found | {path: None for path in folder.rglob("*") if path.is_dir()}


def test_what_makes_no_sense_ends_in_one_line_and_writes_nothing(run, place):
    before = files(place)
    for line in CASES.strip().splitlines():
        words, *complaints = line.split(" | ")
        for short, whole in SHORT.items():
            words = words.replace(short, whole)
        ended = run(words)
        *_, last = ended.err.splitlines()
        assert (ended.code, ended.out) == (2, "") and ended.err.count("error") == 1, (
            line,
            ended.err,
        )
        assert last.startswith("error: ") and all(told.strip() in last for told in complaints), (
            line,
            ended.err,
        )
        assert files(place) == before, line


def test_ends_where_none_can_be_have_a_status_for_programs(run, place):
    for start, goal, status, told in (
        (
            "-1,5",
            "70,80",
            "START_OUTSIDE_MAP",
            "start (-1, 5) lies outside the map of 80 × 90 cells",
        ),
        ("5,5", "5,900", "GOAL_OUTSIDE_MAP", "goal (5, 900) lies outside the map of 80 × 90 cells"),
        (
            "40,86",
            "70,80",
            "START_BLOCKED",
            "start (40, 86) is impassable: its elevation is unknown",
        ),
        ("5,5", "40,86", "GOAL_BLOCKED", "the nearest passable cell is (40, 85)"),
    ):
        for more in ("--method astar", "--memory 1kB"):
            ended = run(f"plan hills.tif --start {start} --goal {goal} --json {more}")
            assert ended.json["status"] == status and told in ended.err
    words = "plan nothing.tif --start 1,1 --goal 20,20 --workload limit20"
    run(words).refused(
        "80 × 90 cells of 2 m, all impassable; heights are read as metres; for feet:"
    )
    assert run(words, "--json").json == {"status": "INVALID_MAP"}


def test_outputs_are_checked_before_any_work(run, place, monkeypatch):
    for work in (
        "profiling.suites.read_dem",
        "terrain.dem.read_dem",
        "profiling.report.profile_machine",
    ):
        monkeypatch.setattr(f"nnpp_edge.{work}", None)
    for words in (
        "plan hills.npz --start 1,1 --goal 2,2 -o loop",
        "costmap hills.npz -o pipe.npy",
    ):
        assert run(words).code == 2
