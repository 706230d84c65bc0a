"""JSON bodies whose keys are all known."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from app.api.requests.names import Known, refusal, shown, unknown_names


def whole(value: object) -> object:
    """Return a whole number such as 2.0 as an int, as JSON schema understands integers; other values as they are."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


class RequestBody(BaseModel):
    """A JSON object of a request. A key that it doesn't have is refused, with the key that was probably meant, and so
    is a value of another JSON type than the one described, such as true for a number."""

    model_config = ConfigDict(extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        known = {
            field.alias or name: Known(field.alias or name, field.description or "")
            for name, field in cls.model_fields.items()
        }
        errors = [
            InitErrorDetails(
                type=PydanticCustomError(
                    "unknown_name", "{message}", {"message": refusal(name, known, {}, given=values)}
                ),
                loc=(shown(name),),
                input=None,
            )
            for name in unknown_names(values, known)
        ]
        if errors:
            raise ValidationError.from_exception_data(cls.__name__, errors)
        return values
