"""The same evaluation against a running server, over HTTP alone."""

from __future__ import annotations

import io
import json
import time
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

import httpx
import numpy as np
from PIL import Image

from app.errors import RoomfixError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.images import Rgb, decode_image
from bench.evaluation.dataset import Split
from bench.evaluation.outcome import centre_of
from bench.evaluation.pose_errors import QueryOutcome, pose_error, summarize
from bench.evaluation.run import Evaluation, MapFigures, median_stages
from bench.evaluation.variations import PLAIN, Variation

POLL_S = 0.3


def evaluate_over_http(
    client: httpx.Client,
    split: Split,
    name: str,
    options: dict[str, Any],
    variations: Sequence[Variation] = (PLAIN,),
) -> list[Evaluation]:
    """Build the split's database on a client's server, in a venue of its own that is deleted again, and locate
    its queries.

    The scan goes there in TUM form with its poses as they were read. Raises `RoomfixError` when the build fails.
    """
    venue = f"evaluation-{uuid.uuid4().hex[:8]}"
    client.post("/venues", json={"id": venue, "name": f"Evaluation of {name}"}).raise_for_status()
    try:
        report = _build(client, venue, split, options)["report"]
        world_from_scan = Pose.from_matrix(np.array(report["world_from_scan"]))
        figures = _map_figures(f"{name} over HTTP", report, len(split.database.frames))
        results = []
        for variation in variations:
            answers = [
                _locate(client, venue, split, number, world_from_scan, variation)
                for number in range(len(split.queries))
            ]
            outcomes = tuple(outcome for outcome, _ in answers)
            stages = median_stages([times for outcome, times in answers if outcome.located])
            results.append(
                Evaluation(
                    map=figures,
                    variation=variation.name,
                    summary=summarize(outcomes),
                    stages_ms=stages,
                    outcomes=outcomes,
                )
            )
    finally:
        client.delete(f"/venues/{venue}")
    return results


def _map_figures(configuration: str, report: Mapping[str, Any], frames: int) -> MapFigures:
    return MapFigures(
        configuration=configuration,
        features=report["feature_method"],
        keyframes=report["keyframes"],
        features_per_keyframe=round(report["features"] / report["keyframes"], 1),
        megabytes=round(sum(report["bytes"].values()) / 1e6, 2),
        frames=frames,
        build_s=round(sum(report["seconds"].values()), 2),
        discarded=report["discarded"],
    )


def _build(client: httpx.Client, venue: str, split: Split, options: dict[str, Any]) -> dict[str, Any]:
    body = {
        **options,
        "format": "tum",
        "camera": _camera_fields(split.database.camera),
        "depth_scale": split.database.depth.scale,
    }
    files = {"archive": ("scan.zip", _archive(split), "application/zip")}
    answer = client.post("/database/build", data={"venue": venue, "options": _json(body)}, files=files)
    answer.raise_for_status()
    while True:
        build: dict[str, Any] = client.get(answer.json()["status_url"]).json()
        if build["state"] == "succeeded":
            return build
        if build["state"] in ("failed", "cancelled"):
            raise RoomfixError(f"The build has {build['state']}: {build['error']}")
        time.sleep(POLL_S)


def _archive(split: Split) -> bytes:
    """Return a zip in TUM form whose three lists share the colour images' timestamps."""
    rgb, depth, poses = [], [], []
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for number, frame in enumerate(split.database.frames):
            stamp = f"{frame.timestamp_s:.6f}"
            color, depth_name = f"rgb/{number:06d}{frame.color.suffix}", f"depth/{number:06d}.png"
            archive.write(frame.color, color)
            archive.write(frame.depth, depth_name)
            rgb.append(f"{stamp} {color}")
            depth.append(f"{stamp} {depth_name}")
            pose = frame.scan_from_camera
            numbers = " ".join(f"{value:.9f}" for value in (*pose.translation, *pose.quaternion))
            poses.append(f"{stamp} {numbers}")
        for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
            archive.writestr(f"{name}.txt", "\n".join(lines) + "\n")
    return buffer.getvalue()


def _locate(
    client: httpx.Client, venue: str, split: Split, number: int, world_from_scan: Pose, variation: Variation
) -> tuple[QueryOutcome, dict[str, float]]:
    frame, camera = split.queries[number], split.database.camera
    data, truth = split.database.color_bytes(frame), world_from_scan @ frame.scan_from_camera
    if variation.degradation != PLAIN.degradation:
        asked = variation.apply(number, frame.name, decode_image(data), camera)
        camera, truth = asked.camera, truth @ asked.original_from_degraded
        data = _png(asked.rgb)
    fields = {"venue": venue}
    if variation.camera_given:
        fields["camera"] = _json(_camera_fields(camera))
    started = time.perf_counter()
    answer = client.post("/locate", data=fields, files={"image": (frame.color.name, data)})
    milliseconds = 1e3 * (time.perf_counter() - started)
    answer.raise_for_status()
    found = answer.json()
    stages = {stage: value for stage, value in found["timings_ms"].items() if stage != "total"}
    return _outcome(frame.name, found, truth, milliseconds), stages


def _outcome(name: str, found: Mapping[str, Any], truth: Pose, milliseconds: float) -> QueryOutcome:
    position_m, orientation_deg, pose = float("inf"), 180.0, None
    if found["located"]:
        p, q = found["pose"]["position"], found["pose"]["quaternion"]
        pose = Pose.from_quaternion([p["x"], p["y"], p["z"]], [q["x"], q["y"], q["z"], q["w"]])
        position_m, orientation_deg = pose_error(pose, truth)
    accuracy = found["accuracy"] or {}
    return QueryOutcome(
        name=name,
        located=found["located"],
        position_m=position_m,
        orientation_deg=orientation_deg,
        reason=found["reason"],
        inliers=found["inliers"],
        confidence=found["confidence"],
        milliseconds=milliseconds,
        matches=found["matches"],
        inlier_ratio=found["inliers"] / found["matches"] if found["matches"] else 0.0,
        sigma_m=accuracy.get("position_m"),
        sigma_deg=accuracy.get("orientation_deg"),
        truth_m=centre_of(truth),
        estimate_m=None if pose is None else centre_of(pose),
    )


def _camera_fields(camera: Camera) -> dict[str, Any]:
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "params": list(camera.params),
    }


def _png(rgb: Rgb) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "PNG")
    return buffer.getvalue()


def _json(value: object) -> str:
    return json.dumps(value)
