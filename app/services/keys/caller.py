"""Who makes a call, and what their key lets them do."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from app.errors import PermissionDeniedError
from app.storage.keys import Scope

# What a scope allows beside itself.
ALLOWS: dict[Scope, frozenset[Scope]] = {
    "locate": frozenset({"locate"}),
    "anchor": frozenset({"anchor"}),
    "record": frozenset({"locate", "record"}),
    "admin": frozenset({"locate", "anchor", "record", "admin"}),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """Who calls, and what they may do. `key_id` is None for the key of the settings and for an open server."""

    name: str
    scope: Scope
    key_id: str | None = None
    venue_id: str | None = None
    camera_id: str | None = None
    expires_at: datetime | None = None
    is_token: bool = False
    is_open: bool = False

    def check_scope(self, scope: Scope) -> None:
        """Raise `PermissionDeniedError` unless the scope is allowed."""
        if scope not in ALLOWS[self.scope]:
            raise PermissionDeniedError(
                f"This call needs a key with the scope {scope}; this one has {self.scope}."
            )

    def check_venue(self, venue_id: str | None) -> None:
        """Raise `PermissionDeniedError` for another venue than the key's own; None stands for all venues."""
        if self.venue_id is not None and venue_id != self.venue_id:
            raise PermissionDeniedError(f"This key is limited to the venue {self.venue_id!r}.")

    def check_camera(self, camera_id: str) -> None:
        """Raise `PermissionDeniedError` for another monitoring camera than the key's own."""
        if self.camera_id is not None and camera_id != self.camera_id:
            raise PermissionDeniedError(f"This key is limited to the camera {self.camera_id!r}.")

    def venue_or_own(self, venue_id: str | None) -> str | None:
        """Return the venue that a call is about: the key's own where none is named; raises as `check_venue`."""
        chosen = self.venue_id if venue_id is None else venue_id
        self.check_venue(chosen)
        return chosen


OPEN = Caller(name="open", scope="admin", is_open=True)
