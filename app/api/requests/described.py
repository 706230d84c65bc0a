"""Values that a parser of the engine reads, described in OpenAPI by a type that the request is not validated by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue

from app.geometry.camera import MODEL_PARAMETERS
from app.geometry.camera_hint import COUNTS, SIMPLE_MODELS


@dataclass(frozen=True, slots=True)
class DescribedAs:
    """Marks a value whose JSON schema is that of another type. It describes only."""

    type: Any

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema of the other type."""
        return handler(TypeAdapter(self.type).core_schema)


class GivenCamera(BaseModel):
    """A camera by one of COLMAP's models, for images of this size or scaled ones."""

    model_config = ConfigDict(extra="forbid")

    model: str = Field("PINHOLE", json_schema_extra={"enum": [*MODEL_PARAMETERS, *SIMPLE_MODELS]})
    width: int
    height: int
    params: list[float] = Field(
        description="As COLMAP orders them: focal lengths, principal point, distortion"
    )


CAMERA_TYPES = (
    Annotated[str, Field(min_length=1)]
    | GivenCamera
    | Annotated[list[float], Field(min_length=min(COUNTS), max_length=max(COUNTS))]
)
Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix4 = Annotated[list[Row], Field(min_length=4, max_length=4)]


class Correspondence(BaseModel):
    """One point in the world and on the plan."""

    model_config = ConfigDict(extra="forbid")

    world: list[float] = Field(min_length=2, max_length=3)
    plan: list[float] = Field(min_length=2, max_length=2)


class Correspondences(BaseModel):
    """Points that are known in the world and on the plan; the transform is fitted to them."""

    model_config = ConfigDict(extra="forbid")

    correspondences: list[Correspondence] = Field(min_length=2)


PLAN_FROM_WORLD_TYPES = Matrix4 | Correspondences
