"""The AsyncAPI document: what the stream takes and sends, and nothing else, in a form that AsyncAPI's parser reads."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from fastapi.routing import APIWebSocketRoute

from app.api import session_stream
from app.api.openapi import readable
from app.api.stream.asyncapi import ADDRESS, MODELS, RECEIVED, SENT, asyncapi_document
from app.api.stream.messages import StreamedFrame, StreamHints, StreamProblem
from tests.api.key_rows import calls
from tests.api.test_session_stream import connected
from tests.api.test_sessions import start
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server

DOCUMENT = asyncapi_document()
SCHEMAS = DOCUMENT["components"]["schemas"]
POSE = {"position": {"x": 0, "y": 0, "z": 0}, "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1}}
# A folder in which `npm install @asyncapi/parser` was run.
CLIENT = Path(__file__).parents[2] / "clients" / "typescript" / "node_modules"
MODULES = Path(os.environ.get("ROOMFIX_TEST_NODE_MODULES", CLIENT))
needs_parser = pytest.mark.skipif(
    not (MODULES / "@asyncapi" / "parser").exists() or shutil.which("node") is None,
    reason="@asyncapi/parser is not installed: npm install @asyncapi/parser",
)
PARSE = """
const { Parser } = require("@asyncapi/parser");
const text = require("fs").readFileSync(process.argv[2], "utf8");
new Parser().parse(text).then(({ document, diagnostics }) => {
  const found = diagnostics.filter((each) => each.severity < 2).map((each) => [each.path.join("."), each.message]);
  const messages = document ? document.messages().all().map((each) => each.id()) : [];
  console.log(JSON.stringify({ found, messages }));
});
"""


def of_document(name: str, message: dict[str, Any]) -> Any:
    """Check that a text message has no other members than the document names, and return it as the server's model."""
    model = MODELS[name]
    assert set(message) <= set(SCHEMAS[readable(model.__name__)]["properties"])
    return model.model_validate(message)


def test_the_document_is_served_without_a_key_and_is_all_of_the_websockets(empty: Server) -> None:
    answer = empty.client.get("/asyncapi.json")
    assert answer.status_code == 200
    assert answer.json() == DOCUMENT
    assert {call for call in calls(empty.client.app) if call.startswith("WS")} == {f"WS {ADDRESS}"}
    route = next(each for each in session_stream.router.routes if isinstance(each, APIWebSocketRoute))
    assert route.path == ADDRESS == DOCUMENT["channels"]["sessionStream"]["address"]
    assert "asyncapi.json" in empty.client.get("/docs").text


def test_every_message_is_in_an_operation_and_has_a_schema() -> None:
    messages = DOCUMENT["components"]["messages"]
    assert set(messages) == {*RECEIVED, *SENT} == {"frame", *MODELS}
    operations = DOCUMENT["operations"]
    for action, names in (("receive", RECEIVED), ("send", SENT)):
        own = [each["$ref"].rpartition("/")[2] for each in operations[action]["messages"]]
        assert own == list(names)
    text = json.dumps(DOCUMENT)
    assert "Body" not in text.replace("a Body", "")
    for name in (each.split('"')[0] for each in text.split('"#/components/schemas/')[1:]):
        assert name in SCHEMAS


def test_the_server_takes_the_hints_of_the_document_and_no_others() -> None:
    assert set(SCHEMAS["StreamHints"]["properties"]) == set(session_stream.HINTS)
    every = {
        "camera": CAMERA_TEXT, "gravity": [0, 1, 0], "motion": POSE, "timestamp": 1.5, "axes": "arkit",
        "device_pose": POSE,
    }  # fmt: skip
    assert set(every) == set(StreamHints.model_validate(every).model_fields_set) == set(session_stream.HINTS)


def test_what_the_stream_sends_is_in_the_document(museum: Server, queries: list[View]) -> None:
    hints = {
        "camera": CAMERA_TEXT, "gravity": [0, 1, 0], "motion": POSE, "timestamp": 1.5, "axes": "opencv",
        "device_pose": POSE,
    }  # fmt: skip
    with connected(museum, start(museum)) as socket:
        socket.send_text(json.dumps(hints))
        socket.send_bytes(queries[0].jpeg())
        answer = of_document("answer", socket.receive_json())
        assert isinstance(answer, StreamedFrame)
        assert (answer.received, answer.session_from_world is not None) == (1, answer.located)
        for message in (b"no picture", "no json", json.dumps({"nothing": 1})):
            (socket.send_bytes if isinstance(message, bytes) else socket.send_text)(message)  # type: ignore[operator]
            problem = of_document("problem", socket.receive_json())
            assert isinstance(problem, StreamProblem)
            assert problem.received in (1, 2)
        socket.send_bytes(queries[0].jpeg())
        assert of_document("answer", socket.receive_json()).received == 3


@needs_parser
def test_asyncapis_own_parser_finds_nothing_wrong(tmp_path: Path) -> None:
    (tmp_path / "asyncapi.json").write_text(json.dumps(DOCUMENT), encoding="utf-8")
    (tmp_path / "parse.cjs").write_text(PARSE, encoding="utf-8")
    (tmp_path / "node_modules").symlink_to(MODULES)
    command = ["node", "parse.cjs", "asyncapi.json"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert ran.returncode == 0, ran.stderr
    parsed = json.loads(ran.stdout)
    assert parsed["found"] == []
    assert set(parsed["messages"]) == {*RECEIVED, *SENT}
