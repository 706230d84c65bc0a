"""Form fields that hold JSON, described in OpenAPI by a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue


@dataclass(frozen=True, slots=True)
class JsonTextOf:
    """Marks text that holds JSON of a model's form. It describes only: a parser of the engine reads the text."""

    model: type[BaseModel]

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema of the text with that of its content."""
        content = handler(self.model.__pydantic_core_schema__)
        return {**handler(schema), "contentMediaType": "application/json", "contentSchema": content}
