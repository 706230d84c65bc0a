"""The AsyncAPI document of the WebSocket: made from the models of its messages, served at `/asyncapi.json`.

Source: the AsyncAPI specification 3.0.0.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, Depends
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from app.api.access.credentials import SUBPROTOCOL
from app.api.deps import public
from app.api.openapi import readable
from app.api.requests.contract_route import ContractRoute
from app.api.session_stream import CLOSE_GONE, CLOSE_REPLACED, CLOSE_TOO_BIG
from app.api.stream.messages import StreamedFrame, StreamHints, StreamProblem
from app.vision.image_files.formats import FORMATS_IN_WORDS

Document = dict[str, Any]

router = APIRouter(route_class=ContractRoute)
ADDRESS = "/sessions/{session}/stream"
REF = "#/components/schemas/{model}"
# By the message's name in the document.
MODELS: dict[str, type[BaseModel]] = {
    "hints": StreamHints, "answer": StreamedFrame, "problem": StreamProblem,
}  # fmt: skip
TITLES = {
    "hints": "What a client knows of the next frame",
    "answer": "The answer to a frame",
    "problem": "What is wrong with a message",
}
RECEIVED = ("frame", "hints")
SENT = ("answer", "problem")
FRAME: Document = {
    "name": "frame",
    "title": "A frame",
    "summary": f"A binary message: a picture as {FORMATS_IN_WORDS}. Of those that wait only the newest is answered.",
    "contentType": "application/octet-stream",
    "payload": {"type": "string", "format": "binary"},
}
DESCRIPTION = (
    "The stream of a session, which `POST /sessions` starts: frames in, answers out. All other calls are in "
    "`/openapi.json`."
)
CHANNEL = (
    "Binary messages are frames; a text message before one holds its hints; each answer is one text message. "
    f"The server closes the connection with {CLOSE_REPLACED} when another one takes the session over, {CLOSE_GONE} "
    f"when the session has ended, {CLOSE_TOO_BIG} after a message that is too large. A connection that is refused gets "
    "a problem as its HTTP answer: 401, 403, 404 or 429."
)
PROTOCOLS = {
    "type": "object",
    "properties": {
        "Sec-WebSocket-Protocol": {
            "type": "string",
            "description": f"From a browser, which can't set Authorization: {SUBPROTOCOL}, {SUBPROTOCOL}.key.KEY",
        }
    },
}


@router.get("/asyncapi.json", name="getAsyncapi", include_in_schema=False, dependencies=[Depends(public)])
def get() -> JSONResponse:
    """Return the AsyncAPI document of the session's stream."""
    return JSONResponse(asyncapi_document())


@cache
def asyncapi_document() -> Document:
    """Return the AsyncAPI document of the server."""
    channel = "#/channels/sessionStream"
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Roomfix",
            "version": version("roomfix"),
            "description": DESCRIPTION,
            "license": {"name": "Apache 2.0", "url": "https://www.apache.org/licenses/LICENSE-2.0"},
        },
        "defaultContentType": "application/json",
        "servers": {
            "this": {
                "host": "{host}",
                "protocol": "wss",
                "description": "This server; ws where it has no certificate.",
                "variables": {"host": {"default": "localhost:8000"}},
                "security": [{"$ref": "#/components/securitySchemes/key"}],
            }
        },
        "channels": {
            "sessionStream": {
                "address": ADDRESS,
                "title": "The stream of a session",
                "description": CHANNEL,
                "parameters": {"session": {"description": "The session's id"}},
                "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in (*RECEIVED, *SENT)},
                "bindings": {"ws": {"method": "GET", "headers": PROTOCOLS}},
            }
        },
        "operations": {
            action: {
                "action": action,
                "channel": {"$ref": channel},
                "summary": summary,
                "messages": [{"$ref": f"{channel}/messages/{name}"} for name in names],
            }
            for action, summary, names in (
                ("receive", "What the server takes", RECEIVED),
                ("send", "What the server answers", SENT),
            )
        },
        "components": {
            "messages": {"frame": FRAME, **{name: _message(name) for name in MODELS}},
            "schemas": _schemas(),
            "securitySchemes": {
                "key": {"type": "http", "scheme": "bearer", "description": "A key or token of the server."}
            },
        },
    }


def _message(name: str) -> Document:
    model = MODELS[name]
    example = model.model_config.get("json_schema_extra")
    examples = [{"payload": example["example"]}] if isinstance(example, dict) else []
    return {
        "name": name,
        "title": TITLES[name],
        "summary": " ".join((model.__doc__ or "").split("\n\n", maxsplit=1)[0].split()),
        "contentType": "application/json",
        "payload": {"$ref": REF.format(model=readable(model.__name__))},
        "examples": examples,
    }


def _schemas() -> Document:
    """Return the schemas of the messages under their readable names, with examples as JSON Schema has them."""
    modes: list[tuple[type[BaseModel], Any]] = [
        (model, "validation" if name == "hints" else "serialization") for name, model in MODELS.items()
    ]
    _, found = models_json_schema(modes, ref_template=REF)
    schemas: Document = found["$defs"]
    text = json.dumps(schemas)
    for name in schemas:
        text = text.replace(f'"{REF.format(model=name)}"', f'"{REF.format(model=readable(name))}"')
    renamed: Document = {readable(name): schema for name, schema in json.loads(text).items()}
    for name, schema in renamed.items():
        schema["title"] = name
        if "example" in schema:
            schema["examples"] = [schema.pop("example")]
    return renamed
