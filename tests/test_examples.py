"""Examples in docstrings and in the README do what they say."""

import doctest
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("runtime", "export", "calibrate", "nnpp_edge")


def modules_with_examples():
    """Names of the modules whose source holds a doctest."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if ">>> " in path.read_text():
                parts = path.relative_to(ROOT).with_suffix("").parts
                name = ".".join(parts if folder == "nnpp_edge" else ("nnpp_edge", *parts))
                yield name.removesuffix(".__init__")


MODULES = list(modules_with_examples())


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_are_true(name):
    result = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert result.attempted and not result.failed


def test_the_public_api_has_examples():
    planners = {f"nnpp_edge.runtime.planners.{name}" for name in ("planner", "dynamic")}
    assert planners <= set(MODULES)


def test_python_in_the_readme_runs():
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    row, col = np.mgrid[0:512, 0:512]
    exec(code, {"dem": np.sin(row / 40.0) * np.cos(col / 50.0)})
