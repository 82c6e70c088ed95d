"""Sensors read from a folder made like /sys, and what is made of their readings."""

from types import SimpleNamespace

import pytest

from nnpp_edge.profiling import sensors
from nnpp_edge.profiling.sensors import Reading, Sensors, sensor_facts, throttling

LIMITS = Reading(0.0, {"0": 2000.0, "1": 2000.0}, {"cpu 0": 85.0})


class FakeSys:
    """A folder like /sys, whose sensors tell what they are told."""

    def __init__(self, root):
        self.root = root

    def write(self, path, content):
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{content}\n")

    def clock(self, core, khz):
        self.write(f"devices/system/cpu/cpu{core}/cpufreq/scaling_cur_freq", khz)

    def temperature(self, milli, zone=0):
        self.write(f"class/thermal/thermal_zone{zone}/temp", milli)


@pytest.fixture
def fake(tmp_path):
    """Two cores of 2 GHz and one zone that slows them at 85 °C, starts a fan at 60, and has an
    unused point.
    """
    tree = FakeSys(tmp_path)
    for core in (0, 1):
        tree.write(f"devices/system/cpu/cpu{core}/cpufreq/cpuinfo_max_freq", 2_000_000)
        tree.write(f"devices/system/cpu/cpu{core}/thermal_throttle/core_throttle_count", 3)
        tree.clock(core, 1_800_000)
    tree.write("class/thermal/thermal_zone0/type", "cpu")
    for at, (kind, milli) in enumerate(
        (("active", 60_000), ("critical", 105_000), ("passive", 85_000), ("hot", 0))
    ):
        tree.write(f"class/thermal/thermal_zone0/trip_point_{at}_type", kind)
        tree.write(f"class/thermal/thermal_zone0/trip_point_{at}_temp", milli)
    tree.temperature(55_250)
    return tree


def test_what_the_kernel_tells_without_files_that_cannot_be_read(fake, tmp_path):
    log = Sensors([0, 1], tmp_path)
    told = log.read()
    assert (log.limits, told.clock_mhz, told.throttles) == (LIMITS, {"0": 1800.0, "1": 1800.0}, 6)
    assert told.temperature_c == {"cpu 0": 55.25}
    fake.clock(0, "<unknown>")
    (tmp_path / "class/thermal/thermal_zone0/temp").unlink()
    told = log.read()
    assert told.clock_mhz == {"1": 1800.0} and told.temperature_c == {}


def test_a_machine_that_tells_nothing_has_no_readings_and_is_not_called_throttled(tmp_path):
    log = Sensors([0, 7], tmp_path)
    log.read()
    log.read()
    assert log.readings[0].throttles is None
    facts = sensor_facts(log.readings, log.limits)
    assert facts == {"readings": 2, "throttled": "", "clock_mhz": {}, "temperature_c": {}}


def test_readings_are_taken_no_sooner_than_a_quarter_second_after_the_last(
    fake, tmp_path, monkeypatch
):
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


def readings(clocks=(), temperatures=(), counts=()):
    """Readings of core 0 and of the one zone, in order."""
    count = max(map(len, (clocks, temperatures, counts)))
    return [
        Reading(
            float(at),
            {"0": clocks[at]} if clocks else {},
            {"cpu 0": temperatures[at]} if temperatures else {},
            counts[at] if counts else None,
        )
        for at in range(count)
    ]


FALLING = [2000.0] * 10 + [1500.0] * 10


@pytest.mark.parametrize(
    ("told", "words", "share"),
    [
        ({"clocks": [2000.0] * 20}, [], 0.0),
        ({"clocks": [2000.0] * 10 + [1810.0] * 10}, [], 0.0),
        ({"clocks": FALLING}, ["core 0 fell from 2000 to 1500 MHz"], 0.125),
        ({"clocks": [2000.0, 800.0, *[2000.0] * 18]}, [], 0.0),  # one odd reading is no fall
        ({"clocks": [1500.0] * 10 + [2000.0] * 10}, [], 0.0),
        ({"temperatures": [84.9] * 8}, [], 0.0),
        ({"temperatures": [80.0, 85.0, 86.0, 80.0]}, ["85 °C in 2 of 4 readings"], 1.0),
        (
            {"temperatures": [90.0] * 4, "clocks": [1000.0] * 4},
            ["cpu 0 stood at its trip point"],
            0.5,
        ),
        ({"counts": [5, 5, 5]}, [], 0.0),
        ({"counts": [5, 6, 9]}, ["slowed its cores 4 times"], 1.0),
        (
            {"clocks": FALLING[8:12], "counts": [0, 0, 1, 1]},
            ["fell", "slowed its cores 1 times"],
            0.125,
        ),
        ({"clocks": [2000.0]}, [], 0.0),
    ],
)
def test_when_a_run_is_called_throttled(told, words, share):
    found = throttling(readings(**told), LIMITS)
    assert bool(found.words) == bool(words) and all(each in found.words for each in words)
    assert found.share == pytest.approx(share)


def test_the_report_tells_ranges_limits_and_the_verdict(fake, tmp_path):
    log = Sensors([0, 1], tmp_path)
    for khz, milli in (
        (2_000_000, 60_000),
        (1_900_000, 85_000),
        (1_200_000, 84_000),
        (1_200_000, 83_000),
    ):
        fake.clock(0, khz)
        fake.temperature(milli)
        log.read()
    facts = sensor_facts(log.readings, log.limits)
    assert facts["clock_mhz"]["0"] == {
        "first": 2000.0,
        "last": 1200.0,
        "min": 1200.0,
        "max": 2000.0,
        "limit": 2000.0,
    }
    assert facts["temperature_c"]["cpu 0"] == {
        "first": 60.0,
        "last": 83.0,
        "min": 60.0,
        "max": 85.0,
        "trip": 85.0,
    }
    assert "core 0 fell" in facts["throttled"] and "core 1" not in facts["throttled"]
    assert "in 1 of 4 readings" in facts["throttled"]
