"""Rendering many frames in several processes that share one scene through files."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.recordings.cache import write_whole
from bench.render.noise import seeded
from bench.render.raycast import FINE, Quality, render
from bench.render.scene import DEMONSTRATION, Building, Scene, loaded_scene, scene_of
from bench.render.sensor import JPEG_QUALITY, ColourSensor, colour_picture, depth_picture
from bench.render.sheet import MarkerSheet, with_sheet

Progress = Callable[[int, int], None]

SCENE_FOLDER = ".scene"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameJob:
    """One frame to make: where it is seen from, the files to write (depth maybe none), the noise's seed, and a printed
    sheet that is in view."""

    camera: Camera
    world_from_camera: Pose
    colour_path: Path
    depth_path: Path | None
    seed: tuple[str, int]
    sensor: ColourSensor
    quality: Quality = FINE
    sheet: MarkerSheet | None = None

    @property
    def is_done(self) -> bool:
        """Whether its files are there."""
        return self.colour_path.is_file() and (self.depth_path is None or self.depth_path.is_file())


def make_frame(scene: Scene, job: FrameJob) -> None:
    """Render one frame, pass it through the sensor and write it."""
    rgb, depth_m = render(scene, job.camera, job.world_from_camera, job.quality)
    if job.sheet is not None:
        rgb = with_sheet(rgb, depth_m, job.camera, job.world_from_camera, job.sheet)
    rng = seeded(*job.seed)
    if job.depth_path is not None:
        measured = depth_picture(rng, depth_m, job.camera)
        write_whole(job.depth_path, _encoded(".png", measured, [cv2.IMWRITE_PNG_COMPRESSION, 2]))
    picture = colour_picture(rng, rgb, job.camera, job.sensor)
    flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    write_whole(job.colour_path, _encoded(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), flags))


def _encoded(extension: str, image: np.ndarray, flags: list[int]) -> bytes:
    ok, data = cv2.imencode(extension, image, flags)
    if not ok:
        raise OSError(f"OpenCV could not encode a {extension} image")
    return data.tobytes()


def _start_worker() -> None:
    """Prepare a worker process: one thread, and an end to it when the process that started it dies."""
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make_in_worker(scene_directory: Path, jobs: Sequence[FrameJob]) -> int:
    scene = loaded_scene(scene_directory)
    for job in jobs:
        make_frame(scene, job)
    return len(jobs)


def make_frames(
    directory: Path,
    jobs: Sequence[FrameJob],
    workers: int,
    progress: Progress | None,
    building: Building = DEMONSTRATION,
) -> None:
    """Make the frames that are not there yet, in this process or in `workers` spawned ones."""
    missing = [job for job in jobs if not job.is_done]
    done = len(jobs) - len(missing)
    if not missing:
        return
    scene = scene_of(building)
    steps = (
        _serially(scene, missing)
        if workers <= 1
        else _in_parallel(scene, directory / SCENE_FOLDER, missing, workers)
    )
    for count in steps:
        done += count
        if progress is not None:
            progress(done, len(jobs))


def _serially(scene: Scene, jobs: Sequence[FrameJob]) -> Iterator[int]:
    for job in jobs:
        make_frame(scene, job)
        yield 1


def _in_parallel(
    scene: Scene, scene_directory: Path, jobs: Sequence[FrameJob], workers: int
) -> Iterator[int]:
    scene.save(scene_directory)
    context = multiprocessing.get_context("spawn")
    batches = [jobs[k : k + 8] for k in range(0, len(jobs), 8)]
    try:
        with ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as pool:
            futures = [pool.submit(_make_in_worker, scene_directory, batch) for batch in batches]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:
                pool.shutdown(cancel_futures=True)
    finally:
        shutil.rmtree(scene_directory, ignore_errors=True)
