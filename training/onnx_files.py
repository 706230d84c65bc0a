"""Writing ONNX files: export from PyTorch, fp16 storage of weights, and the sessions used to check them."""

import hashlib
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import torch
from onnx import helper, numpy_helper

OPSET = 18
MODELS_DIR = Path(__file__).resolve().parent.parent / "app" / "models"
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SMALLEST_FP16_WEIGHT = 3000  # smaller ones save nothing, and rounding biases and the codebook costs accuracy


def export(
    module: torch.nn.Module,
    example: torch.Tensor,
    outputs: list[str],
    dynamic: dict[int, torch.export.Dim],
) -> onnx.ModelProto:
    """The ONNX model of `module`, with one input called `image` and the given dynamic axes of it."""
    program = torch.onnx.export(
        module.eval(),
        (example,),
        input_names=["image"],
        output_names=outputs,
        opset_version=OPSET,
        dynamic_shapes=(dynamic,),
        verbose=False,
    )
    model = program.model_proto
    _forget_source_code(model)
    return model


def _forget_source_code(model: onnx.ModelProto) -> None:
    """Drop stack traces and intermediate shapes, which name files of this machine and vary between runs."""
    for node in model.graph.node:
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    for value in (*model.graph.input, *model.graph.output, *model.graph.initializer):
        value.ClearField("metadata_props")
        value.ClearField("doc_string")
    model.graph.ClearField("value_info")
    model.graph.ClearField("metadata_props")
    model.ClearField("functions")


def with_fp16_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy whose float32 weights are stored as fp16, each followed by a Cast back to float32.

    ONNX Runtime folds the casts when a session is made, so all arithmetic stays in float32.
    """
    copy = onnx.ModelProto.FromString(model.SerializeToString())
    graph = copy.graph
    casts: list[onnx.NodeProto] = []
    for tensor in graph.initializer:
        weights = numpy_helper.to_array(tensor)
        if weights.dtype != np.float32 or weights.size < SMALLEST_FP16_WEIGHT:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(weights.astype(np.float16), f"{name}.fp16"))
        casts.append(helper.make_node("Cast", [tensor.name], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
    return copy


def save(model: onnx.ModelProto, path: Path, metadata: dict[str, str]) -> None:
    """Check the model, write it to `path`, and print its size and SHA-256."""
    helper.set_model_props(model, metadata)
    model.producer_name = "roomfix training"
    onnx.checker.check_model(model, full_check=True)
    path.write_bytes(model.SerializeToString(deterministic=True))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    print(f"{path.name}: {path.stat().st_size:,} bytes, sha256 {digest}")


def session(model: onnx.ModelProto | Path) -> ort.InferenceSession:
    """A CPU session with one thread, as the application makes it."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    content = model.read_bytes() if isinstance(model, Path) else model.SerializeToString()
    return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def median_ms(call: Callable[[], object], repeats: int = 30) -> float:
    """Median wall time of `call` in milliseconds, after three calls to warm up."""
    times = []
    for _ in range(repeats + 3):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times[3:])
