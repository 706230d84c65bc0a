"""`roomfix locate` answers as the server does, what it can't find too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app
from tests.scenes import CAMERA_TEXT, Room, View
from tests.server import Server


@pytest.mark.parametrize("known", [True, False])
def test_a_photo_is_answered_for_whether_found_or_not(
    museum: Server, foreign_room: Room, queries: list[View], tmp_path: Path, known: bool
) -> None:
    view = queries[0] if known else foreign_room.view(queries[0].world_from_camera)
    image = tmp_path / "photo.jpg"
    image.write_bytes(view.jpeg())
    arguments = ["locate", str(image), "--venue", "museum", "--camera", CAMERA_TEXT]
    result = CliRunner().invoke(app, [*arguments, "--data-dir", str(museum.data_dir)])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["located"] is known
    assert (answer["reason"] is None) is known
