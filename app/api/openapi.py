"""The OpenAPI document: unique readable names, every error as problem+json, tags in words."""

from __future__ import annotations

import json
import re
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from app.api.schemas import FILE_CONTENT, PROBLEM_MEDIA_TYPE, Problem

Document = dict[str, Any]

TAGS = (
    ("locate", "Where a single picture was taken."),
    ("sessions", "A moving phone: frames one after the other, and guidance to a destination."),
    ("venues", "Buildings or sites; everything else belongs to one of them."),
    ("floors", "Floors, their plan images and features, and plans drawn with both."),
    ("maps", "Scans become map versions, of which one serves a venue."),
    ("routes", "The shortest way from one place to another, step by step."),
    ("anchors", "Monitoring cameras that give a place where nobody has scanned."),
    ("keys", "Who may call: keys, short-lived tokens, and what administrators did."),
    ("operation", "Health and metrics."),
)
# Answers that any call with a body may have: a broken form, one that is too large, an encoding that isn't read.
WITH_BODY = (400, 413, 415)
# Generators of clients know no media types of pictures; a call that takes a picture takes it under this name too.
RAW_PICTURE = "application/octet-stream"
RAW_IN_WORDS = (
    "\n\nThe body may also be the picture itself, with the other fields as query parameters, or JSON with the picture "
    "as base64."
)
METHODS = ("get", "put", "post", "patch", "delete", "head")
# Schemas of FastAPI's own error body, which no call answers with.
UNUSED = ("HTTPValidationError", "ValidationError")
# FastAPI names the schema of a form by this and the route.
FORM_PREFIX = "Body_"


def operation_id(route: APIRoute) -> str:
    """Return the operationId of a route, which is its name."""
    return route.name


def install_openapi(app: FastAPI) -> None:
    """Let an app describe itself by `openapi_document`, made once."""

    def openapi() -> Document:
        if app.openapi_schema is None:
            app.openapi_schema = openapi_document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def openapi_document(app: FastAPI) -> Document:
    """Return the OpenAPI document of an app."""
    document = get_openapi(
        title=app.title,
        version=app.version,
        description=app.description,
        routes=app.routes,
        tags=[{"name": name, "description": description} for name, description in TAGS],
        servers=[{"url": "/", "description": "This server"}],
        license_info={"name": "Apache 2.0", "identifier": "Apache-2.0"},
    )
    schemas = document["components"]["schemas"]
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= {**problem.pop("$defs"), "Problem": problem}
    for name, schema in schemas.items():
        if name.startswith(FORM_PREFIX):
            # A field that a form doesn't have is refused, as a key of a JSON body is.
            schema["additionalProperties"] = False
    for calls in document["paths"].values():
        for method in METHODS:
            if method in calls:
                _describe_errors(calls[method])
                _describe_pictures(calls[method], schemas)
                # Without this a call that needs no key would look like one that was forgotten.
                calls[method].setdefault("security", [])
    for schema in schemas.values():
        for field in schema.get("properties", {}).values():
            if _is_binary(field):
                # Generators of clients know this word of OpenAPI 3.0 better than the newer one.
                field["format"] = "binary"
    for name in UNUSED:
        schemas.pop(name, None)
    for schema in schemas.values():
        if "example" in schema:
            _restore_nulls(schema["example"], schema, schemas)
    return _renamed(document)


def _restore_nulls(example: Any, schema: Document, schemas: Document) -> None:
    """Put the nulls back into an example that FastAPI has left out: a required field is missing for no other reason."""
    if "$ref" in schema:
        schema = schemas[schema["$ref"].rpartition("/")[2]]
    for choice in schema.get("anyOf", ()):
        if choice.get("type") != "null":
            _restore_nulls(example, choice, schemas)
    if isinstance(example, list):
        for item in example:
            _restore_nulls(item, schema.get("items", {}), schemas)
    elif isinstance(example, dict) and "properties" in schema:
        for field in schema.get("required", ()):
            example.setdefault(field, None)
        for field, value in example.items():
            _restore_nulls(value, schema["properties"].get(field, {}), schemas)


def _describe_errors(call: Document) -> None:
    """Give every error of a call the body that it has; add those that any body may lead to."""
    answers = call["responses"]
    for status in WITH_BODY if "requestBody" in call else ():
        answers.setdefault(str(status), {"description": "The body can't be read"})
    for status, answer in answers.items():
        if status >= "400" and not _is_described(answer):
            answer["content"] = {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}


def _describe_pictures(call: Document, schemas: Document) -> None:
    """Add to a call whose form has one file `image` what may stand for the form: the picture itself, or JSON."""
    content = call.get("requestBody", {}).get("content", {})
    for kind in [kind for kind in content if kind.startswith("image/")]:
        del content[kind]
        content[RAW_PICTURE] = FILE_CONTENT
    reference = content.get("multipart/form-data", {}).get("schema", {}).get("$ref", "")
    form = schemas.get(reference.rpartition("/")[2])
    if form is None or not _is_binary(form["properties"].get("image", {})):
        return
    picture = {"type": "string", "contentEncoding": "base64", "description": "The picture as base64"}
    fields = {**form["properties"], "image": picture}
    name = f"{readable(reference.rpartition('/')[2]).removesuffix('Form')}Json"
    schemas[name] = {**form, "title": name, "properties": fields}
    content["application/json"] = {"schema": {"$ref": f"#/components/schemas/{name}"}}
    content[RAW_PICTURE] = FILE_CONTENT
    call["description"] += RAW_IN_WORDS


def _is_binary(schema: Document) -> bool:
    return schema.get("format") == "binary" or schema.get("contentMediaType") == "application/octet-stream"


def _is_described(answer: Document) -> bool:
    """Whether an error has another schema than that of a problem or of FastAPI."""
    for content in answer.get("content", {}).values():
        reference = content.get("schema", {}).get("$ref", "")
        if reference and not reference.endswith(("/Problem", "/HTTPValidationError")):
            return True
    return False


def _renamed(document: Document) -> Document:
    """Return the document with readable names of schemas: `Venue` for VenueBody, `LocateImageForm` for a form."""
    names = {name: readable(name) for name in document["components"]["schemas"]}
    if len(set(names.values())) < len(names):
        raise ValueError(f"two schemas have one name: {sorted(names.values())}")
    text = json.dumps(document)
    for old, new in names.items():
        text = text.replace(f'"#/components/schemas/{old}"', f'"#/components/schemas/{new}"')
    renamed: Document = json.loads(text)
    schemas = renamed["components"]["schemas"]
    renamed["components"]["schemas"] = {
        names[name]: {**schemas[name], "title": names[name]} for name in schemas
    }
    return renamed


def readable(name: str) -> str:
    """Return the name of a schema as clients see it."""
    form = re.fullmatch(r"Body_(\w)(\w*)", name)
    if form is not None:
        return f"{form[1].upper()}{form[2]}Form"
    return name.removesuffix("Body")
