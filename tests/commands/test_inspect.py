"""`roomfix inspect` of a video: what a build would do with it, and no picture of a path that isn't known yet."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from app.cli import app
from tests.importers.test_unposed import write_video


def test_a_video_is_inspected(tmp_path: Path) -> None:
    video = write_video(tmp_path / "walk.mp4", frames=40, step_px=6)
    shown = CliRunner().invoke(app, ["inspect", str(video)])
    assert shown.exit_code == 0, shown.output
    assert "estimate_poses" in shown.output
    assert "has no scale" in " ".join(shown.output.split())
    told = json.loads(CliRunner().invoke(app, ["inspect", str(video), "--json"]).stdout)
    assert (told["format"], told["frames"]) == ("video", 40)


def test_there_is_no_picture_of_a_path_that_is_not_known(tmp_path: Path) -> None:
    video = write_video(tmp_path / "walk.mp4", frames=40, step_px=6)
    asked = CliRunner().invoke(app, ["inspect", str(video), "--picture", str(tmp_path / "path.svg")])
    assert asked.exit_code != 0
    assert not (tmp_path / "path.svg").exists()
