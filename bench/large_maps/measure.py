"""What a map costs: opening, a query, memory, and how many of the nearest keyframes its index finds."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.maps.vision_models import VisionModels
from app.engine.query.camera_sources import query_camera
from app.engine.query.localizer import Localizer
from app.storage.map_files import open_index
from app.vision.images import decode_image
from app.vision.index import GlobalIndex

WANTED = 10
# A query's descriptor differs from the nearest keyframe's by so much: 1 is the length of a descriptor.
QUERY_NOISE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """The figures of one map. Queries are in milliseconds of the processor, which other programs change little.

    `query_ms` and `retrieve_ms` are medians. `own_mb` is memory that no other process can share.
    """

    keyframes: int
    file_mb: float
    open_s: float
    first_query_ms: float
    query_ms: float
    retrieve_ms: float
    located: int
    queries: int
    own_mb: float
    mapped_mb: float
    recall: float


def measure(artifact_path: Path, index_path: Path, images: Sequence[bytes], descriptors: Path) -> Cost:
    """Open a tiled map in this process and ask it for pictures, as a server does."""
    models = VisionModels()
    models.extractor("sift").extract(np.zeros((64, 64), np.uint8))
    models.global_descriptor.describe(np.zeros((64, 64, 3), np.uint8))
    before_mb = memory_mb("RssAnon")
    began = time.perf_counter()
    artifact = MapArtifact.open(artifact_path)
    index = open_index(artifact, index_path)
    # As the server does, to read the short codes once.
    index.search(index.descriptor(0), 1)
    opened = OpenMap.of(artifact, index, models)
    open_s = time.perf_counter() - began
    localizer = Localizer(opened)
    taken, retrieving, located = [], [], 0
    for _ in range(2):
        for image in images:
            began = time.process_time()
            rgb = decode_image(image)
            found = localizer.localize(rgb, query_camera(None, rgb, image).camera)
            taken.append(1e3 * (time.process_time() - began))
            retrieving.append(found.timings_ms["retrieve"])
            located += found.world_from_camera is not None
    own_mb, mapped_mb = memory_mb("RssAnon") - before_mb, memory_mb("RssFile")
    rows = np.memmap(descriptors, np.float32, "r").reshape(len(index), -1)
    return Cost(
        keyframes=len(index),
        file_mb=(artifact_path.stat().st_size + index_path.stat().st_size) / 1e6,
        open_s=open_s,
        first_query_ms=taken[0],
        # The second round: models, code and pages are warm in all maps alike.
        query_ms=float(np.median(taken[len(images) :])),
        retrieve_ms=float(np.median(retrieving[len(images) :])),
        located=located // 2,
        queries=len(images),
        own_mb=own_mb,
        mapped_mb=mapped_mb,
        recall=recall(index, rows),
    )


def memory_mb(kind: str) -> float:
    """Return this process's memory by a name of /proc/self/status, such as `RssAnon`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{kind}:"):
            return int(line.split()[1]) / 1e3
    return 0.0


def recall(index: GlobalIndex, descriptors: NDArray[np.float32], count: int = 100) -> float:
    """Return the share of the ten nearest keyframes, by exact search, that the index finds for noisy descriptors."""
    rng = np.random.default_rng(1)
    queries = descriptors[np.sort(rng.choice(len(descriptors), min(count, len(descriptors)), replace=False))]
    noise = rng.normal(size=queries.shape) * QUERY_NOISE / np.sqrt(queries.shape[1])
    queries = queries + noise.astype(np.float32)
    best = np.full((len(queries), 0), 0.0, np.float32)
    rows = np.zeros((len(queries), 0), np.int64)
    for start in range(0, len(descriptors), 4096):
        part = np.asarray(descriptors[start : start + 4096])
        squared = np.einsum("ij,ij->i", part, part)[None] - 2.0 * queries @ part.T
        best = np.concatenate([best, squared], axis=1)
        rows = np.concatenate([rows, np.tile(np.arange(start, start + len(part)), (len(queries), 1))], axis=1)
        order = np.argsort(best, axis=1, kind="stable")[:, :WANTED]
        best, rows = np.take_along_axis(best, order, 1), np.take_along_axis(rows, order, 1)
    found = [
        len(set(index.search(query, WANTED)[0].tolist()) & set(exact.tolist()))
        for query, exact in zip(queries, rows, strict=True)
    ]
    return float(np.sum(found)) / rows.size
