"""An fp32 model, calibrated once, from which int8 variants are built."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import onnx
from onnxruntime import quantization
from onnxruntime.quantization import CalibrationMethod, QDQQuantizer, QuantType
from onnxruntime.quantization.calibrate import TensorsData

from nnpp_edge.calibrate.calibration_set import QueryReader
from nnpp_edge.export.optional_head import nodes_leading_to
from nnpp_edge.export.quiet import quiet
from nnpp_edge.runtime.errors import DataSetError, ModelError
from nnpp_edge.runtime.network.inference import METADATA_KEY, ModelMetadata, NetworkModel
from nnpp_edge.terrain.dataset import Samples

METHODS = {
    "minmax": (CalibrationMethod.MinMax, {}),
    "percentile": (CalibrationMethod.Percentile, {"symmetric": False, "percentile": 99.999}),
    "entropy": (CalibrationMethod.Entropy, {"symmetric": False}),
}
"""Ways to choose the range of each tensor."""

OPERATORS = ("Conv", "Relu", "Add", "Resize", "Concat", "AveragePool", "MaxPool")
"""Kinds of nodes that have an int8 kernel on CPUs, so that their QDQ pairs disappear."""

_AT_ONCE = 8
"""Queries whose activations the histogram methods hold in memory together."""


class Quantizer:
    """Static quantisation in QDQ form: uint8 activations, int8 weights with a scale for each channel.

    The `folder` is for the files in between.

    Raises
    ------
    ModelError
        The model is not fp32.

    Notes
    -----
    The head (the last convolution and what does not lead to it) stays float: it costs next to nothing, and
    its error would be that of the probabilities.
    """

    def __init__(self, model: NetworkModel, folder: Path) -> None:
        if model.metadata.precision != "fp32":
            raise ModelError(f"{model.path}: wanted an fp32 model, got one of {model.metadata.precision}")
        self.model, self.folder = model, folder
        self.prepared = _prepare(model.path, folder / "prepared.onnx")
        self.ranges: TensorsData | None = None
        graph = onnx.load(self.prepared).graph
        self.head = _head(graph)
        self.nodes = tuple(n.name for n in graph.node if n.op_type == "Conv" and n.name not in self.head)
        """The convolutions that can be quantised."""
        self._relus = {n.input[0]: n.name for n in graph.node if n.op_type == "Relu"}
        self._outputs = {n.name: n.output[0] for n in graph.node}

    def calibrate(self, samples: Samples, method: str = "minmax") -> None:
        """Run the fp32 model on all queries of `samples` and choose each tensor's range."""
        if samples.planes.shape[-1] != self.model.metadata.input_size:
            size = self.model.metadata.input_size
            raise DataSetError(f"wanted maps of {size} × {size} cells, got {samples.planes.shape[-1]}")
        kind, settings = METHODS[method]
        with quiet():
            calibrator = quantization.create_calibrator(
                self.prepared, list(OPERATORS), str(self.folder / "augmented.onnx"), kind, extra_options=settings
            )
            for at in range(0, len(samples), _AT_ONCE):
                part = samples.pick(range(at, min(at + _AT_ONCE, len(samples))))
                calibrator.collect_data(QueryReader(self.model, part))
            self.ranges = calibrator.compute_data()

    def build(
        self,
        name: str,
        *,
        exclude: Sequence[str] = (),
        only: str | None = None,
        reduce_range: bool = True,
        facts: Mapping[str, object] | None = None,
    ) -> Path:
        """Write an int8 variant into the folder.

        Parameters
        ----------
        name : str
            Of the file, without its ending.
        exclude : names
            Nodes to leave float, as the head is in any case.
        only : str, optional
            The one convolution to quantise, with the ReLU after it.
        reduce_range : bool
            Weights of 7 bits. On x86 CPUs without VNNI, sums of two products of 8 bits overflow 16 bits and
            saturate; with 7 they cannot.
        facts : mapping
            On the calibration, for the metadata.

        Raises
        ------
        ModelError
            `exclude` names a node that is not there.
        """
        unknown = set(exclude) - set(self._outputs)
        if unknown:
            raise ModelError(f"wanted nodes out of {', '.join(self.nodes)}, got {', '.join(sorted(unknown))}")
        chosen = [only, self._relus.get(self._outputs[only], only)] if only else []
        with quiet():
            quantizer = QDQQuantizer(
                onnx.load(self.prepared),
                per_channel=True,
                reduce_range=reduce_range,
                tensors_range=self.ranges,
                op_types_to_quantize=list(OPERATORS),
                extra_options={},
                weight_qType=QuantType.QInt8,
                activation_qType=QuantType.QUInt8,
                nodes_to_quantize=chosen,
                nodes_to_exclude=[*self.head, *exclude],
            )
            quantizer.quantize_model()
            quantizer.model.topological_sort()
        built = quantizer.model.model
        built.graph.node.sort(key=lambda node: node.op_type == "If")  # the sort overlooks what branches read
        training = self.model.metadata.training | ({"calibration": dict(facts)} if facts else {})
        metadata = replace(self.model.metadata, precision="int8", training=training)
        path = self.folder / f"{name}.onnx"
        path.write_bytes(_finish(built, metadata))
        return path


def with_facts(path: Path, facts: Mapping[str, object]) -> bytes:
    """A built model with more facts on its calibration."""
    model = onnx.load(path)
    stored = {p.key: p.value for p in model.metadata_props}.get(METADATA_KEY)
    metadata = ModelMetadata.from_json(stored, str(path))
    known = metadata.training.get("calibration")
    calibration = {**(known if isinstance(known, dict) else {}), **facts}
    return _finish(model, replace(metadata, training=metadata.training | {"calibration": calibration}))


def _finish(model: onnx.ModelProto, metadata: ModelMetadata) -> bytes:
    """Our metadata, no operator sets but those in use, and a check."""
    onnx.helper.set_model_props(model, {METADATA_KEY: metadata.to_json()})
    used = {node.domain for node in model.graph.node}
    versions = [o for o in model.opset_import if o.domain in used or (o.domain == "ai.onnx" and "" in used)]
    del model.opset_import[:]
    model.opset_import.extend(versions)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _prepare(source: Path, target: Path) -> Path:
    """Shapes of all tensors, and onnxruntime's basic fusions."""
    with quiet():
        try:
            quantization.quant_pre_process(source, target)
        except Exception:  # it cannot follow ReduceMax over axes given as an input; plain inference can
            quantization.quant_pre_process(source, target, skip_symbolic_shape=True)
    return target


def _head(graph: onnx.GraphProto) -> tuple[str, ...]:
    """Names of the last convolution and of all nodes that do not lead to it."""
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    if not convolutions:
        raise ModelError("wanted a network with convolutions, got one without")
    before = nodes_leading_to(convolutions[-1].input, graph)
    return tuple(node.name for node in graph.node if node.name not in before)
