"""What a contributor is given: the workflow, forms, bounds and citation, held to what is there."""

import dataclasses
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from nnpp_edge.runtime import options

ROOT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MAKEFILE = (ROOT / "Makefile").read_text()
TARGETS = set(re.findall(r"^([a-z][\w-]*):", MAKEFILE, re.MULTILINE))
RELEASE = ROOT / ".github/workflows/release.yml"
OLDEST = ROOT / ".ci" / "oldest.txt"
yaml = pytest.importorskip("yaml")


@pytest.fixture(scope="module")
def jobs():
    return yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]


def test_every_step_of_the_workflow_is_a_target_of_the_makefile(jobs):
    named = set()
    for job in jobs.values():
        for line in (step["run"] for step in job["steps"] if "run" in step):
            make = r'(?:sudo env "PATH=\$PATH" )?make'
            target = re.fullmatch(
                make + r" (\S+|\$\{\{ matrix\.target \}\}) PYTHON=python( PYTHONS=python)?", line
            )
            assert target, line
            several = "$" in target[1] and {
                each["target"] for each in job["strategy"]["matrix"]["include"]
            }
            named |= several or {target[1]}
    named |= set(re.findall(r"- run: make (\S+)", RELEASE.read_text()))
    assert (
        named <= TARGETS
        and {"test", "coverage", "try-wheel", "try-oldest", "try-aarch64", "docs"} <= named
        and {"release", "try-release"} <= named
    )


def test_the_workflow_tries_every_python_that_the_package_names(jobs):
    classifiers = " ".join(PYPROJECT["project"]["classifiers"])
    named = re.findall(r"Python :: (3\.\d+)", classifiers)
    assert jobs["test"]["strategy"]["matrix"]["python"] == named
    assert PYPROJECT["project"]["requires-python"] == f">={named[0]}"
    runners = jobs["test"]["strategy"]["matrix"]["runner"]
    assert any("arm" in runner for runner in runners) and any(
        "arm" not in runner for runner in runners
    )


def test_the_oldest_packages_that_are_tried_are_those_that_are_named():
    wanted = {}
    for requirement in PYPROJECT["project"]["dependencies"]:
        name, least = re.match(r"([\w-]+)>=([\d.]+)", requirement).groups()
        wanted[name] = least
    tried = dict(
        line.split("==") for line in OLDEST.read_text().splitlines() if not line.startswith("#")
    )
    assert set(tried) == set(wanted)
    for name, version in tried.items():
        least, given = ([int(part) for part in text.split(".")] for text in (wanted[name], version))
        assert given[: len(least)] == least and not any(given[len(least) : 2]), (
            f"{version} for {name} {least}"
        )


def test_paths_in_the_guide_are_there_and_its_targets_too():
    text = "\n".join(
        (ROOT / name).read_text() for name in ("CONTRIBUTING.md", "SECURITY.md", "docs/boards.md")
    )
    for path in re.findall(r"`((?:runtime|nnpp_edge|tests|docs)/[\w/.]+)`", text):
        assert (ROOT / path.replace("NAME", "fig12")).exists(), path
    for target in re.findall(r"(?:^|`)(?:PYTHON=\S+ )?make ([a-z][\w-]*)", text, re.MULTILINE):
        assert target in TARGETS, target
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", text):
        assert (ROOT / link).exists() or (ROOT / "docs" / link).exists(), link


def test_names_in_the_guide_are_in_the_code():
    folders = [ROOT / name for name in ("runtime", "export", "calibrate", "nnpp_edge", "tests")]
    code = MAKEFILE + "".join(
        path.read_text() for folder in folders for path in folder.rglob("*.py")
    )
    named = re.findall(r"`([A-Za-z_]\w+)`", (ROOT / "CONTRIBUTING.md").read_text())
    assert len(named) > 20 and {name for name in named if name not in code} <= {"period_ms"}


def test_every_choice_by_name_is_there_and_documented():
    from nnpp_edge import runtime
    from nnpp_edge.runtime.robots.slope.cost import SLOPE_COSTS

    fields = {field.name for field in dataclasses.fields(runtime.Mobility)}
    table = (ROOT / "docs/step-costs.md").read_text().partition("| `--step-cost` |")[2]
    documented = set(re.findall(r"^\| `(\w+)` \|", table.partition("\n\n")[0], re.MULTILINE))
    assert set(SLOPE_COSTS) == fields == documented == set(options.STEP_COSTS) - {"paper"}
    assert all(hasattr(runtime, kind.__name__) for kind in SLOPE_COSTS.values())
    assert all(kind.unit == "s" for kind in SLOPE_COSTS.values() if kind.function)
    assert set(runtime.Method) == set(options.STILL)
    assert set(runtime.DynamicMethod) == set(options.METHODS)


def test_the_version_stands_in_one_place_and_the_changelog_has_its_section():
    from nnpp_edge import __version__

    assert "version" in PYPROJECT["project"]["dynamic"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["license"] == "Apache-2.0" and not {"version", "date-released"} & set(cited)
    heads = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert heads[0] == "[Unreleased]"
    assert any(head.startswith(f"[{__version__}] - ") for head in heads)
    kinds = set(re.findall(r"^### (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_a_release_is_of_a_commit_and_its_tag_of_the_version(tmp_path):
    from nnpp_edge import __version__

    subprocess.run(["git", "clone", "--quiet", "--depth=1", f"file://{ROOT}", tmp_path], check=True)
    make = (".ci/release", sys.executable, "v9.9.9")
    for change, problem in (
        ("", f"wanted the tag v{__version__}, got v9.9.9\n"),
        ("more", "a release is made of a commit: wanted no changes, got CITATION.cff \n"),
    ):
        with (tmp_path / "CITATION.cff").open("a") as file:
            file.write(change)
        ended = subprocess.run(make, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        assert (ended.returncode, ended.stderr) == (2, problem)
