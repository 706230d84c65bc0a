"""A server in a process of its own with a map, and what the samples of the clients need."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "clients" / "python"))

from roomfix_client import Roomfix

from tests.api.key_rows import ANCHOR, CAMERA, FLOOR
from tests.built_maps import publish
from tests.live_server import serving
from tests.scenes import CAMERA_TEXT, View

ADMIN_KEY = "the-key-of-the-settings-0123456789"


@dataclass(frozen=True)
class Site:
    """A served venue `museum` with a map, a folder with `photo.jpg` and `scan.zip`, and what samples call names."""

    url: str
    folder: Path
    names: dict[str, str]


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes, queries: list[View]) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("clients")
    (folder / "photo.jpg").write_bytes(queries[0].jpeg())
    (folder / "scan.zip").write_bytes(scan_zip)
    environment = {"ROOMFIX_ADMIN_KEY": ADMIN_KEY, "ROOMFIX_OPEN": "false", "ROOMFIX_RUN_WORKER": "true"}
    with serving(folder, **environment) as server, Roomfix(server.url, ADMIN_KEY) as admin:
        http = admin._client
        assert http.post("/venues", json={"id": "museum", "name": "Museum"}).status_code == 201
        assert (
            http.put(
                "/venues/museum/floors/0", json={**FLOOR, "plan_from_world": np.eye(4).tolist()}
            ).status_code
            == 200
        )
        assert http.put(f"/anchors/{CAMERA}", json=ANCHOR).status_code == 200
        publish(folder / "data", "museum", [(scan_zip, {"camera": CAMERA_TEXT, "gravity": [0, 0, -1]})])
        names = {"URL": server.url, "ADMIN_KEY": ADMIN_KEY, "CAMERA": CAMERA_TEXT}
        for name, scope in (("KEY", "locate"), ("ANCHOR_KEY", "anchor")):
            made = http.post("/keys", json={"name": name, "scope": scope, "venue": "museum"})
            names[name] = made.json()["text"]
        yield Site(server.url, folder, names)
