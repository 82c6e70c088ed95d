"""The wheel: its packages and files, what they import, and the types that reach another package."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from zipfile import ZipFile

import pytest

from nnpp_edge.cli.main import COMMANDS

ROOT = Path(__file__).parent.parent
STAGES = {"runtime", "export", "calibrate", "profiles"}
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
TRAINING = {"torch", "onnx", "onnxscript", "rasterio", "matplotlib", "safetensors"}


def packages():
    """Name and folder of everything in nnpp_edge that holds Python files; the links count as
    folders.
    """
    waiting = [ROOT / "nnpp_edge"]
    while waiting:
        folder = waiting.pop()
        if any(folder.glob("*.py")):
            yield ".".join(folder.relative_to(ROOT).parts), folder
        waiting += [inner for inner in folder.iterdir() if inner.is_dir()]


def test_every_folder_with_code_is_a_listed_package():
    found = dict(packages())
    assert set(found) == set(PYPROJECT["tool"]["setuptools"]["packages"])
    for folder in found.values():
        assert (folder / "__init__.py").exists(), folder


def test_stages_are_folders_at_the_top_and_links_inside_the_package():
    links = {
        path.name: path.readlink() for path in (ROOT / "nnpp_edge").iterdir() if path.is_symlink()
    }
    assert links == {name: Path("..") / name for name in STAGES}
    assert all((ROOT / name).is_dir() and not (ROOT / name).is_symlink() for name in STAGES)


def test_every_other_file_of_a_package_is_listed_too():
    """Models, profiles, samples and templates would be missing from the wheel."""
    globs = PYPROJECT["tool"]["setuptools"]["package-data"]
    listed = set()
    found = set()
    for name, folder in packages():
        listed |= {path for glob in globs.get(name, []) for path in folder.glob(glob)}
        found |= {path for path in folder.iterdir() if path.is_file() and path.suffix != ".py"}
    for folder in ("terrain/samples", "profiles/vehicles", "view/page"):
        found |= set((ROOT / "nnpp_edge" / folder).iterdir())
    assert listed == found


def heavy_modules(code, names):
    """Which of these packages a fresh Python has imported after `code`."""
    code += (
        f"\nimport sys; print(*sorted({names!r} & {{name.partition('.')[0] for name in "
        "sys.modules}))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split()


def test_a_process_that_ends_while_a_search_is_paused_says_nothing():
    code = (
        "import numpy as np\n"
        "from nnpp_edge.runtime import DynamicPlanner\n"
        "cost = np.random.default_rng(0).random((300, 300), np.float32)\n"
        "planner = DynamicPlanner(np.minimum(cost, np.float32(0.9)), (290, 290), 'astar')\n"
        "planner.move((0, 0))\n"
        "planner.replan(time_limit_s=0.0, goes_on=True)\n"
        "print(planner.searching)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.stdout, ended.stderr) == ("True\n", "")


@pytest.mark.slow
def test_the_runtime_imports_neither_torch_nor_onnx():
    code = (
        "import numpy as np\n"
        "from nnpp_edge.runtime import NetworkModel, Planner, traversability_cost\n"
        "planner = Planner(np.zeros((70, 70), np.float32))\n"
        "assert planner.plan((0, 0), (69, 69), method='corridor').ok\n"
        "NetworkModel('edge')"
    )
    assert heavy_modules(code, TRAINING) == []


def test_help_and_the_list_of_models_import_nothing_heavy():
    helps = [["--help"], *([name, "--help"] for name in COMMANDS)]
    heavy = TRAINING | {"numba", "onnxruntime", "cv2"}
    for calls, more in (
        (helps, {"numpy", "rich", "jinja2"}),
        ([["models", "--json"], ["models", "edge"]], set()),
    ):
        code = (
            "from click.testing import CliRunner\n"
            "from nnpp_edge.cli.main import cli\n"
            f"for words in {calls}:\n"
            "    assert CliRunner().invoke(cli, words).exit_code == 0"
        )
        assert heavy_modules(code, heavy | more) == []


def test_the_onboard_install_asks_for_no_training_packages():
    needed = {
        re.split(r"[^\w-]", requirement)[0] for requirement in PYPROJECT["project"]["dependencies"]
    }
    assert not needed & TRAINING


def test_an_error_line_names_the_extra_that_brings_the_missing_module():
    extras = PYPROJECT["project"]["optional-dependencies"]
    brings = packages_distributions()
    source = "".join(path.read_text() for _, folder in packages() for path in folder.glob("*.py"))
    calls = re.findall(
        r'\boptional_module\(\s*"(\w+)[\w.]*",\s*(?:[^"]*|f?"[^"]*"),\s*"(\w+)"', source
    )
    assert len(calls) == source.count("optional_module(") - 1  # where it is defined
    for module, extra in calls:
        brought = " ".join(extras[extra]).replace("-", "_")
        (name,) = set(brings[module])
        assert name.lower().replace("-", "_") in brought


CONSUMER = """
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Vehicle, traversability_cost
from nnpp_edge.runtime.errors import NnppEdgeError, Status


def first_path(elevation: NDArray[np.float32]) -> NDArray[np.int32]:
    planner = Planner.of_elevation(elevation, 2.0)
    assert_type(planner, Planner)
    plan = planner.plan((0, 0), (9, 9), method="corridor")
    assert_type(plan, Plan)
    assert_type(plan.cost, float)
    return plan.path


def on_costs(elevation: NDArray[np.float32]) -> Status:
    try:
        cost = traversability_cost(elevation, 2.0)
        return DynamicPlanner(cost, (9, 9)).replan().status
    except NnppEdgeError as error:
        raise SystemExit(str(error)) from error


def body() -> float:
    return Vehicle(1.5, 1.0, 0.25).length_m


def wrong(planner: Planner) -> str:
    planner.plan((0, 0))
    return planner.plan((0, 0), (9, 9)).cost
"""


@pytest.mark.slow
def test_a_strict_package_outside_passes_and_its_mistakes_are_found(tmp_path):
    (tmp_path / "consumer.py").write_text(CONSUMER)
    words = f"-m mypy --strict --cache-dir {ROOT / '.mypy_cache/consumer'} consumer.py"
    command = [sys.executable, *words.split()]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    problems = [line for line in ended.stdout.splitlines() if ": error: " in line]
    last = len(CONSUMER.splitlines())
    assert ended.returncode == 1 and not ended.stderr, ended.stdout + ended.stderr
    assert [line.split(":")[1] for line in problems] == [str(last - 1), str(last)], ended.stdout
    assert "[call-arg]" in problems[0] and "[return-value]" in problems[1]


@pytest.mark.slow
def test_a_wheel_of_kernels_is_made_for_other_processors_too_and_what_it_holds_is_not_compiled(
    tmp_path,
):
    (tmp_path / "site").mkdir()
    (tmp_path / "site/nnpp_edge").symlink_to(ROOT / "nnpp_edge")
    made = [
        sys.executable,
        ROOT / ".ci/kernel_wheel.py",
        tmp_path,
        "nnpp_edge.runtime.kernels.threshold:lowered",
        "nnpp_edge.runtime.kernels.weights:fill_costs",
    ]
    subprocess.run(made, check=True, stdout=subprocess.DEVNULL)
    of_arm, of_x86 = sorted(tmp_path.glob("nnpp_edge_kernels-*.whl"))
    with ZipFile(of_arm) as wheel:
        files = [wheel.read(name) for name in wheel.namelist() if name.endswith(".nbc")]
    for kept in files:
        at = kept.index(b"\x7fELF")
        assert int.from_bytes(kept[at + 18 : at + 20], "little") == 183  # aarch64
        assert b" at 0x" not in kept and b"site-packages" not in kept  # the same made elsewhere
    assert len(files) > 1
    with ZipFile(of_x86) as wheel:
        wheel.extractall(tmp_path / "site")
    code = (
        "from nnpp_edge.runtime.kernels.threshold import lowered\n"
        "print(lowered(3, 0.5), sum(lowered.stats.cache_misses.values()))"
    )
    levels = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": ""}
    environment = (
        os.environ
        | levels
        | {"PYTHONPATH": str(tmp_path / "site"), "NUMBA_CACHE_DIR": str(tmp_path / "own")}
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=environment,
        check=True,
    )
    assert ended.stdout.endswith(" 0\n") and ended.stderr == ""
