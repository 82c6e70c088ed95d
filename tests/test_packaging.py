import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
STAGES = {"runtime", "export", "calibrate", "profiles"}
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def package_folders():
    for top in ("nnpp_edge", *sorted(STAGES)):
        for folder in (ROOT / top, *(ROOT / top).rglob("*")):
            if folder.is_dir() and any(folder.glob("*.py")):
                name = ".".join(folder.relative_to(ROOT).parts)
                yield folder, name if top == "nnpp_edge" else f"nnpp_edge.{name}"


def test_every_folder_with_code_is_a_listed_package():
    listed = set(PYPROJECT["tool"]["setuptools"]["packages"])
    found = {name: folder for folder, name in package_folders()}
    assert set(found) == listed
    for folder in found.values():
        assert (folder / "__init__.py").exists(), folder


def run_python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_runtime_imports_neither_torch_nor_onnx():
    code = (
        "import sys\n"
        "import numpy as np\n"
        "from nnpp_edge.runtime import NetworkModel, Planner, plan_path, traversability_cost\n"
        "assert plan_path(np.zeros((70, 70), np.float32), (0, 0), (69, 69), method='corridor').ok\n"
        "NetworkModel('edge')\n"
        "heavy = {'torch', 'onnx', 'onnxscript', 'rasterio', 'matplotlib', 'safetensors'}\n"
        "print(sorted(heavy & {name.partition('.')[0] for name in sys.modules}))\n"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from click.testing import CliRunner\n"
        "from nnpp_edge.cli.main import cli\n"
        "assert CliRunner().invoke(cli, ['--help']).exit_code == 0\n"
        "heavy = {'numpy', 'numba', 'onnxruntime', 'cv2', 'rich', 'torch', 'onnx', 'rasterio', 'matplotlib'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["costmap", "plan", "dataset", "train", "export", "quantize", "evaluate"])
def test_every_command_has_help_without_heavy_imports(name):
    code = (
        "import sys\n"
        "from click.testing import CliRunner\n"
        "from nnpp_edge.cli.main import cli\n"
        f"assert CliRunner().invoke(cli, ['{name}', '--help']).exit_code == 0\n"
        "heavy = {'numba', 'onnxruntime', 'torch', 'onnx', 'rasterio', 'matplotlib'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_the_onboard_install_asks_for_no_training_packages():
    needed = " ".join(PYPROJECT["project"]["dependencies"])
    assert not any(name in needed for name in ("torch", "onnx>", "onnxscript", "rasterio", "matplotlib"))


def test_no_module_imports_a_stage_by_its_bare_name():
    for path in ROOT.rglob("*.py"):
        if any(part.startswith(".venv") or part == "build" for part in path.parts):
            continue
        for line in path.read_text().splitlines():
            words = line.split()
            if words[:1] in (["import"], ["from"]) and len(words) > 1:
                assert words[1].partition(".")[0] not in STAGES, f"{path}: {line}"
