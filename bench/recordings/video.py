"""A scan like a video, whose frames overlap nearly whole: two rooms and the way between, with phone pictures.

`python -m bench.recordings.video DIRECTORY` renders it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench.recordings.queries import DemoQuery, render_queries_near
from bench.recordings.scan import DemoScan, render_scan
from bench.recordings.trajectory import Stop, Walk, scan_poses
from bench.render.frames import Progress

# A quarter of the steps of the wing's scan: neighbours are 0.09 m or 3.5 degrees apart.
VIDEO_WALK: tuple[Walk, ...] = (
    Walk(0, (Stop(2.0, 3.0, 300.0), Stop(3.3, 6.5), Stop(3.0, 10.0), Stop(3.4, 12.8, 200.0))),
)
VIDEO_FRAMES = 240
VIDEO_QUERIES = 60


def render_video(
    directory: Path,
    *,
    frames: int = VIDEO_FRAMES,
    queries: int = VIDEO_QUERIES,
    workers: int = 2,
    progress: Progress | None = None,
) -> tuple[DemoScan, list[DemoQuery]]:
    """Render the scan into `directory/scan` and the pictures into `directory/queries`; otherwise as `render_wing`."""
    scan = render_scan("video", VIDEO_WALK, directory / "scan", frames, workers, progress)
    poses = scan_poses(VIDEO_WALK, frames)
    return scan, render_queries_near(
        poses, directory / "queries", queries, region="video", workers=workers, progress=progress
    )


if __name__ == "__main__":
    render_video(Path(sys.argv[1]), progress=lambda done, total: print(f"{done} of {total}"))
