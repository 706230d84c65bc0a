"""Runs schemathesis against a server in a process of its own, with one key or none."""

from __future__ import annotations

import base64
import io
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from tests.api.key_rows import ANCHOR, CAMERA, FLOOR, VENUE
from tests.live_server import ROOT, serving

ADMIN_KEY = "the-key-of-the-settings-0123456789"
CONFIG = Path(__file__).with_name("schemathesis.toml")


@dataclass(frozen=True, slots=True)
class Target:
    """A served venue, and the keys that its calls may be made with."""

    url: str
    log: Path
    keys: dict[str, str | None]
    build: str
    upload: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a campaign found: how many cases there were, and by code and title which operations failed."""

    cases: int
    seconds: float
    failures: dict[str, list[str]]
    output: str


@contextmanager
def target(folder: Path) -> Iterator[Target]:
    """Serve a venue with a floor and a monitoring camera; no limit of calls, since one caller makes thousands."""
    environment = {
        "ROOMFIX_ADMIN_KEY": ADMIN_KEY,
        "ROOMFIX_OPEN": "false",
        "ROOMFIX_RUN_WORKER": "true",
        "ROOMFIX_CALLS_PER_MINUTE": "0",
        "ROOMFIX_WRONG_KEYS_PER_MINUTE": "0",
    }
    with serving(folder, **environment) as server:
        headers = {"Authorization": f"Bearer {ADMIN_KEY}"}
        with httpx.Client(base_url=server.url, headers=headers, timeout=60) as client:
            floor = {**FLOOR, "plan_from_world": np.eye(4).tolist()}
            client.post("/venues", json={"id": VENUE, "name": VENUE}).raise_for_status()
            client.put(f"/venues/{VENUE}/floors/0", json=floor).raise_for_status()
            client.put(f"/anchors/{CAMERA}", json=ANCHOR).raise_for_status()
            keys: dict[str, str | None] = {"admin": ADMIN_KEY, "no key": None}
            for scope in ("locate", "anchor"):
                made = client.post("/keys", json={"name": scope, "scope": scope})
                keys[scope] = made.json()["text"]
            build, upload = ended_build(client), begun_upload(client)
        yield Target(server.url, server.log, keys, build, upload)


def ended_build(client: httpx.Client) -> str:
    """Return the id of a build that has failed, since its archive holds no scan."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("rgb.txt", "no scan")
    sent = client.post("/database/build", data={"venue": VENUE}, files={"archive": data.getvalue()})
    build = str(sent.raise_for_status().json()["build"])
    while client.get(f"/database/builds/{build}").json()["state"] != "failed":
        time.sleep(0.2)
    return build


def begun_upload(client: httpx.Client) -> str:
    """Return the id of an upload of which nothing has arrived."""
    venue = base64.b64encode(VENUE.encode()).decode()
    headers = {"Tus-Resumable": "1.0.0", "Upload-Length": "1000", "Upload-Metadata": f"venue {venue}"}
    begun = client.post("/uploads", headers=headers).raise_for_status()
    return begun.headers["Location"].rpartition("/")[2]


def attack(
    target: Target, key: str, folder: Path, cases: int, phases: str, seed: int | None = None
) -> Outcome:
    """Make `cases` requests per operation in each of the phases, with all checks on every answer."""
    report = folder / f"{key.replace(' ', '-')}.json"
    config = folder / CONFIG.name
    settings = CONFIG.read_text(encoding="utf-8").replace("BUILD", target.build)
    config.write_text(settings.replace("UPLOAD", target.upload), encoding="utf-8")
    text = target.keys[key]
    command = [
        str(Path(sys.executable).with_name("schemathesis")),
        *("--config-file", str(config), "run", f"{target.url}/openapi.json", "--checks", "all"),
        *("--max-examples", str(cases), "--phases", phases, "--no-color"),
        *("--report", "json", "--report-json-path", str(report)),
        *(() if seed is None else ("--seed", str(seed))),
        *(() if text is None else ("--header", f"Authorization: Bearer {text}")),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    assert report.is_file(), ran.stdout + ran.stderr
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    failures = {f"{group['code']} {group['title']}": group["operations"] for group in found["failures"]}
    failures |= {f"error {group['title']}": [] for group in found["errors"]}
    return Outcome(found["test_cases"]["generated"], found["running_time"], failures, ran.stdout)
