"""HTTPS for phones: an authority that is made once, certificates that it signed, and a server that uses them."""

from __future__ import annotations

import os
import re
import ssl
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
import typer
from fastapi.testclient import TestClient

from app.commands.https import make_certificate, own_names, qr_text
from app.commands.serve import check_access
from app.commands.serve_phones import WithKey, phone_token
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings
from app.web.phones import PhoneAccess
from tests.ports import free_port
from tests.server import WAIT_S, assert_problem, wait_for

ROOT = Path(__file__).parents[2]


def test_the_authority_stays_and_only_its_owner_reads_its_key(tmp_path: Path) -> None:
    first = make_certificate(tmp_path, ["192.0.2.7", "localhost"])
    authority, chain = first.authority.read_bytes(), first.chain.read_bytes()
    second = make_certificate(tmp_path, ["192.0.2.8"])
    assert second.authority.read_bytes() == authority
    assert second.chain.read_bytes() != chain
    for name in ("authority-key.pem", "server-key.pem"):
        assert stat.S_IMODE((tmp_path / "https" / name).stat().st_mode) == 0o600


def test_names_begin_with_what_phones_open(monkeypatch: pytest.MonkeyPatch) -> None:
    assert own_names("10.1.2.3") == ["10.1.2.3", "localhost", "127.0.0.1"]
    names = own_names("0.0.0.0")
    assert {"localhost", "127.0.0.1"} <= set(names)
    assert len(names) == len(set(names))


def test_https_on_all_addresses_is_never_open(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter):
        check_access(Settings(_env_file=None, data_dir=tmp_path, open=True, https=True, host="0.0.0.0"))


def test_the_code_in_the_terminal_can_be_read() -> None:
    link = "https://192.168.17.23:8443/go/demo#token=rfk_0123456789abcdef"
    blocks = {"█": (1, 1), "▀": (1, 0), "▄": (0, 1), " ": (0, 0)}
    rows = []
    for line in qr_text(link).split("\n"):
        rows += [list(row) for row in zip(*(blocks[character] for character in line), strict=True)]
    image = cv2.resize(255 * np.array(rows, np.uint8), None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    image = cv2.copyMakeBorder(image, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    assert cv2.QRCodeDetector().detectAndDecode(image)[0] == link


def test_serve_https_is_trusted_by_its_authority_and_by_nothing_else(tmp_path: Path) -> None:
    port = free_port()
    options = ["--https", "--host", "127.0.0.1", "--port", str(port), "--data-dir", str(tmp_path)]
    process = subprocess.Popen(
        [sys.executable, "-m", "app.cli", "serve", *options],
        env={**os.environ, "ROOMFIX_ADMIN_KEY": "secret", "ROOMFIX_RUN_WORKER": "false"},
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        authority = tmp_path / "https" / "authority.pem"
        url = f"https://127.0.0.1:{port}"

        def trusted() -> ssl.SSLContext | None:
            assert process.poll() is None
            with suppress(OSError, httpx.TransportError):
                context = ssl.create_default_context(cafile=str(authority))
                if httpx.get(f"{url}/readyz", verify=context).status_code == 200:
                    return context
            return None

        context = wait_for(trusted, pause_s=0.2)
        with pytest.raises(httpx.ConnectError, match="certificate"):
            httpx.get(f"{url}/readyz")
        assert httpx.get(f"{url}/assets/addresses", verify=context).json() == {"https": f"{url}/"}
        downloaded = httpx.get(f"{url}/ca.crt", verify=context)
        assert downloaded.headers["content-type"] == "application/x-x509-ca-cert"
        assert downloaded.content == authority.read_bytes()
    finally:
        process.terminate()
        printed, _ = process.communicate(timeout=WAIT_S)
    assert f"https://127.0.0.1:{port}/" in printed
    assert len([line for line in printed.splitlines() if set(line) <= set("█▀▄ ") and "█" in line]) > 10


def test_a_server_without_https_has_no_authority(tmp_path: Path) -> None:
    settings = Settings(_env_file=None, data_dir=tmp_path, open=True, run_worker=False)
    with TestClient(create_app(settings, NoRunner()), base_url="http://127.0.0.1:8000") as client:
        assert client.get("/assets/addresses").json() == {"https": None}
        assert client.get("/ca.crt").status_code == 404


def test_codes_for_pages_hold_any_text(tmp_path: Path) -> None:
    settings = Settings(_env_file=None, data_dir=tmp_path, open=True, run_worker=False)
    with TestClient(create_app(settings, NoRunner()), base_url="http://127.0.0.1:8000") as client:
        answer = client.get("/assets/qr.svg", params={"text": '<script>alert("ä")</script>'})
        assert answer.headers["content-type"] == "image/svg+xml"
        assert answer.headers["content-security-policy"] == "default-src 'none'"
        assert answer.headers["cache-control"] == "no-store"
        assert "script" not in answer.text
        assert re.search(r'<path[^>]* d="M', answer.text)
        for text in ("", "x" * 1001):
            assert_problem(client.get("/assets/qr.svg", params={"text": text}), 422, "invalid_request")
        assert_problem(client.get("/assets/qr.svg"), 422, "invalid_request")


def test_the_door_of_this_machine_needs_no_key_and_the_other_one_does(tmp_path: Path) -> None:
    settings = Settings(_env_file=None, data_dir=tmp_path, admin_key="secret", run_worker=False)
    app = create_app(settings, NoRunner(), PhoneAccess("https://192.0.2.1:8443/", tmp_path / "ca.pem"))
    with TestClient(app) as phones:
        local = TestClient(WithKey(app, "secret"))
        assert local.get("/venues").json() == []
        assert_problem(phones.get("/venues"), 401, "unauthenticated")
        # A key that is given counts, right or wrong.
        assert_problem(
            local.get("/venues", headers={"Authorization": "Bearer wrong"}), 401, "unauthenticated"
        )


def test_the_code_for_phones_lets_them_locate_and_nothing_else(tmp_path: Path) -> None:
    settings = Settings(_env_file=None, data_dir=tmp_path, admin_key="secret", run_worker=False)
    with TestClient(create_app(settings, NoRunner())) as client:
        admin = {"Authorization": "Bearer secret"}
        for venue in ("museum", "hotel"):
            body = {"id": venue, "name": venue}
            assert client.post("/venues", json=body, headers=admin).status_code == 201
        phone = {"Authorization": f"Bearer {phone_token(settings, 'secret', 'museum')}"}
        assert client.get("/venues/museum", headers=phone).status_code == 200
        assert client.post("/sessions", json={"venue": "museum"}, headers=phone).status_code == 201
        for answer in (
            client.get("/venues/hotel", headers=phone),
            client.delete("/venues/museum", headers=phone),
            client.post("/tokens", json={"venue": "museum"}, headers=phone),
            client.get("/keys", headers=phone),
        ):
            assert answer.status_code == 403
