"""Resumable uploads by the tus protocol 1.0.0: core, creation, expiration and termination."""

from __future__ import annotations

import base64
import binascii
from email.utils import format_datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Path, Request, Response
from fastapi.concurrency import contextmanager_in_threadpool
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from app.api.deps import CallerOf, State, public, require
from app.api.errors import TUS_VERSION
from app.api.requests.contract_route import ContractRoute
from app.api.requests.form_request import media_type
from app.api.schemas import FILE_CONTENT, problems
from app.errors import InvalidInputError, UnknownProtocolError, UnsupportedMediaError
from app.services.keys.caller import Caller
from app.storage.uploads import Upload, UploadFolder

EXTENSIONS = "creation,expiration,termination"
PART_MEDIA_TYPE = "application/offset+octet-stream"
# Pieces of a body are gathered to this size before they are written.
PIECE_BYTES = 1_000_000


class UploadRoute(ContractRoute):
    """A route whose body is a part of a scan. Parts are not acts of their own in the audit log: the build is."""

    body_kind = "archive"
    is_noted = False


def speaks_tus(
    tus_resumable: Annotated[str, Header(description="The protocol's version", examples=[TUS_VERSION])],
) -> None:
    """Raise `UnknownProtocolError` for another version of the protocol."""
    if tus_resumable != TUS_VERSION:
        raise UnknownProtocolError(f"Uploads speak tus {TUS_VERSION}; say so in Tus-Resumable.")


router = APIRouter(prefix="/uploads", tags=["maps"], route_class=UploadRoute)
ADMIN = [Depends(require("admin")), Depends(speaks_tus)]
UploadId = Annotated[str, Path(max_length=64, description="The upload's id, the end of its Location")]
# A header that an answer has.
TEXT: dict[str, Any] = {"schema": {"type": "string"}}
PART_BODY: dict[str, Any] = {"requestBody": {"required": True, "content": {PART_MEDIA_TYPE: FILE_CONTENT}}}


@router.options(
    "", name="describeUploads", status_code=204, dependencies=[Depends(public)], include_in_schema=False
)
def describe(state: State) -> Response:
    """Say what of the protocol is spoken, and how large an upload may be."""
    headers = {
        "Tus-Version": TUS_VERSION,
        "Tus-Extension": EXTENSIONS,
        "Tus-Max-Size": str(state.services.uploads.max_bytes),
    }
    return _answer(204, headers)


@router.post(
    "",
    name="createUpload",
    status_code=201,
    response_class=Response,
    dependencies=ADMIN,
    responses={
        201: {"headers": {"Location": TEXT, "Upload-Expires": TEXT}},
        **problems(401, 412, 413, 422, 507),
    },
)
def create(
    state: State,
    caller: CallerOf,
    upload_length: Annotated[int, Header(ge=1, description="Bytes of the whole file")],
    upload_metadata: Annotated[
        str | None,
        Header(description="Names and base64 values; `venue` lets keys of that venue alone go on with it"),
    ] = None,
) -> Response:
    """Begin an upload of a scan, which is refused here if it can't fit: nothing of it has travelled yet."""
    venue = caller.venue_or_own(_metadata(upload_metadata).get("venue"))
    upload = state.services.uploads.create(upload_length, venue)
    return _answer(201, {"Location": f"/uploads/{upload.id}", "Upload-Expires": _expiry(upload)})


@router.head(
    "/{upload}",
    name="getUploadOffset",
    response_class=Response,
    dependencies=ADMIN,
    responses={
        200: {"headers": {"Upload-Offset": TEXT, "Upload-Length": TEXT, "Upload-Expires": TEXT}},
        **problems(401, 404, 412, 422),
    },
)
def offset(state: State, caller: CallerOf, upload: UploadId) -> Response:
    """Say how much of an upload is here."""
    found = own_upload(state.services.uploads, caller, upload)
    headers = {
        "Upload-Offset": str(found.offset),
        "Upload-Length": str(found.facts.length),
        "Upload-Expires": _expiry(found),
        "Cache-Control": "no-store",
    }
    return _answer(200, headers)


@router.patch(
    "/{upload}",
    name="continueUpload",
    status_code=204,
    response_class=Response,
    dependencies=ADMIN,
    openapi_extra=PART_BODY,
    responses={
        204: {"headers": {"Upload-Offset": TEXT, "Upload-Expires": TEXT}},
        **problems(401, 404, 409, 412, 413, 415, 422, 423, 507),
    },
)
async def append(
    state: State,
    caller: CallerOf,
    request: Request,
    upload: UploadId,
    upload_offset: Annotated[int, Header(ge=0, description="Where this part begins: what HEAD answers")],
) -> Response:
    """Add the next part of an upload; what has arrived when the connection breaks is kept."""
    uploads = state.services.uploads
    await run_in_threadpool(own_upload, uploads, caller, upload)
    if media_type(request.headers) != PART_MEDIA_TYPE:
        raise UnsupportedMediaError(f"A part of an upload is {PART_MEDIA_TYPE}.")
    async with contextmanager_in_threadpool(uploads.appending(upload, upload_offset)) as part:
        pieces = bytearray()
        try:
            async for piece in request.stream():
                pieces += piece
                if len(pieces) >= PIECE_BYTES:
                    await run_in_threadpool(part.write, bytes(pieces))
                    pieces.clear()
                if state.drain.closing.is_set():
                    # A server that stops keeps what is here; the rest goes to the next one.
                    break
        except ClientDisconnect:
            # Nobody hears the answer; the next request asks for the offset.
            pass
        await run_in_threadpool(part.write, bytes(pieces))
    found = await run_in_threadpool(uploads.get, upload)
    return _answer(204, {"Upload-Offset": str(found.offset), "Upload-Expires": _expiry(found)})


@router.delete(
    "/{upload}",
    name="deleteUpload",
    status_code=204,
    response_class=Response,
    dependencies=ADMIN,
    responses=problems(401, 404, 412, 422, 423),
)
def delete(state: State, caller: CallerOf, upload: UploadId) -> Response:
    """Give up an upload."""
    own_upload(state.services.uploads, caller, upload)
    state.services.uploads.delete(upload)
    return _answer(204, {})


def own_upload(uploads: UploadFolder, caller: Caller, upload_id: str) -> Upload:
    """Return an upload; raises `NotFoundError`, or `PermissionDeniedError` where it is another venue's."""
    upload = uploads.get(upload_id)
    caller.check_venue(upload.facts.venue_id)
    return upload


def _answer(status: int, headers: dict[str, str]) -> Response:
    return Response(status_code=status, headers={"Tus-Resumable": TUS_VERSION, **headers})


def _expiry(upload: Upload) -> str:
    return format_datetime(upload.expires_at, usegmt=True)


def _metadata(header: str | None) -> dict[str, str]:
    """Return the names and values of Upload-Metadata: pairs of a name and its value in base64."""
    found = {}
    for pair in (header or "").split(","):
        name, _, value = pair.strip().partition(" ")
        try:
            found[name] = base64.b64decode(value, validate=True).decode()
        except (binascii.Error, UnicodeDecodeError):
            raise InvalidInputError(
                f"Upload-Metadata: the value of {name[:40]!r} is not base64 of text."
            ) from None
    return found
