"""What of a scan's folder is sent to be built."""

from __future__ import annotations

import zipfile
from pathlib import Path

from app.commands.build import zip_folder


def test_all_that_the_importers_read_is_sent_and_nothing_else(tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    kept = [
        "rgb/0.heic",
        "rgb/1.JPG",
        "depth/0.tiff",
        "depth/1.exr",
        "depth/2.npy",
        "depth/3.pgm",
        "trajectory.log",
    ]
    for name in (*kept, "mesh.ply", "notes.docx"):
        (scan / name).parent.mkdir(parents=True, exist_ok=True)
        (scan / name).write_bytes(b"x")
    with zipfile.ZipFile(zip_folder(scan, tmp_path / "scan.zip")) as archive:
        # Of a model the name alone is sent: it says what there is.
        assert sorted(archive.namelist()) == sorted([*kept, "mesh.ply"])
        assert archive.getinfo("mesh.ply").file_size == 0
