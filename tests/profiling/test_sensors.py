"""Sensors read from a folder made like /sys, and what is made of their readings."""

from types import SimpleNamespace

import pytest

from nnpp_edge.profiling import sensors
from nnpp_edge.profiling.sensors import Sensors
from tests.tables import cases

LIMITS = {"clock_mhz": {"0": 2000.0, "1": 2000.0}, "temperature_c": {"cpu 0": 85.0}}


CLOCK = "devices/system/cpu/cpu0/cpufreq/scaling_cur_freq"
TEMPERATURE = "class/thermal/thermal_zone0/temp"
FILES = {
    CLOCK: 1_800_000,
    TEMPERATURE: 55_250,
    "class/thermal/thermal_zone0/type": "cpu",
}
TRIPS = {"active": 60_000, "critical": 105_000, "passive": 85_000, "hot": 0}


@pytest.fixture
def write(tmp_path):
    """Write a file below a folder like /sys: of two cores of 2 GHz and one zone that slows them at
    85 °C, starts a fan at 60, and has an unused point.
    """

    def write(path, content):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{content}\n")

    for path, content in FILES.items():
        write(path, content)
    for core in (0, 1):
        write(f"devices/system/cpu/cpu{core}/cpufreq/cpuinfo_max_freq", 2_000_000)
        write(f"devices/system/cpu/cpu{core}/thermal_throttle/core_throttle_count", 3)
    for at, (kind, milli) in enumerate(TRIPS.items()):
        write(f"class/thermal/thermal_zone0/trip_point_{at}_type", kind)
        write(f"class/thermal/thermal_zone0/trip_point_{at}_temp", milli)
    return write


def test_a_machine_that_tells_nothing_has_no_readings_and_is_not_called_throttled(tmp_path):
    log = Sensors([0, 7], tmp_path)
    log.read()
    log.read()
    assert log.facts() == {"throttled": "", "clock_mhz": {}, "temperature_c": {}}


def test_readings_are_taken_no_sooner_than_a_quarter_second_after_the_last(tmp_path, monkeypatch):
    now = [0.0]
    log = Sensors([0], tmp_path)
    taken = []
    monkeypatch.setattr(sensors, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    for sixteenth in range(12):
        now[0] = sixteenth / 16
        if log.due():
            log.read()
            taken.append(sixteenth)
    assert taken == [0, 4, 8]


THROTTLED = """
2000 2000 2000 2000 2000 2000 | | |  | 0
2000 2000 2000 1810 1810 1810 | | |  | 0
2000 2000 2000 1500 1500 1500 | | | core 0 fell from 2000 to 1500 MHz | 0.125
2000 800 2000 2000 2000 2000 2000 2000 | | |  | 0
1500 1500 1500 2000 2000 2000 | | |  | 0
 | 84.9 84.9 84.9 84.9 | |  | 0
 | 80 85 86 80 | | 85 °C in 2 of 4 readings | 1
1000 1000 1000 1000 | 90 90 90 90 | | cpu 0 stood at its trip point | 0.5
 | | 5 5 5 |  | 0
 | | 5 6 9 | slowed its cores 4 times | 1
2000 2000 1500 1500 | | 0 0 1 1 | 1500 MHz; the processor slowed its cores 1 times | 0.125
2000 | | |  | 0
"""
"""Clocks, temperatures and counts; words that a run is called throttled by, and the share."""


@pytest.mark.parametrize(
    ("clocks", "temperatures", "counts", "words", "share"),
    cases(THROTTLED, 5),
)
def test_when_a_run_is_called_throttled(
    write, tmp_path, clocks, temperatures, counts, words, share
):
    log = Sensors([0, 1], tmp_path)
    told = {"clock_mhz": clocks, "temperature_c": temperatures, "throttles": counts}
    for kind, values in told.items():
        if values:
            sensor = "cpu 0" if kind == "temperature_c" else "0"
            log.readings[kind][sensor] = [float(value) for value in values.split()]
    found = log.throttling()
    assert bool(found.words) == bool(words) and words in found.words
    assert found.share == pytest.approx(float(share))


def test_the_report_tells_ranges_of_what_can_be_read_and_the_verdict(write, tmp_path):
    log = Sensors([0, 1], tmp_path)
    for mhz, degrees in ((2000, 60), (1900, 85), (1200, 84), (1200, 83)):
        write(CLOCK, 1000 * mhz)
        write(TEMPERATURE, 1000 * degrees)
        log.read()
    write(CLOCK, "<unknown>")
    (tmp_path / TEMPERATURE).unlink()
    write("devices/system/cpu/cpu1/thermal_throttle/core_throttle_count", 4)
    log.read()
    assert log.limits == LIMITS
    facts = log.facts()
    assert facts["clock_mhz"] == {"0": {"min": 1200, "max": 2000}}
    assert facts["temperature_c"] == {"cpu 0": {"min": 60, "max": 85}}
    assert "core 0 fell" in facts["throttled"] and "core 1" not in facts["throttled"]
    assert "in 1 of 4 readings" in facts["throttled"] and "1 times" in facts["throttled"]
