"""What routes depend on: the app's state, and who may call."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import Depends, Path, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.api.executor import BoundedExecutor
from app.api.metrics import Metrics
from app.errors import AuthenticationError
from app.jobs.runner import BuildRunner
from app.services.wiring import Services

Scope = Literal["locate", "anchor", "admin"]
ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
bearer = HTTPBearer(
    auto_error=False, description="The key of the server; none is asked when it was started open."
)


@dataclass(frozen=True, slots=True)
class AppState:
    """Everything the routes use, built once by the lifespan."""

    services: Services
    executor: BoundedExecutor
    runner: BuildRunner
    metrics: Metrics


def get_state(request: Request) -> AppState:
    """Return the app's state."""
    state = request.app.state.roomfix
    assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
    return state


State = Annotated[AppState, Depends(get_state)]
VenueId = Annotated[str, Path(pattern=ID_PATTERN, description="The venue's id")]
FloorId = Annotated[str, Path(pattern=ID_PATTERN, description="The floor's id")]


def require(scope: Scope) -> Callable[..., None]:
    """Return a dependency that lets a call pass when its key has the scope.

    There is one key for now, which has every scope; keys with scopes and venues of their own will be looked up
    here.
    """

    def check(
        state: State, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
    ) -> None:
        check_key(state, credentials.credentials if credentials is not None else "", scope)

    return check


def check_key(state: AppState, given: str, scope: Scope) -> None:
    """Raise `AuthenticationError` unless a key has the scope."""
    settings = state.services.resources.settings
    if settings.open:
        return
    expected = settings.admin_key.get_secret_value() if settings.admin_key is not None else ""
    if not expected or not hmac.compare_digest(given.encode(), expected.encode()):
        raise AuthenticationError(
            f"This call needs a key with the scope {scope}, as 'Authorization: Bearer KEY'."
        )
