"""The same evaluation against a running server, over HTTP alone."""

from __future__ import annotations

import io
import json
import time
import uuid
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from app.errors import RoomfixError
from app.evaluation.dataset import Split
from app.evaluation.pose_errors import QueryOutcome, pose_error, summarize
from app.geometry.se3 import Pose
from app.importers.frames import Frame

POLL_S = 0.3


def evaluate_over_http(
    server: str, split: Split, dataset: Path, options: dict[str, Any], key: str | None = None
) -> dict[str, Any]:
    """Build the split's database on a server, in a venue of its own that is deleted again, and locate its queries.

    The scan goes there in TUM form with its poses as they were read. Raises `RoomfixError` when the build fails.
    """
    venue = f"evaluation-{uuid.uuid4().hex[:8]}"
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with httpx.Client(base_url=server, headers=headers, timeout=300) as client:
        client.post("/venues", json={"id": venue, "name": f"Evaluation of {dataset.name}"}).raise_for_status()
        try:
            build = _build(client, venue, split, options)
            world_from_scan = Pose.from_matrix(np.array(build["report"]["world_from_scan"]))
            outcomes = [_locate(client, venue, split, frame, world_from_scan) for frame in split.queries]
        finally:
            client.delete(f"/venues/{venue}")
    report = build["report"]
    return {
        "name": f"{dataset.name} over HTTP",
        "features": report["feature_method"],
        "keyframes": report["keyframes"],
        "features_per_keyframe": round(report["features"] / report["keyframes"], 1),
        "megabytes": round(sum(report["bytes"].values()) / 1e6, 2),
        "build_s": round(sum(report["seconds"].values()), 2),
        "discarded": report["discarded"],
        "summary": summarize(outcomes).as_dict(),
    }


def _build(client: httpx.Client, venue: str, split: Split, options: dict[str, Any]) -> dict[str, Any]:
    camera = split.database.camera
    body = {
        **options,
        "format": "tum",
        "camera": {
            "model": camera.model,
            "width": camera.width,
            "height": camera.height,
            "params": list(camera.params),
        },
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
    client: httpx.Client, venue: str, split: Split, frame: Frame, world_from_scan: Pose
) -> QueryOutcome:
    camera = split.database.camera
    body = {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "params": list(camera.params),
    }
    files = {"image": (frame.color.name, split.database.color_bytes(frame))}
    started = time.perf_counter()
    answer = client.post("/locate", data={"venue": venue, "camera": _json(body)}, files=files)
    milliseconds = 1e3 * (time.perf_counter() - started)
    answer.raise_for_status()
    found = answer.json()
    position_m, orientation_deg = float("inf"), 180.0
    if found["located"]:
        p, q = found["pose"]["position"], found["pose"]["quaternion"]
        pose = Pose.from_quaternion([p["x"], p["y"], p["z"]], [q["x"], q["y"], q["z"], q["w"]])
        position_m, orientation_deg = pose_error(pose, world_from_scan @ frame.scan_from_camera)
    return QueryOutcome(
        frame.name,
        found["located"],
        position_m,
        orientation_deg,
        found["reason"],
        found["inliers"],
        found["confidence"],
        milliseconds,
    )


def _json(value: object) -> str:
    return json.dumps(value)
