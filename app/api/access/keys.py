"""Keys and tokens: listed, made and revoked. A key's text is in the answer that makes it, and nowhere else."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from app.api.access.log_acts import VENUE
from app.api.deps import ID_PATTERN, CallerOf, State, require
from app.api.requests.contract_route import ContractRoute
from app.api.requests.fields import FIELDS
from app.api.requests.json_body import RequestBody
from app.api.requests.paging import Paged
from app.api.schemas import problems
from app.services.keys.key_service import OPTIONS as LIFE
from app.services.keys.key_service import NewKey
from app.storage.keys import Key, Scope, TokenScope

router = APIRouter(
    prefix="/keys", tags=["keys"], dependencies=[Depends(require("admin"))], route_class=ContractRoute
)
tokens = APIRouter(
    prefix="/tokens", tags=["keys"], dependencies=[Depends(require("locate"))], route_class=ContractRoute
)
KeyId = Annotated[str, Path(pattern=r"^[0-9a-f]{16}$", description="The id of a key or token")]
NO_STORE = "no-store"


class KeyRequest(RequestBody):
    """A key to make."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"name": "Museum app", "scope": "locate", "venue": "museum", "expires_in_s": 2592000}
        }
    )

    name: str = Field(min_length=1, max_length=FIELDS.max_name_characters, description="Whose key it is")
    scope: Scope = Field(description="What it may do; admin may do everything")
    venue: str | None = Field(None, pattern=ID_PATTERN, description="Limits it to one venue")
    camera: str | None = Field(
        None, pattern=ID_PATTERN, description="Scope anchor: limits it to one monitoring camera"
    )
    expires_in_s: float | None = Field(
        None,
        gt=0,
        le=FIELDS.max_key_expiry_s,
        allow_inf_nan=False,
        description="After how many seconds it ends; never if left out",
        json_schema_extra={"minimum": LIFE.min_expiry_s},
    )


KEY: dict[str, Any] = {
    "key": "3f0c52a91b7de604",
    "name": "Museum app",
    "scope": "locate",
    "venue": "museum",
    "camera": None,
    "created_by": "ROOMFIX_ADMIN_KEY",
    "created_at": "2026-03-01T09:00:00Z",
    "expires_at": "2026-03-31T09:00:00Z",
    "revoked_at": None,
    "last_used_at": None,
}


class KeyInfo(BaseModel):
    """A key without its text."""

    model_config = ConfigDict(json_schema_extra={"example": KEY})

    key: str = Field(description="Its id")
    name: str
    scope: Scope
    venue: str | None
    camera: str | None
    created_by: str = Field(description="Name of the key that it was made with")
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None = Field(description="To the minute")

    @staticmethod
    def of(key: Key) -> KeyInfo:
        """Return the body of a key."""
        return KeyInfo(**_values(key))


class CreatedKey(KeyInfo):
    """A key that was just made, with its text: it can't be shown again."""

    model_config = ConfigDict(json_schema_extra={"example": {**KEY, "text": "rfk_3f0c52a91b7de604_SECRET"}})

    text: str = Field(description="What goes into `Authorization: Bearer`")


class TokenRequest(RequestBody):
    """A token to make."""

    model_config = ConfigDict(json_schema_extra={"example": {"venue": "museum", "expires_in_s": 3600}})

    venue: str | None = Field(
        None, pattern=ID_PATTERN, description="May be left out with a key that is limited to one venue"
    )
    expires_in_s: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="After how many seconds it ends; an hour if left out",
        json_schema_extra={"minimum": LIFE.min_expiry_s, "maximum": LIFE.max_token_expiry_s},
    )
    scope: TokenScope = Field(
        "locate", description="What it may do; `record` needs a key of that scope, or of admin"
    )


class CreatedToken(BaseModel):
    """A short-lived token for a phone or a QR code, for one venue."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "token": "rft_9b1de60452a91b7d_SECRET",
                "key": "9b1de60452a91b7d",
                "venue": "museum",
                "expires_at": "2026-03-01T10:00:00Z",
            }
        }
    )

    token: str = Field(description="What goes into `Authorization: Bearer`")
    key: str = Field(description="Its id; DELETE /keys revokes it")
    venue: str
    expires_at: datetime


def _values(key: Key) -> dict[str, object]:
    values = {name: getattr(key, name) for name in KeyInfo.model_fields if hasattr(key, name)}
    return {**values, "key": key.id, "venue": key.venue_id, "camera": key.camera_id}


def _unstored(response: Response, request: Request, made: NewKey) -> None:
    """Let no cache keep an answer with a secret; the audit log gets the key's venue."""
    response.headers["Cache-Control"] = NO_STORE
    request.scope[VENUE] = made.key.venue_id


@router.post("", name="createKey", status_code=201, responses=problems(401, 404, 422))
def create_key(
    state: State, caller: CallerOf, body: KeyRequest, request: Request, response: Response
) -> CreatedKey:
    """Make a key; its text is shown this once."""
    made = state.services.keys.create(
        caller, body.name, body.scope, body.venue, camera_id=body.camera, expires_in_s=body.expires_in_s
    )
    _unstored(response, request, made)
    return CreatedKey(**_values(made.key), text=made.text)


@router.get("", name="listKeys", responses=problems(401, 422))
def list_all(state: State, caller: CallerOf, page: Paged) -> list[KeyInfo]:
    """List keys without their texts, revoked and expired ones too; tokens are not listed."""
    return [KeyInfo.of(key) for key in page.of(state.services.keys.list(caller), lambda key: key.id)]


@router.delete("/{key}", name="revokeKey", status_code=204, responses=problems(401, 404, 422))
def revoke_key(state: State, caller: CallerOf, key: KeyId, request: Request) -> Response:
    """Revoke a key with all its tokens, or a single token, from the next call on."""
    request.scope[VENUE] = state.services.keys.revoke(caller, key).venue_id
    return Response(status_code=204)


@tokens.post("", name="createToken", status_code=201, responses=problems(401, 404, 422))
def create_token(
    state: State, caller: CallerOf, body: TokenRequest, request: Request, response: Response
) -> CreatedToken:
    """Make a token of minutes to hours for one venue, to give to a phone in place of a key."""
    made = state.services.keys.create_token(caller, body.venue, body.expires_in_s, body.scope)
    _unstored(response, request, made)
    assert made.key.venue_id is not None and made.key.expires_at is not None  # noqa: S101, PT018 - tokens have both
    return CreatedToken(
        token=made.text, key=made.key.id, venue=made.key.venue_id, expires_at=made.key.expires_at
    )
