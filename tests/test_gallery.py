"""Every example runs, is short, and says what it shows, how long it takes and whose data
it uses.
"""

import ast
import re
import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py") if path.stem != "drawing")
MOST_LINES = 70


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_what_it_is(path):
    text = path.read_text()
    listed = (ROOT / "examples/README.md").read_text()
    words = ast.get_docstring(ast.parse(text))
    assert len(text.splitlines()) < MOST_LINES
    assert re.search(r"^Run time: .*\d+ (s|min)", words, re.MULTILINE) and re.search(
        r"^Data: ", words, re.MULTILINE
    )
    assert f"[{path.name}]({path.name})" in listed
    assert (ROOT / f"docs/gallery/{path.stem}.webp").stat().st_size < 500_000


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_draws(path, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.syspath_prepend(path.parent)
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    runpy.run_path(str(path))
    with Image.open(tmp_path / f"{path.stem}.webp") as image:
        assert min(image.size) > 100 and len(set(image.convert("L").resize((64, 64)).tobytes())) > 8
