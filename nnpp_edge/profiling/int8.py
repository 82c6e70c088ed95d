"""An int8 model beside the fp32 model that it is made from: speed, agreement, and the outcome of
searches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from nnpp_edge.calibrate.quantize import Convolution, answers, int8_file, quantised_graph
from nnpp_edge.files import write_all
from nnpp_edge.model.registry import Spec
from nnpp_edge.profiling.inference import fp32_and_int8_ms
from nnpp_edge.runtime.arrays import Float32s
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Queries, read_known, read_recipe, read_samples
from nnpp_edge.training.unseen import Fit, KnownValidator
from nnpp_edge.training.validation import Judgement, Validator

Judge = Callable[[Float32s], Judgement | Fit]
HELD_OUT = 256
"""Queries to judge on, at most."""


@dataclass(frozen=True)
class Comparison:
    """Two models on the same held-out queries."""

    queries: int
    mean_difference: float
    """Of the probabilities."""
    max_difference: float
    fp32: Judgement | Fit
    """Outcome of searches in its regions, at the model's factor on the threshold; or errors of
    prices.
    """
    int8: Judgement | Fit
    fp32_ms: float
    """Median of one inference right after a plan."""
    int8_ms: float

    @property
    def added_gap(self) -> float:
        """Percentage points that int8 adds to the mean gap; 0 for prices."""
        return 100.0 * (getattr(self.int8, "gap", 0.0) - getattr(self.fp32, "gap", 0.0))


@dataclass(frozen=True)
class QuantizeReport:
    """The model made, and how it compares with the model that it was made from."""

    source: str
    output: str
    samples: int
    """Queries that it was calibrated on."""
    layers: tuple[Convolution, ...]
    """All convolutions but those in a branch, as of `edge`'s head; the largest error first."""
    fp32_bytes: int
    int8_bytes: int
    compared: Comparison

    def to_json(self) -> str:
        """One line of JSON; null for what has no number."""
        return msgspec.json.encode(self).decode()


def quantize(
    model: Path,
    dataset: Path,
    output: Path,
    *,
    validation: Path,
    samples: int = 200,
    exclude: Sequence[str] = (),
    seed: int = 1,
    card: Callable[[QuantizeReport], str] | None = None,
) -> QuantizeReport:
    """Make an int8 model (static, QDQ) of an fp32 file or a shipped model, and measure it against
    its source.

    The `output` is written last; beside it, in a file of its name with ``.md``, what `card` makes
    of the report: both or none. It is calibrated on so many `samples` of `dataset`, queries drawn
    at random, and judged on `validation`, whose maps the network was not trained on.

    The nodes in `exclude` stay float, and the head (the last convolution and what does not lead to
    it): it costs next to nothing, and its error would be that of the probabilities. The rest are
    measured choices (docs/decisions/papers-network.md).
    """
    if not output.parent.is_dir():
        raise OutputError(f"{output}: its folder does not exist")
    fp32 = NetworkModel(model)
    precision = fp32.metadata.precision
    if precision != "fp32":
        raise ModelError(f"{fp32.path}: wanted an fp32 model, got one of {precision}")
    if output.resolve() == fp32.path.resolve():
        raise InvalidQueryError(f"{output}: wanted another file than the fp32 model")
    calibration, held_out, judge = _data(fp32, dataset, validation, samples, seed)
    facts = {
        "samples": len(calibration),
        "seed": seed,
        "dataset_seed": read_recipe(dataset).seed,
        "excluded": list(exclude),
    }
    with TemporaryDirectory() as folder:
        made, layers = quantised_graph(fp32, calibration, Path(folder), exclude)
        path = Path(folder) / "int8.onnx"
        path.write_bytes(int8_file(made, fp32, facts))
        compared = compare(fp32, NetworkModel(path), held_out, judge)
    facts["agreement"] = {
        "queries": compared.queries,
        "mean_difference": compared.mean_difference,
        "max_difference": compared.max_difference,
    }
    content = int8_file(made, fp32, facts)
    report = QuantizeReport(
        source=str(fp32.path),
        output=str(output),
        samples=len(calibration),
        layers=layers,
        fp32_bytes=fp32.path.stat().st_size,
        int8_bytes=len(content),
        compared=compared,
    )
    contents = {output: content}
    if card is not None:
        contents[output.with_suffix(".md")] = f"{card(report)}\n".encode()
    write_all(contents)
    return report


def _data(
    fp32: NetworkModel,
    dataset: Path,
    validation: Path,
    samples: int,
    seed: int,
) -> tuple[Queries, Queries, Judge]:
    """Queries to calibrate on, queries to judge on, and their judge."""
    m = fp32.metadata
    if m.encoding == "unseen":
        calibration = KnownValidator(read_known(dataset), samples)
        known = KnownValidator(read_known(validation), HELD_OUT)
        return calibration.shown, known.shown, known.judge_answers
    pool = read_samples(dataset, most_maps=2 * samples, size=m.input_size)
    order = np.random.default_rng([seed, 1]).permutation(len(pool))
    spec = Spec(m.architecture, m.input_size, m.sigma)
    # searched on the maps as they are held, as in training
    validator = Validator(read_samples(validation), spec, m.omega, HELD_OUT)

    return (
        pool.pick(order[:samples]),
        validator.shown,
        lambda answers: validator.judge_answers(answers, m.region_factor),
    )


def compare(fp32: NetworkModel, int8: NetworkModel, queries: Queries, judge: Judge) -> Comparison:
    """Compare two models on the queries, and time both."""
    exact = answers(fp32, queries)
    rounded = answers(int8, queries)
    difference = np.abs(exact - rounded)
    return Comparison(
        len(queries),
        float(difference.mean()),
        float(difference.max()),
        judge(exact),
        judge(rounded),
        *fp32_and_int8_ms(str(fp32.path), str(int8.path)),
    )
