"""Routes that check the key before the body is read, and refuse query parameters and form fields they don't have."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Coroutine, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args, get_origin

from fastapi import Depends, Request, Response, WebSocket, params
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.datastructures import FormData, Headers
from starlette.requests import HTTPConnection

from app.api.access.gate import admit, scopes_of
from app.api.access.log_acts import VENUE, log_act
from app.api.requests.body_reader import BODY, Kind
from app.api.requests.form_request import (
    JSON_MEDIA_TYPE,
    FormRequest,
    is_picture,
    is_raw,
    media_type,
)
from app.api.requests.json_text import JsonTextOf
from app.api.requests.names import Known, refusal, refuse_unknown_keys, shown, unknown_names
from app.api.requests.sent_values import repeated_errors, text_errors
from app.errors import InvalidInputError, UnsupportedMediaError

URLENCODED = "application/x-www-form-urlencoded"
FORM_MEDIA_TYPES = ("multipart/form-data", URLENCODED)
GEOJSON_MEDIA_TYPE = "application/geo+json"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeclaredNames:
    """What a route declares.

    `form`: the fields of its form; `files`: those of them that are files; `nested`: the keys of those that hold JSON;
    `lists`: the fields and query parameters that may be sent more than once.
    `media_types`: those of a body that is not a JSON model, None when the call takes no body at all.
    """

    query: dict[str, Known] = field(default_factory=dict)
    form: dict[str, Known] = field(default_factory=dict)
    files: frozenset[str] = frozenset()
    nested: dict[str, Known] = field(default_factory=dict)
    lists: frozenset[str] = frozenset()
    media_types: tuple[str, ...] | None = None

    @property
    def texts(self) -> frozenset[str]:
        """The fields of the form that are no files."""
        return frozenset(self.form) - self.files

    @property
    def body_kind(self) -> Kind:
        """What the body holds, which decides how large it may be."""
        if "archive" in self.files:
            return "archive"
        if self.files:
            return "image"
        return "features" if GEOJSON_MEDIA_TYPE in (self.media_types or ()) else "json"


class ContractRoute(APIRoute):
    """A route that lets a call in by its key, reads a body of at most the size that it takes, and refuses names that it
    doesn't declare.

    `scopes` is what a key needs; a route without `require` or `public` among its dependencies asks for admin.
    `body_kind` is what the body holds, where that is not seen from what the route declares; `is_noted` whether what
    administrators do by it is in the audit log.
    """

    body_kind: Kind | None = None
    is_noted: bool = True

    def __init__(
        self,
        path: str,
        endpoint: Callable[..., Any],
        *,
        dependencies: Sequence[params.Depends] | None = None,
        **more: Any,
    ) -> None:
        self.scopes = scopes_of(dependencies or ())
        checks = [*(dependencies or ()), Depends(refuse_unknown_names)]
        more["summary"] = more.get("summary") or summary_of(endpoint)
        super().__init__(path, endpoint, dependencies=checks, **more)
        self.declared = declared_names(self)

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler, which reads forms by `FormRequest`."""
        handle = super().get_route_handler()

        async def handle_admitted(request: Request) -> Response:
            await admit(request, self.scopes)
            request.scope[BODY].expect(self.body_kind or self.declared.body_kind)
            files, texts = self.declared.files, self.declared.texts
            response = await handle(FormRequest(request.scope, request.receive, files, texts))
            is_recorded = "record" in self.scopes and VENUE in request.scope
            if self.is_noted and ("admin" in self.scopes or is_recorded):
                await log_act(request, response)
            return response

        return handle_admitted


def summary_of(endpoint: Callable[..., Any]) -> str:
    """Return the first sentence of a route's docstring, which says what it does, without its full stop."""
    text = " ".join((endpoint.__doc__ or "").split("\n\n")[0].split())
    return re.split(r"\.(?: |$)|; |: ", text, maxsplit=1)[0].rstrip(".")


async def refuse_unknown_names(request: Request) -> None:
    """Raise `RequestValidationError` that names each unknown name, and the one that was probably meant, and each that
    may be sent once only; and `UnsupportedMediaError` for a body that is neither the route's form nor its JSON."""
    declared = request.scope["route"].declared
    # A picture that is the body itself has the fields of its form in the query.
    is_raw_form = takes_picture(declared) and is_raw(request.headers)
    errors = [] if is_raw_form else _query_errors(declared, request)
    form = await _form(declared, request)
    if form is not None:
        if declared.files and declared.media_types == FORM_MEDIA_TYPES:
            refuse_file_as_text(declared, request, form)
        others = {**declared.query, **declared.nested}
        errors += _errors("body", "form field", form, declared.form, others)
        sent = form.multi_items()
        errors += repeated_errors(
            "body", "form field", [name for name, _ in sent], declared.lists, declared.form
        )
        errors += text_errors("body", sent)
    elif declared.media_types is None and media_type(request.headers) == JSON_MEDIA_TYPE:
        errors += _errors("body", "field", _keys(await request.body()), {}, declared.query)
    if form is None:
        refuse_media_type(declared, request.headers)
    if errors:
        if form is not None:
            await form.close()
        raise RequestValidationError(errors)


def refuse_media_type(declared: DeclaredNames, headers: Headers) -> None:
    """Raise `UnsupportedMediaError` for a body that a route doesn't read, where the route leaves reading to FastAPI."""
    has_body = headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
    if not has_body or declared.media_types is None:
        return
    kind = media_type(headers)
    given = f"A body of {shown(kind)}" if kind else "A body without Content-Type"
    if declared.media_types == FORM_MEDIA_TYPES:
        raise UnsupportedMediaError(f"{given} is not read here: send {_form_in_words(declared)}.")
    if not declared.media_types and not (kind.endswith("+json") or kind == JSON_MEDIA_TYPE):
        raise UnsupportedMediaError(
            f"{given} is not read here: send JSON with Content-Type: application/json (curl: -H 'Content-Type: "
            "application/json' -d JSON)."
        )
    if GEOJSON_MEDIA_TYPE in declared.media_types and kind == FORM_MEDIA_TYPES[0]:
        raise UnsupportedMediaError(
            f"{given} is not read here: send the GeoJSON itself as the body (curl: --data-binary @FILE)."
        )


def _form_in_words(declared: DeclaredNames) -> str:
    """Return how a route takes its form."""
    name = "archive" if "archive" in declared.files else min(declared.files, default=min(declared.form))
    raw = (
        ", or the picture alone with its own Content-Type, such as image/jpeg"
        if takes_picture(declared)
        else ""
    )
    return f"multipart/form-data (curl: -F {name}=@FILE){raw}"


def refuse_file_as_text(declared: DeclaredNames, request: Request, form: Iterable[str]) -> None:
    """Raise `InvalidInputError` for a file in the one kind of form that can't hold it; it is what `curl -d` sends."""
    holds_file = any(name in declared.files or name not in declared.form for name in form)
    if holds_file and media_type(request.headers) == URLENCODED:
        raise InvalidInputError(f"A form of {URLENCODED} can't hold a file: send {_form_in_words(declared)}.")


def takes_picture(declared: DeclaredNames) -> bool:
    """Whether a route's form may come as a plain picture or as JSON too; a route that reads its body itself decides
    by itself."""
    return is_picture(declared.files) and declared.media_types == FORM_MEDIA_TYPES


def refuse_unknown_query(socket: WebSocket) -> None:
    """Raise `InvalidInputError` for a query parameter that a WebSocket's route doesn't declare."""
    refuse_unknown_keys(socket.query_params, declared_names(socket.scope["route"]).query)


def _query_errors(declared: DeclaredNames, connection: HTTPConnection) -> list[dict[str, Any]]:
    """Return an error for each unknown query parameter of a request or WebSocket."""
    others = {
        name: Known(f"the form field {entry.written}", entry.description)
        for name, entry in {**declared.nested, **declared.form}.items()
    }
    given, kind = connection.query_params, "query parameter"
    return [
        *_errors("query", kind, given, declared.query, others),
        *repeated_errors(
            "query", kind, [name for name, _ in given.multi_items()], declared.lists, declared.query
        ),
    ]


def declared_names(route: APIRoute | APIWebSocketRoute) -> DeclaredNames:
    """Return what a route declares, from FastAPI's description of it.

    A route that reads its body itself describes it by `openapi_extra`.
    """
    dependants = list(_with_dependencies(route.dependant))
    asked = [parameter for dependant in dependants for parameter in dependant.query_params]
    query = {item.alias: Known(item.alias, item.field_info.description or "") for item in asked}
    body = [parameter for dependant in dependants for parameter in dependant.body_params]
    fields = [parameter for parameter in body if isinstance(parameter.field_info, params.Form)]
    lists = frozenset(item.alias for item in (*asked, *fields) if _is_list(item.field_info.annotation))
    if not fields:
        return replace(_described(route, query, has_model=bool(body)), lists=lists)
    return DeclaredNames(
        query=query,
        lists=lists,
        form={item.alias: Known(item.alias, item.field_info.description or "") for item in fields},
        files=frozenset(item.alias for item in fields if isinstance(item.field_info, params.File)),
        nested={
            key: Known(f"{item.alias}.{key}", entry.description or "")
            for item in fields
            for mark in item.field_info.metadata
            if isinstance(mark, JsonTextOf)
            for key, entry in mark.model.model_fields.items()
        },
        media_types=FORM_MEDIA_TYPES,
    )


def _is_list(annotation: object) -> bool:
    """Whether a parameter may be sent more than once: a list, or a list or nothing."""
    return get_origin(annotation) is list or any(_is_list(each) for each in get_args(annotation))


def _described(
    route: APIRoute | APIWebSocketRoute, query: dict[str, Known], *, has_model: bool
) -> DeclaredNames:
    """Return the names of a route without a declared form: it may describe one that it reads itself."""
    extra = getattr(route, "openapi_extra", None) or {}
    content: Mapping[str, Any] = extra.get("requestBody", {}).get("content", {})
    properties = content.get(FORM_MEDIA_TYPES[0], {}).get("schema", {}).get("properties", {})
    return DeclaredNames(
        query=query,
        form={name: Known(name, schema.get("description", "")) for name, schema in properties.items()},
        files=frozenset(name for name, schema in properties.items() if schema.get("format") == "binary"),
        media_types=tuple(content) if content or has_model else None,
    )


def _with_dependencies(dependant: Dependant) -> Iterator[Dependant]:
    yield dependant
    for inner in dependant.dependencies:
        yield from _with_dependencies(inner)


async def _form(declared: DeclaredNames, request: Request) -> FormData | None:
    """Return the form of a request, None when its body is none or the route takes it as it is."""
    kind = media_type(request.headers)
    if takes_picture(declared) and (kind == JSON_MEDIA_TYPE or is_raw(request.headers)):
        return await request.form()
    taken = FORM_MEDIA_TYPES if declared.media_types is None else declared.media_types
    return await request.form() if kind in FORM_MEDIA_TYPES and kind in taken else None


def _keys(body: bytes) -> list[str]:
    try:
        values = json.loads(body)
    except (ValueError, RecursionError):
        return []
    return list(values) if isinstance(values, dict) else []


def _errors(
    place: str, kind: str, given: Collection[str], known: Mapping[str, Known], others: Mapping[str, Known]
) -> list[dict[str, Any]]:
    return [
        {
            "type": "unknown_name",
            "loc": (place, shown(name)),
            "msg": refusal(name, known, others, kind, given),
            "input": None,
        }
        for name in unknown_names(given, known)
    ]
