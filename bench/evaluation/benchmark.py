"""Where the time of a located query goes: one thread, medians by stage, and the bare kernels for comparison."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import BuildOptions
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.geometry.camera import Camera
from app.geometry.estimators.chosen import ESTIMATORS
from app.vision.images import Rgb, decode_image, shrink, to_gray
from app.vision.local_features import SIFT_FEATURES, SIFT_SIDE_PX
from app.vision.matching import to_unit_vectors
from bench.baselines.plain import PlainPipeline
from bench.evaluation.dataset import Split
from bench.evaluation.run import median_stages


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """Medians in milliseconds on one thread. `kernels_ms` are the bare library calls of the same query, one by
    one; `plain_sift_ms` is the plain pipeline `sift` (`bench/baselines/plain.py`) in the same run, query by query."""

    queries: int
    located: int
    decode_ms: float
    stages_ms: dict[str, float]
    total_ms: float
    kernels_ms: dict[str, float]
    kernels_sum_ms: float
    plain_sift_ms: float | None
    plain_sift_located: int | None
    ratio: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def run_benchmark(
    split: Split,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    repeats: int = 3,
    compare: bool = False,
) -> Benchmark:
    """Build the map, then time every query `repeats` times, taking each query's median."""
    built = build_map(split.database, options, models, executor, progress)
    localizer = Localizer.of(built.artifact, built.index, models)
    plain = (
        PlainPipeline("sift", split.database, built.keyframes, built.world_from_scan, models)
        if compare
        else None
    )
    camera = split.database.camera
    results, totals, plain_totals, decodes = [], [], [], []
    kernels: dict[str, list[float]] = {}
    plain_located = 0
    for done, frame in enumerate(split.queries):
        progress.report("benchmark", done, len(split.queries))
        data = split.database.color_bytes(frame)
        decode_ms, rgb = _timed(lambda data=data: decode_image(data), repeats)  # type: ignore[misc]
        total_ms, found = _timed(lambda rgb=rgb: localizer.localize(rgb, camera), repeats)  # type: ignore[misc]
        if plain is not None:
            plain_ms, pose = _timed(lambda rgb=rgb: plain.localize(rgb, camera), repeats)  # type: ignore[misc]
            plain_located += pose is not None
            plain_totals.append(plain_ms)
        if found.world_from_camera is None:
            continue
        results.append(found)
        totals.append(total_ms)
        decodes.append(decode_ms)
        for name, milliseconds in _kernels(
            localizer, models, rgb, camera, len(found.keyframes), repeats
        ).items():
            kernels.setdefault(name, []).append(milliseconds)
    progress.report("benchmark", len(split.queries), len(split.queries))
    medians = {name: round(float(np.median(values)), 2) for name, values in kernels.items()}
    total = round(float(np.median(totals)), 2) if totals else float("nan")
    plain_median = round(float(np.median(plain_totals)), 2) if plain_totals else None
    return Benchmark(
        queries=len(split.queries),
        located=len(results),
        decode_ms=round(float(np.median(decodes)), 2) if decodes else float("nan"),
        stages_ms=median_stages([found.timings_ms for found in results]),
        total_ms=total,
        kernels_ms=medians,
        kernels_sum_ms=round(sum(medians.values()), 2),
        plain_sift_ms=plain_median,
        plain_sift_located=plain_located if plain is not None else None,
        ratio=round(total / plain_median, 3) if plain_median else None,
    )


def _kernels(
    localizer: Localizer, models: VisionModels, rgb: Rgb, camera: Camera, keyframes: int, repeats: int
) -> dict[str, float]:
    """Return the milliseconds of the library calls that a query can't do without, each called bare."""
    out = {}
    out["local features"], _ = _timed(_features_kernel(localizer, models, rgb), repeats)
    out["global descriptor"], descriptor = _timed(lambda: models.global_descriptor.describe(rgb), repeats)
    out["index search"], (rows, _) = _timed(
        lambda: localizer.map.index.search(descriptor, keyframes), repeats
    )
    out["matching"], _ = _timed(_matching_kernel(localizer, models, rgb, rows), repeats)
    out["pose"] = _pose_kernel(localizer, rgb, camera, repeats)
    return out


def _features_kernel(localizer: Localizer, models: VisionModels, rgb: Rgb) -> Callable[[], Any]:
    gray = to_gray(rgb)
    if localizer.map.artifact.metadata.features != "sift":
        extractor = models.extractor(localizer.map.artifact.metadata.features)
        return lambda: extractor.extract(gray)
    small, _ = shrink(gray, SIFT_SIDE_PX)
    return lambda: cv2.SIFT.create(SIFT_FEATURES).detectAndCompute(small, None)


def _matching_kernel(
    localizer: Localizer, models: VisionModels, rgb: Rgb, rows: Sequence[int]
) -> Callable[[], Any]:
    """One matrix product a keyframe, and the nearest neighbours both ways."""
    extractor, arrays = (
        models.extractor(localizer.map.artifact.metadata.features),
        localizer.map.artifact.arrays,
    )
    unit = to_unit_vectors(extractor.extract(to_gray(rgb)).descriptors, extractor.binary)
    theirs = [
        to_unit_vectors(arrays.descriptors[localizer.map.artifact.rows(int(row))], extractor.binary)
        for row in rows
    ]

    def match() -> None:
        for other in theirs:
            similarity = unit @ other.T
            similarity.argmax(axis=1)
            similarity.argmax(axis=0)

    return match


def _pose_kernel(localizer: Localizer, rgb: Rgb, camera: Camera, repeats: int) -> float:
    """The time that one query spends inside the robust estimator of absolute poses."""
    totals = []
    for _ in range(repeats):
        spent = [0.0]
        with patch.object(ESTIMATORS, "absolute_poses", _clocked(ESTIMATORS.absolute_poses, spent)):
            localizer.localize(rgb, camera)
        totals.append(spent[0])
    return float(np.median(totals))


def _clocked(call: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    def clocked(*arguments: Any, **named: Any) -> Any:
        started = time.perf_counter()
        try:
            return call(*arguments, **named)
        finally:
            spent[0] += 1e3 * (time.perf_counter() - started)

    return clocked


def _timed(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    times, result = [], None
    for _ in range(repeats):
        started = time.perf_counter()
        result = call()
        times.append(1e3 * (time.perf_counter() - started))
    return float(np.median(times)), result


def describe_machine() -> dict[str, str]:
    """Return what figures depend on: processor and library versions."""
    import faiss
    import onnxruntime

    return {"processor": _processor(), "opencv": cv2.__version__, "faiss": faiss.__version__,
            "onnxruntime": onnxruntime.__version__, "numpy": np.__version__}  # fmt: skip


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:  # noqa: PTH123
            names: Sequence[str] = [
                line.split(":", 1)[1].strip() for line in file if line.startswith("model name")
            ]
    except OSError:
        return "unknown"
    return names[0] if names else "unknown"
