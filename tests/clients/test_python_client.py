"""The Python client: its README's samples as printed, its types as the server describes itself, its errors."""

from __future__ import annotations

import asyncio
import contextlib
import io
import re
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from roomfix_client import AsyncRoomfix, BuildError, Frame, Roomfix, RoomfixError, Uploaded, answers
from roomfix_client.calls import LONGEST_PAUSE_S, form, inspection, pause_s, submission, with_picture

from tests.clients.conftest import Site
from tests.clients.schemas import schemas
from tests.server import WAIT_S

README = Path(__file__).parents[2] / "clients" / "python" / "README.md"
SAMPLES = re.findall(
    r"^(\S[^\n]*):\n```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
)
PRINTED = {
    "Locate": r"0 \d", "Content": r"position", "Build": r"build\n(?s:.*)of \d+\n[2-9]\n", "Stream": r"tracking\n",
    "Push": r"\d+\n",
}  # fmt: skip
# Client's name -> the server's name of the same.
NAMES = {
    "PlanPoint": "Plan", "Guidance": "SessionGuidance", "Token": "CreatedToken",
}  # fmt: skip


@pytest.mark.parametrize(("title", "code"), SAMPLES, ids=[title.split()[0] for title, _ in SAMPLES])
def test_a_sample_of_the_readme_runs_as_printed(
    site: Site, title: str, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(site.folder)
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, str(README), "exec"), dict(site.names))
    assert re.search(PRINTED[title.split(maxsplit=1)[0]], output.getvalue()), output.getvalue()


def test_every_kind_of_use_has_a_sample() -> None:
    assert [title.split()[0] for title, _ in SAMPLES] == list(PRINTED)


def types() -> list[str]:
    return [
        name
        for name, value in vars(answers).items()
        if isinstance(value, type) and hasattr(value, "__total__")
    ]


@pytest.mark.parametrize("name", types())
def test_a_type_has_the_fields_that_the_server_describes(name: str) -> None:
    described = schemas()[NAMES.get(name, name)]["properties"]
    own = getattr(answers, name)
    # The number of a frame belongs to streams alone.
    assert set(own.__annotations__) - {"received"} == set(described)


def test_what_the_server_refuses_is_an_error_with_its_code(site: Site) -> None:
    with Roomfix(site.url, site.names["KEY"]) as server:
        with pytest.raises(RoomfixError) as refused:
            server.locate(b"no picture")
        assert (refused.value.status, refused.value.code) == (415, "unsupported_image")
        with pytest.raises(RoomfixError) as refused:
            server.create_token("elsewhere")
        assert (refused.value.status, refused.value.code) == (403, "forbidden")
    with Roomfix(site.url, "wrong") as server, pytest.raises(RoomfixError) as refused:
        server.venues()
    assert (refused.value.status, refused.value.code) == (401, "unauthenticated")
    with Roomfix("http://127.0.0.1:9", retries=0) as server, pytest.raises(httpx.TransportError):
        server.venues()


def test_both_clients_answer_alike(site: Site) -> None:
    photo = site.folder / "photo.jpg"

    async def ask() -> Any:
        async with AsyncRoomfix(site.url, site.names["KEY"]) as server:
            session = await server.create_session("museum", camera=site.names["CAMERA"])
            tracked = await server.track(session["session"], photo, timestamp=1.0)
            await server.end_session(session["session"])
            return await server.locate(photo, camera=site.names["CAMERA"]), tracked, await server.venues()

    located, tracked, venues = asyncio.run(ask())
    with Roomfix(site.url, site.names["KEY"]) as server:
        same = server.locate(photo, camera=site.names["CAMERA"])
        assert server.venues() == venues
    assert located["located"]
    assert located["pose"] == same["pose"]
    assert tracked["tracking"] == "tracking"


def test_a_bad_frame_of_a_stream_is_answered_and_the_stream_goes_on(site: Site) -> None:
    answered = asyncio.Event()

    async def frames() -> Any:
        yield Frame(b"no picture")
        await answered.wait()
        yield Frame(site.folder / "photo.jpg", {"axes": "arkit"})

    async def ask() -> list[Any]:
        async with AsyncRoomfix(site.url, site.names["KEY"]) as server:
            session = await server.create_session("museum", camera=site.names["CAMERA"])
            answers = []
            async for answer in server.stream(session["session"], frames()):
                answers.append(answer)
                answered.set()
            return answers

    bad, good = asyncio.run(ask())
    assert bad["code"] == "unsupported_image"
    assert (good["tracking"], good["axes"], good["received"]) == ("tracking", "arkit", 2)


def test_a_stream_ends_with_its_frames_however_late_they_end(site: Site) -> None:
    async def frames(answered: asyncio.Event, error: Exception | None) -> Any:
        yield Frame(site.folder / "photo.jpg")
        # The answer is there before the camera says that this was all.
        await answered.wait()
        if error is not None:
            raise error

    async def ask(error: Exception | None) -> list[Any]:
        async with AsyncRoomfix(site.url, site.names["KEY"]) as server:
            session = await server.create_session("museum", camera=site.names["CAMERA"])
            answered, received = asyncio.Event(), []
            async for answer in server.stream(session["session"], frames(answered, error)):
                received.append(answer["received"])
                answered.set()
            return received

    assert asyncio.run(asyncio.wait_for(ask(None), WAIT_S)) == [1]
    with pytest.raises(RuntimeError, match="lens cap"):
        asyncio.run(asyncio.wait_for(ask(RuntimeError("lens cap")), WAIT_S))


def test_a_build_that_fails_is_an_error(site: Site, tmp_path: Path) -> None:
    (tmp_path / "scan.zip").write_bytes(b"no archive")
    with Roomfix(site.url, site.names["ADMIN_KEY"]) as server:
        build = server.build(tmp_path / "scan.zip", "museum", {})
        with pytest.raises(BuildError):
            server.wait_for_build(build["build"], 0.1)


def test_what_was_uploaded_is_named_in_place_of_a_file() -> None:
    assert inspection(Uploaded("a1"), {"format": "tum"}, None).options() == {
        "data": {"options": '{"format": "tum"}', "upload": "a1"}
    }
    call = submission(Uploaded("a1"), "museum", {}, None)
    assert call.options() == call.options()
    assert call.options()["data"] == {"venue": "museum", "options": "{}", "upload": "a1"}


def test_only_what_passes_is_tried_again() -> None:
    assert pause_s(RoomfixError(503, "busy", "", 2.0), 0) == 2.0
    assert pause_s(RoomfixError(429, "too_many_requests", "", 500.0), 0) == LONGEST_PAUSE_S
    assert pause_s(httpx.ConnectError("x"), 1) == 1.0
    assert pause_s(RoomfixError(422, "invalid_input", ""), 0) is None
    assert pause_s(ValueError(), 0) is None


def test_fields_are_written_as_forms_have_them() -> None:
    given = {"camera": [1, 2.5], "prior": {"radius_m": 1}, "floor": None, "venue": "v", "timestamp": 1.5}
    assert form(given) == {"camera": "1,2.5", "prior": '{"radius_m": 1}', "venue": "v", "timestamp": "1.5"}
    pose = {"position": {"x": 1}}
    assert form({"motion": [pose], "cameras": [None, "1,2,3,4"]}) == {
        "motion": '[{"position": {"x": 1}}]',
        "cameras": '[null, "1,2,3,4"]',
    }
    assert form({"motion": pose}) == {"motion": '{"position": {"x": 1}}'}
    call = with_picture("/locate", b"0", {"images": [b"1", b"2"], "camera": [1]})
    assert call.options() == {
        "data": {"camera": "1"},
        "files": [("image", ("image", b"0")), ("images", ("image", b"1")), ("images", ("image", b"2"))],
    }


def test_the_client_needs_nothing_of_the_server() -> None:
    folder = README.parent / "roomfix_client"
    assert not [
        path
        for path in folder.glob("*.py")
        if re.search(r"^(from|import) app", path.read_text(), re.MULTILINE)
    ]
    assert "roomfix_client" in sys.modules
