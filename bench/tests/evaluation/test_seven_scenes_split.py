"""The split that 7-Scenes publishes: which frames make the map, and which are asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.frames import ScanOptions
from bench.evaluation.dataset import split_scan
from tests.importers.scans import INTRINSICS, write_seven_scenes

OPTIONS = ScanOptions(camera=CameraHint(values=INTRINSICS))


def write(folder: Path) -> Path:
    for number, frames in ((1, [0, 1]), (2, [0, 1, 2]), (3, [0])):
        write_seven_scenes(folder / f"seq-{number:02d}", frames)
    (folder / "TrainSplit.txt").write_text("sequence1\nsequence3\n")
    (folder / "TestSplit.txt").write_text("sequence2\n")
    return folder


def test_train_and_test_are_the_sequences_of_their_files(tmp_path: Path) -> None:
    split = split_scan(write(tmp_path), "train", "test", "auto", OPTIONS)
    assert [f.name.split("/")[0] for f in split.database.frames] == ["seq-01", "seq-01", "seq-03"]
    assert [f.name.split("/")[0] for f in split.queries] == ["seq-02"] * 3


def test_a_split_that_names_what_is_not_there(tmp_path: Path) -> None:
    (write(tmp_path) / "TestSplit.txt").write_text("sequence9\n")
    with pytest.raises(
        InvalidScanError, match=r"TestSplit\.txt line 1: the scan has no sequence 'sequence9'"
    ):
        split_scan(tmp_path, "train", "test", "auto", OPTIONS)
    (tmp_path / "TrainSplit.txt").unlink()
    with pytest.raises(InvalidScanError, match=r"TrainSplit\.txt is missing"):
        split_scan(tmp_path, "train", "test", "auto", OPTIONS)
