"""The priority of a build: whom it is refused, and what it changes."""

from __future__ import annotations

from pathlib import Path

import httpx

from tests.server import Server, assert_problem, running

KEY = "the-right-key"


def submit(server: Server, key: str, priority: object) -> httpx.Response:
    """Queue a build with a priority."""
    return server.client.post(
        "/database/build",
        data={"venue": "museum", "priority": str(priority)},
        files={"archive": ("scan.zip", b"no archive")},
        headers={"Authorization": f"Bearer {key}"},
    )


def test_a_key_of_one_venue_puts_no_build_before_those_of_others(tmp_path: Path) -> None:
    with running(tmp_path, run_worker=False, admin_key=KEY) as server:
        server.client.headers["Authorization"] = f"Bearer {KEY}"
        server.add_venue("museum")
        made = server.client.post("/keys", json={"name": "own", "scope": "admin", "venue": "museum"}).json()
        assert_problem(submit(server, made["text"], 1), 403, "forbidden")
        for wrong in (10, -10, 0.5, "high"):
            assert_problem(submit(server, KEY, wrong), 422, "invalid_request")
        assert server.client.get("/database/builds").json() == []
        accepted = [submit(server, made["text"], 0), submit(server, made["text"], -9), submit(server, KEY, 9)]
        stated = [server.status(answer.json()["build"])["priority"] for answer in accepted]
        assert stated == [0, -9, 9]
