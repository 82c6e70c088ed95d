"""What a profile says of the machine: processor, pinned cores and load by others."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from nnpp_edge.profiling import machine
from nnpp_edge.profiling.machine import Disturbance, environment, pinned


@contextmanager
def busy_core(core):
    """Another process that keeps a core busy."""
    code = f"import os\nos.sched_setaffinity(0, [{core}])\nprint(flush=True)\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            yield
        finally:
            process.kill()


def work(seconds):
    began = time.process_time()
    while time.process_time() - began < seconds:
        pass


def test_another_process_on_the_core_is_seen():
    core = min(os.sched_getaffinity(0))
    watch = Disturbance([core])
    if machine.core_seconds([core]) is None:
        pytest.skip("this kernel does not count the cores' time")
    with busy_core(core), pinned([core]), watch.watched():
        work(0.3)
    assert watch.facts()["others_share"] > 0.25


def test_own_work_is_not_that_of_others(monkeypatch):
    """With the kernel's counter made to agree with our own use."""
    monkeypatch.setattr(machine, "core_seconds", lambda cores: time.process_time())
    watch = Disturbance([0])
    for _ in range(3):
        with watch.watched():
            work(0.02)
        work(0.02)  # not watched
    assert watch.facts()["others_share"] < 0.05
    assert watch.facts()["measured_s"] > 0.05


def test_a_kernel_that_does_not_count_is_not_taken_for_an_idle_one(monkeypatch, tmp_path):
    (tmp_path / "stat").write_text("cpu  0 0 0 0 0 0 0 0 0 0\ncpu0 0 0 0 0 0 0 0 0 0 0\n")
    monkeypatch.setattr(machine, "_PROC", tmp_path)
    watch = Disturbance([0])
    with watch.watched():
        pass
    assert watch.facts()["others_share"] is None


def test_threads_are_pinned_and_set_free_again():
    before = os.sched_getaffinity(0)
    core = min(before)
    with ThreadPoolExecutor(1) as pool:

        def of_both():
            return [os.sched_getaffinity(0), pool.submit(os.sched_getaffinity, 0).result()]

        assert of_both() == [before] * 2
        with pinned([core]) as (cores, said):
            assert (cores, said) == ([core], [])
            assert of_both() == [{core}] * 2
        assert of_both() == [before] * 2


def test_cores_that_are_missing_are_said():
    have = os.sched_getaffinity(0)
    with pinned([*have, 4000]) as (cores, said):
        assert set(cores) == have
    assert len(said) == 1 and "4000, not all of which" in said[0]
    with pinned([4000]) as (cores, said):
        assert cores == [min(have)] and "4000" in said[0]


RASPBERRY_PI_4 = """\
processor\t: 3
BogoMIPS\t: 108.00
Features\t: fp asimd evtstrm crc32 cpuid
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x0
CPU part\t: 0xd08
CPU revision\t: 3

Hardware\t: BCM2835
Revision\t: c03114
Serial\t\t: 100000001a2b3c4d
Model\t\t: Raspberry Pi 4 Model B Rev 1.4
"""


@pytest.mark.parametrize(
    ("cpuinfo", "cpu", "flags"),
    [
        (RASPBERRY_PI_4, "Raspberry Pi 4 Model B Rev 1.4", ["asimd"]),
        ("processor\t: 0\nmodel name\t: ARMv8\n", "ARMv8", []),
        (
            "processor\t: 0\nmodel name\t: A CPU\nflags\t\t: fpu avx2 avx512_vnni\n",
            "A CPU",
            ["avx2", "avx512_vnni"],
        ),
        (
            "processor\t: 0\nFeatures\t: fp asimd asimddp\nHardware\t: A board\n",
            "A board",
            ["asimd", "asimddp"],
        ),
    ],
)
def test_the_cpu_and_its_flags_on_x86_and_arm(monkeypatch, tmp_path, cpuinfo, cpu, flags):
    (tmp_path / "cpuinfo").write_text(cpuinfo)
    governor = tmp_path / "devices/system/cpu/cpu0/cpufreq"
    governor.mkdir(parents=True)
    (governor / "scaling_governor").write_text("powersave\n")
    monkeypatch.setattr(machine, "_PROC", tmp_path)
    monkeypatch.setattr(machine, "_SYS", tmp_path)
    facts = environment([0, 1])
    assert (facts["cpu"], facts["flags"], facts["governor"]) == (cpu, flags, ["powersave"])
    assert facts["packages"]["numpy"] and len(facts["load_average"]) == 3
