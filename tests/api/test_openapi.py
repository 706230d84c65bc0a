"""The OpenAPI document: readable names, typed answers, valid examples, errors as problem+json."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

import app.api
from app.api.openapi import TAGS, openapi_document, readable
from app.api.schemas import PROBLEM_MEDIA_TYPE
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings

DOCUMENT = openapi_document(create_app(Settings(_env_file=None, open=True), NoRunner()))
SCHEMAS = DOCUMENT["components"]["schemas"]
# What a client may put there is its own.
FREE = {
    ("FeatureProperties", None), ("AnchorCalibration", None), ("BuildReport", "replaced"),
    ("BuildReport", "examination"), ("BuildReport", "calibration"),
}  # fmt: skip


def operations() -> list[tuple[str, dict[str, Any]]]:
    return [
        (f"{method.upper()} {path}", call)
        for path, calls in DOCUMENT["paths"].items()
        for method, call in calls.items()
    ]


def models() -> Iterator[type[BaseModel]]:
    """Yield the models of the API that have an example."""
    for found in pkgutil.walk_packages(app.api.__path__, "app.api."):
        for _, value in inspect.getmembers(importlib.import_module(found.name), inspect.isclass):
            extra = value.model_config.get("json_schema_extra") if issubclass(value, BaseModel) else None
            if isinstance(extra, dict) and value.__module__ == found.name:
                yield value


def test_operations_have_unique_readable_ids_summaries_and_known_tags() -> None:
    ids = [call["operationId"] for _, call in operations()]
    assert len(set(ids)) == len(ids) > 40
    assert {"locateImage", "buildMap", "listVenues", "pushAnchorFrame", "createToken"} <= set(ids)
    assert all(re.fullmatch(r"[a-z]+([A-Z][a-z]+)+", each) for each in ids)
    for name, call in operations():
        assert 4 < len(call["summary"]) < 120, name
        assert not call["summary"].endswith("."), name
        assert set(call["tags"]) <= {tag for tag, _ in TAGS}, name
    assert {tag["name"] for tag in DOCUMENT["tags"]} == {
        tag for _, call in operations() for tag in call["tags"]
    }


def test_schemas_have_readable_names() -> None:
    assert all(re.fullmatch(r"[A-Z][A-Za-z0-9]+", name) for name in SCHEMAS)
    assert not [name for name in SCHEMAS if name.endswith(("Body", "-Input", "-Output"))]
    assert {"LocateResult", "Venue", "Floor", "Anchor", "BuildReport", "SessionGuidance", "Problem"} <= set(
        SCHEMAS
    )
    assert readable("Body_locateImage") == "LocateImageForm"


def untyped(schema: dict[str, Any]) -> bool:
    """Whether a schema says nothing of what it holds."""
    if "anyOf" in schema:
        return any(untyped(part) for part in schema["anyOf"] if part.get("type") != "null")
    if schema.get("type") == "array" and "prefixItems" not in schema:
        return untyped(schema.get("items", {}))
    if schema.get("type") == "object" and "properties" not in schema:
        inner = schema.get("additionalProperties", True)
        return inner is True or untyped(inner)
    return not ({"type", "$ref", "const", "enum"} & set(schema))


def test_every_reference_leads_to_a_schema() -> None:
    references = set(re.findall(r"'\$ref': '([^']+)'", str(DOCUMENT)))
    assert references <= {f"#/components/schemas/{name}" for name in SCHEMAS}
    assert len(references) > 40


def test_no_answer_is_untyped() -> None:
    answers = set()
    for name, call in operations():
        for status, answer in call["responses"].items():
            for kind, content in answer.get("content", {}).items():
                if kind.endswith("json"):
                    assert not untyped(content.get("schema", {})), (name, status)
                    answers |= set(re.findall(r"schemas/(\w+)", str(content)))
    open_names = set(answers)
    while open_names:
        found = {
            other for name in open_names for other in re.findall(r"schemas/(\w+)", str(SCHEMAS[name]))
        } - answers
        answers |= found
        open_names = found
    loose = {
        (name, field)
        for name in answers
        for field, schema in SCHEMAS[name].get("properties", {}).items()
        if untyped(schema) and (name, field) not in FREE
    }
    assert not loose


def test_every_error_is_a_problem() -> None:
    for name, call in operations():
        for status, answer in call["responses"].items():
            if status < "400" or (name, status) == ("GET /readyz", "503"):
                continue
            assert answer["content"] == {
                PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}
            }, (name, status)
        if call["security"]:
            assert {"401", "403", "429"} <= set(call["responses"]), name


@pytest.mark.parametrize("model", list(models()), ids=lambda model: model.__name__)
def test_an_example_is_valid_and_names_no_other_field(model: type[BaseModel]) -> None:
    extra = model.model_config["json_schema_extra"]
    assert isinstance(extra, dict)
    example = extra["example"]
    assert isinstance(example, dict)
    read = model.model_validate(example)
    assert set(read.model_dump(exclude_unset=True)) == set(example)
    assert set(example) <= set(model.model_fields)


def test_every_json_answer_and_body_has_an_example() -> None:
    missing = []
    for name, call in operations():
        answers = [answer for status, answer in call["responses"].items() if status.startswith("2")]
        bodies = [call.get("requestBody", {}), *answers]
        for body in bodies:
            for kind, content in body.get("content", {}).items():
                schema = content.get("schema", {})
                reference = (schema.get("items") or schema).get("$ref", "").rpartition("/")[2]
                described = "example" in content or "example" in SCHEMAS.get(reference, {})
                is_form = reference.endswith(("Form", "Json"))
                if kind.endswith("json") and not described and not is_form and "GeoJson" not in reference:
                    missing.append((name, reference))
    assert {reference for _, reference in missing} <= {"FloorFeatureCollection"}
