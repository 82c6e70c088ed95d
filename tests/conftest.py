"""What several tests share: a tiny network, and the command line run in this process."""

import json
import os
import sys
import warnings
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, settings

# networks and maps this small lose more by threads of libraries than they gain
os.environ["OMP_NUM_THREADS"] = "1"
LONGEST_FILES = (
    "test_warmup.py",
    "test_training.py",
    "test_experiments.py",
    "test_quantize.py",
    "test_gallery.py",
    "test_dataset.py",
    "test_run.py",
    "test_profile.py",
    "test_main.py",
)
SLOW_FOLDERS = ("reproduction", "training")
SLOW_FILES = (
    "test_dataset.py",
    "test_kernel_cache.py",
    "test_run.py",
    "test_warmup.py",
)
TINY_SIDE = 64
settings.register_profile(
    "tests", deadline=None, max_examples=50, suppress_health_check=list(HealthCheck)
)
settings.load_profile("tests")


def is_slow(path):
    """Whether all tests of a file take long, or need what takes long to import."""
    return path.parent.name in SLOW_FOLDERS or path.name in SLOW_FILES


def pytest_ignore_collect(collection_path, config):
    """Leave slow files unread where slow tests are left out: reading them imports torch."""
    return True if config.option.markexpr == "not slow" and is_slow(collection_path) else None


def pytest_collection_modifyitems(items):
    """Mark what is slow as a whole; files that take longest come first, so that two processes end
    together.
    """
    order = {name: at for at, name in enumerate(LONGEST_FILES)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))
    for item in items:
        if is_slow(item.path):
            item.add_marker(pytest.mark.slow)


TINY_MODEL = """<ir_version: 10, opset_import: ["" : 18]>
tiny (float[1, 3, 64, 64] input) => (float[1, 1, 8, 8] probability)
<float least = {1e-30}, float minus = {-512}, float slope = {-4}, float half = {0.5}, float one = {1},
 int64[3] axes = {1, 2, 3}, int64[2] parts = {1, 2}, int64[1] channel = {1}>
{
    cost, gaussians = Split <axis = 1> (input, parts)
    positive = Max (gaussians, least)
    logarithms = Log (positive)
    squares = Mul (logarithms, minus)
    distances = Sqrt (squares)
    by_way = ReduceSum (distances, channel)
    apart = ReduceMin (by_way, axes)
    detour = Sub (by_way, apart)
    unit = Max (apart, one)
    share = Div (detour, unit)
    exponent = Mul (share, slope)
    nearness = Exp (exponent)
    malus = Mul (cost, half)
    ease = Sub (one, malus)
    fine = Mul (nearness, ease)
    probability = AveragePool <kernel_shape = [8, 8], strides = [8, 8]> (fine)
}"""
"""From the distances to start and to goal, read off Gaussians of a quarter of the map."""


def write_tiny_model(path, text=TINY_MODEL, **changes):
    """An ONNX model of the paper's kind without a single weight to train; `changes` go to its
    metadata.

    Its probability is high on the straight line between start and goal and falls off to the sides,
    and it is lower where the map is costly.
    """
    from onnx import checker, helper, parser, save

    from nnpp_edge.runtime.network.model_file import METADATA_KEY, ModelMetadata

    model = parser.parse_model(text)
    if text == TINY_MODEL:
        checker.check_model(model)
    metadata = {
        "name": "tiny",
        "architecture": "nnpp",
        "input_size": TINY_SIDE,
        "blocks": TINY_SIDE // 8,
        "encoding": "gaussian",
        "channels": ("cost", "start_map", "goal_map"),
        "sigma": 0.25,
        "omega": 0.011,
        "cost_limits": {},
        "version": "0",
    }
    helper.set_model_props(
        model, {METADATA_KEY: ModelMetadata(**{**metadata, **changes}).to_json()}
    )
    save(model, path)
    return path


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory):
    """A network that runs in microseconds; its region is a spindle around the straight line."""
    return write_tiny_model(tmp_path_factory.mktemp("model") / "tiny.onnx")


@pytest.fixture
def make_tiny_model(tmp_path):
    """Write the tiny network with metadata, or a graph's text, of one's own."""
    return lambda **changes: write_tiny_model(tmp_path / "changed.onnx", **changes)


@pytest.fixture
def write_toml(tmp_path):
    """Write mine.toml."""

    def write(text):
        (tmp_path / "mine.toml").write_text(text)
        return tmp_path / "mine.toml"

    return write


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        """What it printed for programs."""
        return json.loads(self.out)

    def refused(self, *words):
        """Exit code 2; on stderr warnings at most, then one line with the error and every one of
        `words`.
        """
        assert self.code == 2
        *warned, last = self.err.splitlines()
        assert last.startswith("error: ") and all(
            line.startswith("warning: ") for line in warned
        ), self.err
        for word in words:
            assert word in self.err


@pytest.fixture
def nnpp_edge(monkeypatch, capsys):
    """Run `nnpp-edge` with the given words, as the shell would; exit code, stdout and stderr."""
    from nnpp_edge.cli.main import main

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["nnpp-edge", *map(str, words)])
        capsys.readouterr()
        code = 0
        with warnings.catch_warnings():  # main replaces how they are shown
            warnings.simplefilter("default")  # a user's Python shows them; in tests they are errors
            try:
                main()
            except SystemExit as ended:
                code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        out, err = capsys.readouterr()
        return Ended(code, out, err)

    return run
