"""What routes depend on: the app's state, and who may call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Path, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.requests import HTTPConnection

from app.api.access.throttle import Throttle
from app.api.answers.drain import Drain
from app.api.answers.drawings import Drawings
from app.api.executor import BoundedExecutor
from app.api.metrics import Metrics
from app.errors import AuthenticationError
from app.jobs.runner import BuildRunner
from app.services.keys.caller import Caller
from app.services.wiring import Services
from app.storage.keys import Scope

ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
ID_IN_WORDS = (
    "An id has 1 to 64 letters from A to Z, digits, '_', '.' or '-', and begins with a letter or digit"
)
# Where a request's scope holds who calls, and the headers that its answer gets.
CALLER = "roomfix.caller"
EXTRA_HEADERS = "roomfix.headers"
bearer = HTTPBearer(
    auto_error=False,
    scheme_name="key",
    description="A key or token of the server; none is asked when it was started open.",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AppState:
    """Everything the routes use, built once by the lifespan."""

    services: Services
    executor: BoundedExecutor
    drawings: Drawings
    drain: Drain
    runner: BuildRunner
    metrics: Metrics
    throttle: Throttle


# Dependencies are coroutines even where they wait for nothing: FastAPI calls others on a thread, of which there may be
# none left.
async def get_state(request: Request) -> AppState:
    """Return the app's state."""
    state = request.app.state.roomfix
    assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
    return state


State = Annotated[AppState, Depends(get_state)]
VenueId = Annotated[str, Path(pattern=ID_PATTERN, description="The venue's id")]
FloorId = Annotated[str, Path(pattern=ID_PATTERN, description="The floor's id")]


def caller_of(connection: HTTPConnection) -> Caller:
    """Return who makes a call; raises `AuthenticationError` for one that was not let in by its headers."""
    caller = connection.scope.get(CALLER)
    if not isinstance(caller, Caller):
        raise AuthenticationError("This call needs a key, as 'Authorization: Bearer KEY'.")
    return caller


async def _caller(request: Request) -> Caller:
    return caller_of(request)


CallerOf = Annotated[Caller, Depends(_caller)]


@dataclass(frozen=True, slots=True)
class Require:
    """A dependency that asks for a key with a scope.

    `ContractRoute` checks it before the body is read; the call here repeats that, and describes it in OpenAPI.
    """

    scope: Scope

    async def __call__(
        self, request: Request, _key: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
    ) -> None:
        """Raise `AuthenticationError` or `PermissionDeniedError` unless the caller has the scope."""
        caller_of(request).check_scope(self.scope)


def require(scope: Scope) -> Require:
    """Return a dependency that lets a call pass when its key has the scope."""
    return Require(scope)


async def public() -> None:
    """Mark a route that asks for no key; one without this or `require` asks for the scope admin."""
