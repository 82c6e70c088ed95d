"""`nnpp-edge run`: the whole program, from the outside."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.robot import transports
from nnpp_edge.robot.operations import onboard
from nnpp_edge.robot.transports.recording import RecordingFile, read_recording
from nnpp_edge.robot.transports.stdio import StdioSource
from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.robot.transports.wiring import Wiring
from nnpp_edge.runtime import Goal, Ground, InProcessSink, MapPatch, Pose
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Counters
from nnpp_edge.runtime.loop.settings import OnboardLoop
from nnpp_edge.runtime.network import loading
from nnpp_edge.terrain import dem as dem_module
from tests.robot.conftest import free
from tests.tables import cases

ROOT = Path(__file__).parents[2]
SHAPE = (80, 90)
QUICK = ("--rate", "100", "--method", "astar")
RUN = (sys.executable, "-m", "nnpp_edge.cli.main", "run")


@pytest.fixture
def dem(tmp_path):
    """Gentle hills."""
    row, col = np.mgrid[0:80, 0:90]
    heights = (0.8 * np.sin(row / 9.0) * np.cos(col / 11.0)).astype(np.float32)
    np.savez(tmp_path / "hills.npz", elevation_m=heights, cell_size_m=2.0)
    return tmp_path / "hills.npz"


@pytest.fixture
def recording(tmp_path):
    """Three ticks: a way, an obstacle on it, a new goal."""
    recorder = RecordingFile(tmp_path / "drive.jsonl", SHAPE)
    for message in (Pose(5, 5), Goal(60, 70)):
        recorder.record(message, 0.0)
    recorder.record(MapPatch(20, 0, cost=np.full((1, 85), np.inf)), 0.1)
    recorder.record(Goal(60, 10), 0.2)
    recorder.close()
    return recorder.path


@pytest.fixture(autouse=True)
def no_manager(monkeypatch):
    """Tests that want a service manager set one up."""
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)


# --- in processes of their own


def test_the_script_in_the_documentation_runs_as_it_stands(dem, tmp_path):
    text = (ROOT / "docs/run.md").read_text()
    script = re.search(r"```sh\n(mkfifo.*?)```", text, re.DOTALL).group(1)
    command = tmp_path / "nnpp-edge"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m nnpp_edge.cli.main "$@"\n')
    command.chmod(0o755)
    environment = {
        **os.environ,
        "DEM": str(dem),
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    ended = subprocess.run(
        ["/bin/sh", "-e", "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    log = (tmp_path / "loop.log").read_text()
    assert ended.returncode == 0, ended.stderr + log
    assert "ticks" in log
    first, second = (json.loads((tmp_path / f"{n}.json").read_text()) for n in ("first", "second"))
    assert (first["path"][0], first["path"][-1]) == ([5, 5], [60, 70])
    assert second["map_version"] == 1
    assert not {(30, 30), (30, 31), (30, 32)} & set(map(tuple, second["path"]))


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="there is no compiler of C++")
def test_the_client_in_cpp_is_led_to_its_goal(dem, tmp_path):
    source = ROOT / "examples/cpp/client.cpp"
    assert len(source.read_text().splitlines()) <= 60
    options = ("-std=c++17", "-Wall", "-Wextra", "-Werror")
    subprocess.run(["g++", *options, "-o", tmp_path / "client", source], check=True)
    client = [tmp_path / "client", "5", "5", "20", "30"]
    for map_file, code in ((dem, 0), (tmp_path / "none.npz", 1)):
        ended = subprocess.run(
            [*client, *RUN, "--map", map_file, *QUICK],
            capture_output=True,
            text=True,
            timeout=120,
        )
        cells = [int(line.split()[0]) for line in ended.stdout.splitlines()]
        assert (ended.returncode, "Traceback" in ended.stderr) == (code, False), ended.stderr
        if code:
            assert cells == [0]
        else:  # at least as many cells as rows or columns lie between; a cell is driven a tick
            assert cells[0] >= 26 and cells[-1] == 3 and len(cells) >= 24


def test_it_tells_the_manager_stops_when_told_to_and_keeps_what_it_recorded(dem, tmp_path):
    record = tmp_path / "inputs.jsonl"
    address = str(tmp_path / "notify")
    told = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "200000", "WATCHDOG_PID": ""}
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    inputs = [Pose(5, 5), Goal(60, 70)]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(120.0)
        command = [*RUN, "--map", dem, *QUICK, "--record", record]
        program = subprocess.Popen(command, **pipes, env=os.environ | told)
        assert manager.recv(4096) == b"READY=1"
        program.stdin.write(b"".join(encode(message) + b"\n" for message in inputs))
        program.stdin.flush()
        found = next(each for each in map(json.loads, program.stdout) if each.get("path"))
        assert found["path"][-1] == [60, 70]
        program.send_signal(signal.SIGHUP)
        for _ in range(3):
            assert manager.recv(4096) in (b"WATCHDOG=1", b"STATUS=OK by standing")
        program.send_signal(signal.SIGTERM)
        _, err = program.communicate(timeout=30.0)
        assert (program.returncode, b"Traceback" in err) == (0, False), err
        while manager.recv(4096) != b"STOPPING=1":
            pass
    assert [message for _, message in read_recording(record, SHAPE)] == inputs


STARTING = """
import os, signal, sys
from nnpp_edge.cli.main import main
from nnpp_edge.robot.operations import onboard

class Loading:
    def __del__(self):  # where Python can pass no exception on
        os.kill(os.getpid(), signal.SIGTERM)

onboard.exercise = lambda: Loading() and None
sys.argv[1:] = ["run", "--map", sys.argv[1], "--ticks", "1"]
main()
"""


def test_it_may_be_stopped_while_it_starts_whatever_it_is_doing(dem):
    words = [sys.executable, "-c", STARTING, str(dem)]
    ended = subprocess.run(
        words,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, "")


@pytest.mark.parametrize("stderr", ["2>&-", "2>/dev/full"])
def test_paths_come_where_nothing_can_be_said_on_stderr(dem, recording, tmp_path, stderr):
    record = tmp_path / "again.jsonl"
    command = (
        f"exec {' '.join(RUN)} --map {dem} --rate 2 --method astar "
        f"--input replay:{recording} --fast --record {record} {stderr}"
    )
    ended = subprocess.run(["/bin/sh", "-c", command], stdout=subprocess.PIPE, timeout=120)
    answers = map(json.loads, ended.stdout.splitlines())
    outcomes = [each["outcome"] for each in answers if each["type"] == "path"]
    assert outcomes == ["OK"] * 3
    assert ended.returncode == 0
    assert len(list(read_recording(record, SHAPE))) == 4


# --- in this process


def test_an_input_that_fails_ends_the_run_with_an_error(nnpp_edge, dem, tmp_path, monkeypatch):
    with (tmp_path / "written to").open("wb") as unreadable:

        def opened(place, setup):
            count_error = setup.navigator.count_error
            return StdioSource(count_error, descriptor=unreadable.fileno())

        monkeypatch.setattr(StdioSource, "open", opened)
        ended = nnpp_edge("run", "--map", dem, *QUICK, "--output", "none")
    said = "error: the input failed, and the loop has ended: OSError: [Errno 9] Bad file"
    assert ended.code == 2 and said in ended.err


@pytest.fixture
def replayed(nnpp_edge, recording):
    """Run the program in this process over the recording, as fast as can be; how it ended."""
    fast = ("--input", f"replay:{recording}", "--fast", "--output", "none", "--json")
    return lambda file, *words: nnpp_edge("run", "--map", file, *fast, *words)


def test_a_replay_ends_with_its_counters_and_its_log(replayed, dem, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    log = tmp_path / "drive.mcap"
    ended = replayed(dem, "--method", "astar", "--rate", "2", "--log", log)
    assert ended.code == 0
    told = ended.json
    assert (told["ticks"], told["planned"], told["failed"], told["patches"]) == (3, 3, 0, 1)
    assert told["errors"] == {}
    assert "ready: astar at 2 Hz, 80 × 90 cells" in ended.err
    with log.open("rb") as file:
        topics = [channel.topic for _, channel, _ in reader.make_reader(file).iter_messages()]
    assert {"/pose", "/goal", "/path"} <= set(topics)


@pytest.mark.parametrize(("share", "code"), [("0.14", 0), ("0.13", 1)])
def test_a_run_that_misses_more_deadlines_than_that_share_fails(
    nnpp_edge, dem, monkeypatch, share, code
):
    counters = Counters(ticks=90, overruns=4, skipped=10)
    monkeypatch.setattr(onboard, "run", lambda *words, **more: counters)
    ended = nnpp_edge("run", "--map", dem, "--method", "astar", "--fail-on-misses", share)
    assert ended.code == code
    *_, last = ended.err.splitlines()
    assert last == f"14 of 100 deadlines missed, 14 %; allowed are {100 * float(share):g} %"
    without = nnpp_edge("run", "--map", dem, "--method", "astar")
    assert without.code == 0 and "allowed" not in without.err


def test_a_cost_map_is_understood_as_one(replayed, tmp_path):
    np.savez(tmp_path / "cost.npz", cost=np.full(SHAPE, 0.3, np.float32), cell_size_m=2.0)
    assert replayed(tmp_path / "cost.npz", *QUICK).json["planned"] == 3
    refused = replayed(tmp_path / "cost.npz", "--workload", "limit20")
    refused.refused("cost.npz holds costs: limits, a vehicle")


@pytest.mark.parametrize("given", [("tobler",), ("energy", "--mobility", "large-rover")])
def test_on_elevations_it_goes_by_a_step_cost(replayed, dem, given):
    ended = replayed(dem, *QUICK, "--step-cost", *given)
    assert ended.json["planned"] == 3, ended.err


def test_energy_without_a_mobility_is_refused(replayed, dem):
    replayed(dem, *QUICK, "--step-cost", "energy").refused("[mobility.energy]")


def test_ticks_end_it_and_the_profile_and_its_model_count(replayed, dem, tmp_path, tiny_model):
    profile = tmp_path / "robot.toml"
    profile.write_text(
        f'[loop]\nrate_hz = 50\nmethod = "nnpp"\nmodel = "{tiny_model}"\ncores = [0]\n'
    )
    words = ("--profile", profile, "--ticks", "2")
    ended = replayed(dem, *words)
    assert "ready: nnpp at 50 Hz" in ended.err
    assert ended.json["ticks"] == 2
    assert "ready: dstar at 80 Hz" in replayed(dem, *words, "--method", "dstar", "--rate", "80").err


SINKS = """
{}                                       | stdout
{"input": "replay:x"}                    | stdout
{"input": "zenoh:tcp/a:1"}               | zenoh
{"outputs": ["stdout", "zenoh:tcp/a:1"]} | stdout zenoh
{"outputs": ["none"]}                    |
"""


@pytest.mark.parametrize(("given", "sinks"), cases(SINKS))
def test_answers_go_back_to_where_inputs_come_from(given, sinks):
    found = Wiring(**json.loads(given)).sinks
    assert [entry.name for entry, _ in found] == sinks.split()


REFUSED = r"""
{"input": "zenoh:b:1", "outputs": ["zenoh:a:1"]} | one endpoint, got a:1, b:1
{"input": "replay"}               | input must be stdin, replay:FILE.* or zenoh\[:ENDPOINT\], got
{"input": "stdin:x"}              | input must be
{"fast": true}                    | only a replay can be fast
{"outputs": ["stdout", "none"]}   | output none goes with no other
{"outputs": ["stdout", "stdout"]} | outputs must differ
"""


@pytest.mark.parametrize(("given", "words"), cases(REFUSED))
def test_connections_that_do_not_go_together_are_refused(given, words):
    with pytest.raises(InvalidQueryError, match=words):
        Wiring(**json.loads(given))


def test_a_transport_is_added_by_a_class_and_an_entry(recording, monkeypatch):
    done = []

    class Kept(InProcessSink):
        @classmethod
        def open(cls, place, setup):
            done.append(place)
            return cls()

        def close(self):
            done.append(self.path.tick)

    entry = transports.TransportEntry(
        "output", "kept:WHERE", "the memory of a test", "of_test:Kept"
    )
    of_test = SimpleNamespace(Kept=Kept)
    monkeypatch.setitem(sys.modules, "nnpp_edge.robot.transports.of_test", of_test)
    monkeypatch.setattr(transports, "TRANSPORTS", (*transports.TRANSPORTS, entry))
    wiring = Wiring(input=f"replay:{recording}", outputs=("kept:here",), fast=True)
    loop = OnboardLoop(method="astar")
    onboard.run(Ground(free(SHAPE)), wiring, loop)
    assert done == ["here", 3]


@pytest.mark.parametrize("entry", transports.TRANSPORTS, ids=lambda entry: entry.kind)
def test_every_transport_is_documented(entry):
    text = (ROOT / "docs/messages.md").read_text() + (ROOT / "docs/run.md").read_text()
    assert entry.name in text


# --- the table [loop]


def test_the_network_is_loaded_while_the_first_map_is_read_where_it_will_be_asked(
    replayed,
    dem,
    monkeypatch,
):
    done = []

    def noted(name, function):
        return lambda *words, **more: done.append(name) or function(*words, **more)

    monkeypatch.setattr(loading, "begin_loading", noted("loading begins", loading.begin_loading))
    monkeypatch.setattr(dem_module, "read_dem", noted("the map is read", dem_module.read_dem))
    assert replayed(dem, "--method", "auto").code == 0
    assert done == ["the map is read"]
    done.clear()
    assert replayed(dem, "--method", "nnpp-dstar").code == 0
    assert done == ["loading begins", "the map is read"]
