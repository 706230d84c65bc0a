"""The schemas by which the server describes its answers."""

from __future__ import annotations

from functools import cache
from typing import Any

from app.api.openapi import openapi_document
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings


@cache
def schemas() -> dict[str, Any]:
    """Return the schemas of the OpenAPI document by name; to make it takes most of a second."""
    document = openapi_document(create_app(Settings(_env_file=None, open=True), NoRunner()))
    return dict(document["components"]["schemas"])
