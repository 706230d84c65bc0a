"""The gate over HTTP: limits, what an open server refuses, the audit log, keys by HTTP, bodies that wait."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import time_machine
from fastapi.testclient import TestClient
from starlette.testclient import WebSocketDenialResponse

from tests.server import Server, assert_problem, running

KEY = "the-right-key"
NOON = "2027-03-01T12:00:00Z"


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with keys, of which few wrong ones and few calls are taken."""
    folder = tmp_path_factory.mktemp("locked")
    limits = {"wrong_keys_per_minute": 20, "calls_per_minute": 30}
    with running(folder, run_worker=False, admin_key=KEY, **limits) as server:
        server.client.post("/venues", json={"id": "museum", "name": "Museum"}, headers=bearer(KEY))
        yield server


@pytest.fixture
def unlimited(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("unlimited")
    limits = {"wrong_keys_per_minute": 0, "calls_per_minute": 0}
    with running(folder, run_worker=False, admin_key=KEY, **limits) as server:
        server.client.headers["Authorization"] = f"Bearer {KEY}"
        server.add_venue("museum")
        yield server


@pytest.fixture
def one_moment() -> Iterator[None]:
    """A clock that stands still: counts of a minute would else get calls back while a slow test goes on."""
    with time_machine.travel(NOON, tick=False):
        yield


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def client_from(server: Server, address: str) -> TestClient:
    """Return a client of the same server with another address."""
    assert isinstance(server.client, TestClient)
    return TestClient(server.client.app, base_url="http://127.0.0.1", client=(address, 50_000))


@pytest.mark.usefixtures("one_moment")
def test_a_thousand_wrong_keys_are_throttled_and_a_right_key_from_elsewhere_is_not(locked: Server) -> None:
    guesser, elsewhere = client_from(locked, "203.0.113.7"), client_from(locked, "198.51.100.4")
    statuses = [guesser.get("/venues", headers=bearer(f"guess-{i}")).status_code for i in range(1000)]
    assert statuses[:20] == [401] * 20
    assert set(statuses[20:]) == {429}
    # Else the right one could be found by guessing on.
    refused = guesser.get("/venues", headers=bearer(KEY))
    assert_problem(refused, 429, "too_many_requests")
    assert 1 <= int(refused.headers["retry-after"]) <= 120
    assert elsewhere.get("/venues", headers=bearer(KEY)).status_code == 200
    # What needs no key is answered; a call without a key is no guess.
    assert guesser.get("/healthz").status_code == 200


def test_calls_without_a_key_are_no_guesses(locked: Server) -> None:
    forgetful = client_from(locked, "203.0.113.8")
    assert {forgetful.get("/venues").status_code for _ in range(50)} == {401}
    assert forgetful.get("/venues", headers=bearer(KEY)).status_code == 200


@pytest.mark.usefixtures("one_moment")
def test_addresses_of_one_subscriber_count_together(locked: Server) -> None:
    for i in range(40):
        client_from(locked, f"2001:db8:1:2::{i:x}").get("/venues", headers=bearer("guess"))
    assert client_from(locked, "2001:db8:1:2::99").get("/venues", headers=bearer("guess")).status_code == 429
    assert client_from(locked, "2001:db8:1:3::99").get("/venues", headers=bearer("guess")).status_code == 401


@pytest.mark.usefixtures("one_moment")
def test_a_key_is_limited_by_address_and_says_what_is_left(locked: Server) -> None:
    client = client_from(locked, "192.0.2.1")
    answers = [client.get("/venues", headers=bearer(KEY)) for _ in range(35)]
    assert [answer.status_code for answer in answers] == [200] * 30 + [429] * 5
    assert answers[0].headers["ratelimit-policy"] == '"calls";q=30;w=60'
    assert answers[0].headers["ratelimit"].startswith('"calls";r=29;t=')
    assert answers[29].headers["ratelimit"].startswith('"calls";r=0;t=')
    assert_problem(answers[30], 429, "too_many_requests")
    assert int(answers[30].headers["retry-after"]) >= 1
    assert client_from(locked, "192.0.2.2").get("/venues", headers=bearer(KEY)).status_code == 200
    # An answer that is an error says it too.
    other = client_from(locked, "192.0.2.3").get("/venues/none", headers=bearer(KEY))
    assert (other.status_code, other.headers["ratelimit"].startswith('"calls";r=29;')) == (404, True)


def test_a_key_is_made_shown_once_used_and_revoked_over_http(unlimited: Server) -> None:
    client = unlimited.client
    made = client.post(
        "/keys", json={"name": "App", "scope": "locate", "venue": "museum", "expires_in_s": 600}
    )
    assert made.status_code == 201
    assert made.headers["cache-control"] == "no-store"
    body = made.json()
    assert client.get("/venues/museum", headers=bearer(body["text"])).status_code == 200
    listed = client.get("/keys")
    assert body["text"] not in listed.text
    assert [(key["key"], key["name"], key["venue"]) for key in listed.json()] == [
        (body["key"], "App", "museum")
    ]
    assert listed.json()[0]["last_used_at"] is not None
    token = client.post("/tokens", json={"expires_in_s": 60}, headers=bearer(body["text"])).json()
    assert token["venue"] == "museum"
    assert client.get("/venues/museum", headers=bearer(token["token"])).status_code == 200
    assert client.delete(f"/keys/{body['key']}").status_code == 204
    for text in (body["text"], token["token"]):
        assert_problem(client.get("/venues/museum", headers=bearer(text)), 401, "key_revoked")


def test_a_venue_may_be_left_out_where_the_key_has_one(unlimited: Server) -> None:
    unlimited.add_venue("hotel")
    key = unlimited.client.post("/keys", json={"name": "App", "scope": "locate", "venue": "museum"}).json()[
        "text"
    ]
    answer = unlimited.client.post("/locate", files={"image": b"no picture"}, headers=bearer(key))
    assert_problem(answer, 415)
    # With several venues and no limit it can't be left out.
    assert "venue" in assert_problem(unlimited.client.post("/locate", files={"image": b"no picture"}), 422)
    assert [venue["id"] for venue in unlimited.client.get("/venues", headers=bearer(key)).json()] == [
        "museum"
    ]


def test_the_audit_log_has_what_was_changed_and_by_whom(unlimited: Server) -> None:
    client = unlimited.client
    key = client.post("/keys", json={"name": "Museum's", "scope": "admin", "venue": "museum"}).json()
    client.patch("/venues/museum", json={"name": "City museum"}, headers=bearer(key["text"]))
    client.patch("/venues/museum", json={"name": ""}, headers=bearer(key["text"]))
    client.get("/venues/museum", headers=bearer(key["text"]))
    entries = client.get("/audit").json()
    assert [(entry["act"], entry["target"], entry["key_name"], entry["venue"]) for entry in entries] == [
        ("PATCH /venues/{venue}", "/venues/museum", "Museum's", "museum"),
        ("POST /keys", "/keys", "ROOMFIX_ADMIN_KEY", "museum"),
        ("POST /venues", "/venues", "ROOMFIX_ADMIN_KEY", None),
    ]
    assert entries[0]["key"] == key["key"]
    older = client.get("/audit", params={"before": entries[0]["id"], "limit": 1}).json()
    assert [entry["id"] for entry in older] == [entries[1]["id"]]
    own = client.get("/audit", headers=bearer(key["text"])).json()
    assert [entry["act"] for entry in own] == ["PATCH /venues/{venue}", "POST /keys"]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "127.0.0.1.evil.example", "10.0.0.5", ""]
)
def test_an_open_server_answers_loopback_names_only(empty: Server, host: str) -> None:
    assert_problem(empty.client.get("/venues", headers={"Host": host}), 403, "foreign_caller")
    assert isinstance(empty.client, TestClient)
    path = f"ws://127.0.0.1/sessions/{'0' * 32}/stream"
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        empty.client.websocket_connect(path, headers={"Host": host}),
    ):
        pass
    assert refused.value.status_code == 403


@pytest.mark.parametrize("host", ["localhost", "localhost:8000", "127.0.0.1:1234", "[::1]:8000", "127.3.2.1"])
def test_an_open_server_answers_every_name_of_loopback(empty: Server, host: str) -> None:
    assert empty.client.get("/venues", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    ("origin", "status", "stream_status"),
    [
        ("http://127.0.0.1", 404, 404),
        ("http://localhost:3000", 404, 404),
        ("https://evil.example", 403, 403),
        ("null", 403, 403),
    ],
)
def test_an_open_server_takes_no_page_of_another_machine(
    empty: Server, origin: str, status: int, stream_status: int
) -> None:
    path, headers = "/sessions/" + "0" * 32, {"Origin": origin}
    assert empty.client.get(path, headers=headers).status_code == status
    assert isinstance(empty.client, TestClient)
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        empty.client.websocket_connect(f"ws://127.0.0.1{path}/stream", headers=headers),
    ):
        pass
    assert refused.value.status_code == stream_status


def test_a_server_with_keys_answers_under_any_name(locked: Server) -> None:
    headers = {**bearer(KEY), "Host": "roomfix.example", "Origin": "https://app.example"}
    assert client_from(locked, "192.0.2.77").get("/venues", headers=headers).status_code == 200


def test_json_has_a_limit_of_its_own(unlimited: Server) -> None:
    long = {"id": "x", "name": "x" * 1_200_000}
    assert "1,000,000 bytes" in assert_problem(
        unlimited.client.post("/venues", json=long), 413, "upload_too_large"
    )
    # Without a key nothing is said of the body.
    assert_problem(unlimited.client.post("/venues", json=long, headers=bearer("wrong")), 401)
