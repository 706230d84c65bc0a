"""`roomfix inspect` of a video: what a build would do with it, and no picture of a path that isn't known yet."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.engine.mapping.inspection import unposed
from tests.importers.scans import write_video


def told_of(video: Path) -> dict[str, Any]:
    """Return what the command says as JSON."""
    told: dict[str, Any] = json.loads(CliRunner().invoke(app, ["inspect", str(video), "--json"]).stdout)
    return told


def test_a_video_is_inspected(tmp_path: Path) -> None:
    video = write_video(tmp_path / "walk.mp4", frames=40, step_px=6)
    shown = CliRunner().invoke(app, ["inspect", str(video)])
    assert shown.exit_code == 0, shown.output
    assert "estimate_poses" in shown.output
    assert "has no scale" in " ".join(shown.output.split())
    told = told_of(video)
    assert (told["format"], told["frames"]) == ("video", 40)


def test_of_a_long_video_the_first_frames_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = write_video(tmp_path / "walk.mp4", frames=60, step_px=6)
    whole = told_of(video)
    assert (whole["frames"], whole["duration_s"], whole["rate_hz"]) == (60, 6.0, 10.0)
    assert not any("looked at" in note for note in whole["notes"])
    monkeypatch.setattr(unposed, "OPTIONS", replace(unposed.OPTIONS, frames=12))
    begun = told_of(video)
    assert begun["frames"] == 60
    assert begun["build"]["pictures"] == pytest.approx(whole["build"]["pictures"], abs=10)
    assert "The first 12 of 60 pictures were looked at." in begun["notes"]


def test_there_is_no_picture_of_a_path_that_is_not_known(tmp_path: Path) -> None:
    video = write_video(tmp_path / "walk.mp4", frames=40, step_px=6)
    asked = CliRunner().invoke(app, ["inspect", str(video), "--picture", str(tmp_path / "path.svg")])
    assert asked.exit_code != 0
    assert not (tmp_path / "path.svg").exists()


def test_of_a_long_video_a_start_that_stands_still_is_no_reason_to_refuse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    still = write_video(tmp_path / "still.mp4", frames=40, step_px=0)
    refused = CliRunner().invoke(app, ["inspect", str(still)])
    assert "Of 40 pictures 1 differ enough" in str(refused.exception)
    monkeypatch.setattr(unposed, "OPTIONS", replace(unposed.OPTIONS, frames=12))
    assert told_of(still)["frames"] == 40
