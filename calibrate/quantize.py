"""An int8 model from an fp32 one, and whether it pays on this machine."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import onnx
import onnxruntime as ort

from nnpp_edge import __version__
from nnpp_edge.calibrate.calibration_set import probabilities, split, spread
from nnpp_edge.calibrate.compare import (
    Agreement,
    Latency,
    Searches,
    agreement,
    judge_both,
    latencies,
    operators_left,
    recommend,
)
from nnpp_edge.calibrate.quantizer import METHODS, Quantizer, with_facts
from nnpp_edge.calibrate.sensitivity import exclude_worst, node_errors
from nnpp_edge.files import temporary_folder, write_whole
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Samples, read_recipe, read_samples

AUTO = "auto"
TARGET = 0.005
"""Mean difference of the probabilities that ``exclude="auto"`` aims for: about one of the region's 256 levels."""
HELD_OUT = 256
"""Queries to judge on, at most, by agreement and by search."""
ROUNDS = 300
"""Timed runs of each model."""
_FEW = 16
"""Queries to rank the nodes on."""


@dataclass(frozen=True)
class QuantizeReport:
    """What was made, and how it compares with the model that it was made from."""

    source: str
    output: str
    samples: int
    method: str
    reduce_range: bool
    excluded: tuple[str, ...]
    """Convolutions left float, except those of the head."""
    quantised: int
    """Convolutions in int8."""
    fp32_bytes: int
    int8_bytes: int
    fp32_latency: Latency
    int8_latency: Latency
    speed_up: float
    """Ratio of the medians."""
    agreement: Agreement
    qdq_left: int
    """QuantizeLinear and DequantizeLinear nodes after onnxruntime's optimisation on this machine."""
    operators: dict[str, int]
    """All nodes after it, by kind."""
    region_factor: float
    searches: Searches
    """Over held-out queries."""
    node_snr_db: dict[str, float]
    """Signal-to-noise ratio when one node alone is int8, the worst first; empty if it was not needed."""
    recommendation: str

    def to_json(self) -> str:
        """One line of JSON; null for what has no number."""
        return msgspec.json.encode(self).decode()


def quantize(
    model: Path,
    dataset: Path,
    output: Path,
    *,
    validation: Path | None = None,
    samples: int = 200,
    method: str = "minmax",
    exclude: Sequence[str] | str = AUTO,
    reduce_range: bool = True,
    rank: bool = False,
    seed: int = 1,
    rounds: int = ROUNDS,
) -> QuantizeReport:
    """Make an int8 model (static, QDQ), and measure it against its source.

    Parameters
    ----------
    model : Path
        In fp32, from `nnpp-edge export`; or the name of a shipped model.
    dataset : Path
        Data set to calibrate on.
    output : Path
        The int8 file; written last, whole or not at all, whatever the recommendation.
    validation : Path, optional
        Data set to judge on; without, a quarter of `dataset`'s maps is held out.
    samples : int
        Queries to calibrate on, each from another map while there are maps.
    method : str
        ``minmax``, ``percentile`` (99.999) or ``entropy``: how ranges are chosen.
    exclude : names or ``auto``
        Nodes to leave float. ``auto`` leaves the worst ones float until the mean difference of the
        probabilities is at most `TARGET`; usually that is none.
    reduce_range : bool
        Weights of 7 bits, right on every CPU. 8 bits are for those with VNNI or on ARM.
    rank : bool
        Tell how sensitive each node is even if ``auto`` does not need to know.
    seed, rounds : int
        Of the choice of queries; timed runs of each model.

    Raises
    ------
    ModelError
        The model is none of ours, is int8 already, or has no node of a name in `exclude`.
    DataSetError
        A data set is none, or its maps have another size.
    InvalidQueryError
        There is no such method, or `output` is the model itself.
    OutputError
        The file cannot be written.

    Notes
    -----
    The defaults are measured ones. The edge network on a CPU with AVX2 and without VNNI, mean and largest
    difference of the probabilities and time over that of fp32:

    - as it is: 0.0008, 0.07, 0.62
    - weights of 8 bits, which saturate there: 0.0014, 0.17, 0.62
    - a scale for each tensor in place of each channel: 0.0029, 0.26, 0.61
    - uint8 weights: 0.0007, 0.05, 0.80
    - int8 activations, which leave 79 QDQ nodes behind: 0.0008, 0.07, 1.03

    Percentile and entropy come to the same mean; their largest difference is 1.3 and 1.7 times that of minmax.
    """
    if method not in METHODS:
        raise InvalidQueryError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if not output.parent.is_dir():
        raise OutputError(f"{output}: its folder does not exist")
    fp32 = NetworkModel(model)
    fp32_bytes = fp32.path.stat().st_size
    if output.resolve() == fp32.path.resolve():
        raise InvalidQueryError(f"{output}: wanted another file than the fp32 model")
    calibration, held_out = _queries(dataset, validation, samples, seed, fp32.metadata.input_size)
    with temporary_folder() as folder:
        quantizer = Quantizer(fp32, folder)
        quantizer.calibrate(calibration, method)
        few = spread(calibration, _FEW, seed)
        ranking = node_errors(quantizer, few, reduce_range=reduce_range) if rank else {}
        if exclude == AUTO:
            excluded, ranking = exclude_worst(quantizer, few, TARGET, reduce_range=reduce_range, errors=ranking)
        else:
            excluded = (exclude,) if isinstance(exclude, str) else tuple(exclude)
        facts: dict[str, object] = {
            "samples": len(calibration),
            "method": method,
            "seed": seed,
            "dataset_seed": read_recipe(dataset).seed,
            "reduce_range": reduce_range,
            "excluded": list(excluded),
            "versions": {"nnpp_edge": __version__, "onnxruntime": ort.__version__, "onnx": onnx.__version__},
        }
        path = quantizer.build("int8", exclude=excluded, reduce_range=reduce_range, facts=facts)
        int8 = NetworkModel(path)
        some = spread(held_out, HELD_OUT, seed)
        agreed = agreement(probabilities(fp32, some), probabilities(int8, some), some, fp32.metadata.region_factor)
        searches = judge_both(fp32, int8, held_out, HELD_OUT)
        fp32_latency, int8_latency = latencies(fp32, int8, some, rounds)
        left = operators_left(path)
        content = with_facts(path, {"agreement": asdict(agreed)})
        write_whole(output, content)
    return QuantizeReport(
        source=str(fp32.path),
        output=str(output),
        samples=len(calibration),
        method=method,
        reduce_range=reduce_range,
        excluded=excluded,
        quantised=sum(count for kind, count in left.items() if kind in ("QLinearConv", "ConvInteger")),
        fp32_bytes=fp32_bytes,
        int8_bytes=len(content),
        fp32_latency=fp32_latency,
        int8_latency=int8_latency,
        speed_up=fp32_latency.median_ms / int8_latency.median_ms,
        agreement=agreed,
        qdq_left=left["QuantizeLinear"] + left["DequantizeLinear"],
        operators=dict(left.most_common()),
        region_factor=fp32.metadata.region_factor,
        searches=searches,
        node_snr_db=ranking,
        recommendation=recommend(fp32_latency, int8_latency, searches),
    )


def _queries(dataset: Path, validation: Path | None, count: int, seed: int, size: int) -> tuple[Samples, Samples]:
    """Queries to calibrate on and queries to judge on, from different maps."""
    pool = read_samples(dataset, most_maps=2 * count, size=size)
    calibration, held_out = (pool, read_samples(validation, size=size)) if validation else split(pool, seed)
    return spread(calibration, count, seed), held_out
