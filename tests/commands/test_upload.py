"""`roomfix upload`: a scan that is inspected first and then built, and sent once."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from app.cli import app
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
from tests.server import listening


def test_an_upload_is_inspected_and_built_without_being_sent_again(
    tmp_path: Path, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROOMFIX_ADMIN_KEY", raising=False)
    scan = tmp_path / "scan.zip"
    scan.write_bytes(zipped(scan_files(views[:5])))
    with listening(tmp_path / "data") as (url, _):

        def upload(*options: str) -> str:
            given = ["--server", url, "--options", json.dumps({"camera": CAMERA_TEXT}), *options]
            done = CliRunner().invoke(app, ["upload", str(scan), "--venue", "museum", *given])
            assert done.exit_code == 0, done.output
            return done.output

        inspected = upload("--inspect")
        (address,) = [line.split()[1] for line in inspected.splitlines() if line.startswith("upload ")]
        assert '"would": "build"' in inspected
        assert httpx.get(f"{url}/database/builds").json() == []
        # An inspection needs no venue, a build does.
        assert httpx.post(f"{url}/venues", json={"id": "museum", "name": "Museum"}).status_code == 201
        assert "the connection broke 0 times; build " in upload("--resume", address)
