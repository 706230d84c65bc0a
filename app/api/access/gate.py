"""The gate: a call is let in by its headers alone, before anything of its body is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fastapi import params
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from app.api.access.credentials import address_of, key_of
from app.api.deps import CALLER, EXTRA_HEADERS, AppState, Require, public
from app.errors import AuthenticationError, ExpiredKeyError, NotFoundError, RevokedKeyError
from app.services.keys.caller import OPEN, Caller
from app.storage.anchors import get_anchor
from app.storage.builds import get_build
from app.storage.keys import Scope
from app.storage.recordings import get_recording

IN_THE_ADDRESS = (
    "A key is not taken from the address, where logs would keep it: send it as a header or subprotocol."
)


def scopes_of(dependencies: Iterable[params.Depends]) -> tuple[Scope, ...]:
    """Return the scopes that a route requires, none for a public one.

    A route that says nothing about it requires admin.
    """
    callables = [each.dependency for each in dependencies]
    if public in callables:
        return ()
    return tuple(each.scope for each in callables if isinstance(each, Require)) or ("admin",)


async def admit(connection: HTTPConnection, scopes: tuple[Scope, ...]) -> None:
    """Let a call in that may be made with the scopes; `caller_of` then returns who makes it.

    Raises `AuthenticationError` without a valid key, `RateLimitError` for too many calls or wrong keys,
    `PermissionDeniedError` without the scope and for another venue or camera in the path, and `NotFoundError` for a
    session, build, recording or anchor that belongs to a venue which the key may not use.
    """
    if not scopes:
        return
    state = connection.app.state.roomfix
    assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
    if state.services.resources.settings.open:
        connection.scope[CALLER] = OPEN
        return
    caller = await run_in_threadpool(_identified, state, connection)
    connection.scope[CALLER] = caller
    for scope in scopes:
        caller.check_scope(scope)
    if caller.venue_id is not None or caller.camera_id is not None:
        await run_in_threadpool(check_path, state, caller, connection.path_params)


def check_path(state: AppState, caller: Caller, parameters: Mapping[str, str]) -> None:
    """Check that what a path names belongs to the venue and camera of a key; raises as `admit`."""
    if "venue" in parameters:
        caller.check_venue(parameters["venue"])
    if "camera" in parameters:
        caller.check_camera(parameters["camera"])
    if caller.venue_id is None:
        return
    for name, identifier in parameters.items():
        owner = _venue_of(state, name, identifier)
        if owner not in (None, caller.venue_id):
            raise NotFoundError(f"There is no {name} {identifier!r} in the venue of this key.")


def _venue_of(state: AppState, name: str, identifier: str) -> str | None:
    """Return the venue that a path's parameter belongs to; None where it is none, or not there."""
    try:
        if name == "session":
            return state.services.sessions.get(identifier).venue_id
        with state.services.resources.database.read() as connection:
            if name == "build":
                return get_build(connection, identifier).venue_id
            if name == "recording":
                return get_recording(connection, identifier).venue_id
            if name == "camera":
                return get_anchor(connection, identifier).spec.venue_id
    except NotFoundError:
        pass
    return None


def _identified(state: AppState, connection: HTTPConnection) -> Caller:
    """Return who calls, after the limits of address and key."""
    text, address = key_of(connection), address_of(connection)
    if text is None:
        hint = f" {IN_THE_ADDRESS}" if "key" in connection.query_params else ""
        raise AuthenticationError(f"This call needs a key, as 'Authorization: Bearer KEY'.{hint}")
    state.throttle.check_address(address)
    try:
        caller = state.services.keys.identify(text)
    except (ExpiredKeyError, RevokedKeyError):
        # Known once: nobody is guessing.
        raise
    except AuthenticationError:
        state.throttle.note_wrong_key(address)
        raise
    usage = state.throttle.take(caller.key_id or caller.name, address)
    if usage is not None:
        connection.scope.get(EXTRA_HEADERS, {}).update(usage.headers())
    return caller
