"""Recall at 1 of a global descriptor on a posed RGB-D folder in TUM layout.

    python training/evaluate_retrieval.py FOLDER

The database is the first `--database` frames of rgb.txt, queries are every `--step`-th of the rest.
Two definitions, each strict and loose; beside each stands the share of queries for which the database
holds any frame that would count:

- overlap: the share of the query's depth pixels that the retrieved frame sees too, at least 60 % / 40 %;
- pose: the retrieved frame lies within 0.25 m and 15 degrees / 0.5 m and 30 degrees of the query.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from onnx_files import MODELS_DIR, SHARED_DATA, median_ms, session
from scipy.spatial.transform import Rotation

ASSOCIATION_S = 0.02
GRID_PX = 8
SAME_SURFACE = 0.1  # two depths are of one surface when they differ by less than a tenth

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Scan:
    """Posed frames: images, depth every GRID_PX pixels (N, h, w), world_from_camera, (fx, fy, cx, cy)."""

    images: list[Path]
    depth_m: Floats
    position_m: Floats
    rotation: Floats
    pinhole: Floats


def read_table(path: Path) -> list[list[str]]:
    """The fields of every line that is not a comment."""
    lines = path.read_text().splitlines()
    return [line.split() for line in lines if line.strip() and not line.startswith("#")]


def nearest(table: list[list[str]], times_s: Floats) -> tuple[Indices, NDArray[np.bool_]]:
    """For each time the row of `table` with the nearest timestamp, and whether it is near enough."""
    stamps = np.array([float(row[0]) for row in table])
    rows = np.abs(stamps[None, :] - times_s[:, None]).argmin(axis=1)
    return rows, np.abs(stamps[rows] - times_s) < ASSOCIATION_S


def read_scan(folder: Path, pinhole: list[float] | None, depth_scale: float) -> Scan:
    """The colour frames that have a depth image and a pose."""
    tables = [read_table(folder / f"{name}.txt") for name in ("rgb", "depth", "groundtruth")]
    times_s = np.array([float(row[0]) for row in tables[0]])
    depth_rows, has_depth = nearest(tables[1], times_s)
    pose_rows, has_pose = nearest(tables[2], times_s)
    kept = np.flatnonzero(has_depth & has_pose)
    poses = np.array(tables[2], dtype=np.float64)[pose_rows[kept]]
    depths = [cv2.imread(str(folder / tables[1][row][1]), cv2.IMREAD_UNCHANGED) for row in depth_rows[kept]]
    start = GRID_PX // 2
    return Scan(
        images=[folder / tables[0][row][1] for row in kept],
        depth_m=np.stack([depth[start::GRID_PX, start::GRID_PX] for depth in depths]) / depth_scale,
        position_m=poses[:, 1:4],
        rotation=Rotation.from_quat(poses[:, 4:8]).as_matrix(),
        pinhole=np.array(pinhole or read_table(folder / "camera.txt")[0][3:7], dtype=np.float64),
    )


def points_in_world(scan: Scan, frame: int) -> Floats:
    """The frame's depth pixels as world points (M, 3)."""
    fx, fy, cx, cy = scan.pinhole
    rows, columns = np.nonzero(scan.depth_m[frame])
    z = scan.depth_m[frame][rows, columns]
    u, v = (index * GRID_PX + GRID_PX // 2 for index in (columns, rows))
    in_camera = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1)
    return in_camera @ scan.rotation[frame].T + scan.position_m[frame]


def overlap(scan: Scan, points: Floats, frame: int) -> float:
    """Share of world points that `frame` sees, by its own depth."""
    fx, fy, cx, cy = scan.pinhole
    in_camera = (points - scan.position_m[frame]) @ scan.rotation[frame]
    x, y, z = in_camera[in_camera[:, 2] > 0.1].T
    depth = scan.depth_m[frame]
    columns = np.floor((fx * x / z + cx) / GRID_PX).astype(int)
    rows = np.floor((fy * y / z + cy) / GRID_PX).astype(int)
    inside = (rows >= 0) & (rows < depth.shape[0]) & (columns >= 0) & (columns < depth.shape[1])
    seen = np.abs(depth[rows[inside], columns[inside]] - z[inside]) < SAME_SURFACE * z[inside]
    return float(seen.sum() / max(1, len(points)))


def overlaps(scan: Scan, queries: Indices, database: Indices) -> Floats:
    """Overlap (queries, database) of every pair."""
    clouds = (points_in_world(scan, query) for query in queries)
    return np.array([[overlap(scan, cloud, frame) for frame in database] for cloud in clouds])


def pose_differences(scan: Scan, queries: Indices, database: Indices) -> tuple[Floats, Floats]:
    """Distance in metres and angle in degrees (queries, database) of every pair."""
    offset = scan.position_m[queries][:, None] - scan.position_m[database][None]
    trace = np.einsum("qij,dij->qd", scan.rotation[queries], scan.rotation[database])
    return np.linalg.norm(offset, axis=2), np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def network_input(path: Path, width_px: int, height_px: int) -> NDArray[np.float32]:
    """The image as (1, 3, H, W), RGB as (x - 127) / 128."""
    bgr = cv2.resize(cv2.imread(str(path)), (width_px, height_px), interpolation=cv2.INTER_AREA)
    return (np.ascontiguousarray(bgr[:, :, ::-1].transpose(2, 0, 1)[None], np.float32) - 127) / 128


def report(scan: Scan, queries: Indices, database: Indices, retrieved: Indices) -> None:
    """Print recall at 1 by each definition; `retrieved` counts within the database."""
    shared = overlaps(scan, queries, database)
    metres, degrees = pose_differences(scan, queries, database)
    correct = {
        "overlap strict": shared >= 0.6,
        "overlap loose": shared >= 0.4,
        "pose strict": (metres <= 0.25) & (degrees <= 15),
        "pose loose": (metres <= 0.5) & (degrees <= 30),
    }
    for name, right in correct.items():
        recall = 100 * right[np.arange(len(queries)), retrieved].mean()
        print(f"{name:15} R@1 {recall:5.1f} %, attainable {100 * right.any(axis=1).mean():5.1f} %")
    chosen = shared[np.arange(len(queries)), retrieved]
    print(f"mean overlap {chosen.mean():.3f}, attainable {shared.max(axis=1).mean():.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=SHARED_DATA / "redkitchen")
    parser.add_argument("--model", type=Path, default=MODELS_DIR / "global_descriptor.onnx")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), metavar=("W", "H"))
    parser.add_argument("--database", type=int, default=300)
    parser.add_argument("--step", type=int, default=3)
    parser.add_argument("--depth-scale", type=float, default=1000)
    parser.add_argument("--pinhole", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    scan = read_scan(arguments.folder, arguments.pinhole, arguments.depth_scale)
    run = session(arguments.model).run
    inputs = [network_input(path, *arguments.size) for path in scan.images]
    described = np.concatenate([run(None, {"image": image})[0] for image in inputs])
    database = np.arange(min(arguments.database, len(described)))
    queries = np.arange(len(database), len(described), arguments.step)
    print(f"{len(database)} database frames, {len(queries)} queries")
    report(scan, queries, database, (described[queries] @ described[database].T).argmax(axis=1))
    time_ms = median_ms(lambda: run(None, {"image": inputs[0]}))
    print(f"{arguments.size[0]}x{arguments.size[1]}, one thread: {time_ms:.1f} ms")


if __name__ == "__main__":
    main()
