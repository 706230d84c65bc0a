"""The options of a build in OpenAPI are those that the parser takes."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel

from app.api.requests.build_options import BuildOptionsBody, KeyframesOption
from app.engine.mapping.keyframe_rule import KEYS as KEYFRAME_KEYS
from app.engine.mapping.options import KEYS, BuildOptions, parse_build_options
from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from tests.server import Server


def options_schema(server: Server, path: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the schema of the field `options` of a call, and that of the JSON in it."""
    document = server.client.get("/openapi.json").json()
    reference = document["paths"][path]["post"]["requestBody"]["content"]["multipart/form-data"]["schema"][
        "$ref"
    ]
    schemas = document["components"]["schemas"]
    field = schemas[reference.rsplit("/", 1)[1]]["properties"]["options"]
    return field, schemas[field["contentSchema"]["$ref"].rsplit("/", 1)[1]]


@pytest.mark.parametrize("path", ["/database/build", "/database/calibrate"])
def test_openapi_shows_every_option_with_a_description_and_an_example(museum: Server, path: str) -> None:
    schema, content = options_schema(museum, path)
    assert (schema["type"], schema["contentMediaType"]) == ("string", "application/json")
    assert set(content["properties"]) == KEYS
    assert all(option["description"] for option in content["properties"].values())
    assert parse_build_options(content["example"]).scan.depth_scale == 1000


def test_the_keys_of_a_keyframe_rule_are_described() -> None:
    keys = {"rule", *(key for keys in KEYFRAME_KEYS.values() for key in keys)}
    assert set(KeyframesOption.model_fields) == keys


def test_the_defaults_are_those_of_the_parser() -> None:
    stated = BuildOptionsBody().model_dump(exclude_none=True)
    assert parse_build_options(stated) == parse_build_options({}) == BuildOptions()


@pytest.mark.parametrize("model", [BuildOptionsBody, KeyframesOption])
def test_the_choices_are_those_of_the_parser(model: type[BaseModel]) -> None:
    choices = {
        name: schema["enum"]
        for name, schema in model.model_json_schema()["properties"].items()
        if "enum" in schema
    }
    assert choices
    for name, values in choices.items():
        for value in values:
            options = {name: value} if model is BuildOptionsBody else {"keyframes": {name: value}}
            try:
                parse_build_options(options)
            except InvalidInputError as error:
                # Features of an extra that is not installed.
                assert "roomfix[" in str(error), (name, value)  # noqa: PT017
        wrong = {name: "no such"} if model is BuildOptionsBody else {"keyframes": {name: "no such"}}
        with pytest.raises(InvalidInputError):
            parse_build_options(wrong)


def test_an_option_of_each_kind_is_read() -> None:
    matrix = Pose.identity().matrix.tolist()
    options = BuildOptionsBody(
        gravity=[0, 0, -1], world_from_scan=matrix, depth_shift_px=[1, -2], rotate_deg=90, mount_deg=[1, 2, 3]
    )
    parsed = parse_build_options(options.model_dump(exclude_unset=True))
    assert parsed.gravity == (0, 0, -1)
    assert parsed.scan.depth_shift_px == (1, -2)
    assert parsed.scan.convention.rotate_deg == 90
    assert parsed.scan.convention.mount_deg == (1, 2, 3)
