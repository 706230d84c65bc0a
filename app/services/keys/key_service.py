"""Keys: made, checked and revoked. A key is shown once, when it is made; the database has a hash of it."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from threading import Lock

from pydantic import SecretStr

from app.errors import (
    AuthenticationError,
    DatabaseBusyError,
    ExpiredKeyError,
    InvalidInputError,
    NotFoundError,
    PermissionDeniedError,
    RevokedKeyError,
)
from app.limits import limit
from app.services.keys.caller import Caller
from app.settings import Settings
from app.storage.audit import Act, record_act
from app.storage.db import Database, now
from app.storage.keys import (
    Key,
    Scope,
    TokenScope,
    add_key,
    delete_old_tokens,
    find_key,
    get_key,
    has_valid_key,
    list_keys,
    note_use,
    revoke_key,
)
from app.storage.venues import get_venue

# roomfix key or token, its id, its secret: letters that a header, a QR code and a WebSocket's subprotocol may hold.
KEY_PATTERN = re.compile(r"rf[kt]_([0-9a-f]{16})_([A-Za-z0-9_-]{43})")
PREFIXES = {"key": "rfk", "token": "rft"}
ID_BYTES = 8
SECRET_BYTES = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyOptions:
    """How long keys live, and how often their use is noted."""

    min_expiry_s: float = limit(
        60.0, "Shortest life of a key or token.", chosen="By hand: a phone needs some seconds to use it."
    )
    max_token_expiry_s: float = limit(
        86_400.0,
        "Longest life of a token.",
        chosen="By hand: a visit takes hours; what lives longer should be a key with a name.",
    )
    default_token_expiry_s: float = limit(
        3600.0, "Life of a token for which none is asked.", chosen="By hand: most visits are shorter."
    )
    use_noted_every_s: float = limit(
        60.0,
        "Least time between two writes of when a key was last used.",
        chosen="By hand: one small write a minute and key is no load, and nobody needs the second.",
    )
    use_wait_s: float = limit(
        0.05,
        "Time that such a write waits for the lock of the database; after that it is left out.",
        chosen="By hand: no call should wait for it.",
    )
    tokens_kept_s: float = limit(
        86_400.0,
        "Time after its end for which a token is still said to be expired, not unknown.",
        chosen="By hand: a phone that was left on overnight gets the better sentence.",
    )


OPTIONS = KeyOptions()


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key that was just made, and its text, which is not stored."""

    key: Key
    text: str


class KeyService:
    """Makes and checks keys. Safe to share between threads."""

    def __init__(self, database: Database, admin_key: SecretStr | None) -> None:
        self._database = database
        self._admin_sha256 = None if admin_key is None else _sha256(admin_key.get_secret_value())
        self._noted: dict[str, datetime] = {}
        self._lock = Lock()

    def identify(self, text: str) -> Caller:
        """Return whose key a text is; raises `AuthenticationError` for one that is unknown, expired or revoked."""
        if self._admin_sha256 is not None and hmac.compare_digest(_sha256(text), self._admin_sha256):
            return Caller(name="ROOMFIX_ADMIN_KEY", scope="admin")
        match = KEY_PATTERN.fullmatch(text)
        if match is None:
            raise _unknown()
        with self._database.read() as connection:
            key = find_key(connection, match[1])
            parent = None if key is None or key.parent_id is None else find_key(connection, key.parent_id)
        # Compared even where there is no such id, so that the time doesn't say which ids there are.
        is_right = hmac.compare_digest(_sha256(match[2]), _sha256("") if key is None else key.secret_sha256)
        if key is None or not is_right:
            raise _unknown()
        _check_valid(key, parent)
        self._note_use(key)
        return Caller(
            name=key.name,
            scope=key.scope,
            key_id=key.id,
            venue_id=key.venue_id,
            camera_id=key.camera_id,
            expires_at=key.expires_at,
            is_token=key.kind == "token",
        )

    def create(
        self,
        by: Caller,
        name: str,
        scope: Scope,
        venue_id: str | None = None,
        camera_id: str | None = None,
        expires_in_s: float | None = None,
    ) -> NewKey:
        """Make a key. Raises `InvalidInputError` for limits that don't go together, `NotFoundError` for an unknown
        venue, `PermissionDeniedError` where the caller is limited to another venue."""
        venue_id = by.venue_or_own(venue_id)
        if camera_id is not None and scope != "anchor":
            raise InvalidInputError("Only a key with the scope anchor can be limited to a camera.")
        if expires_in_s is not None and expires_in_s < OPTIONS.min_expiry_s:
            raise InvalidInputError(f"A key lives for {OPTIONS.min_expiry_s:g} s at least.")
        try:
            expires = None if expires_in_s is None else now() + timedelta(seconds=expires_in_s)
        except OverflowError:
            raise InvalidInputError("The key would expire too far in the future.") from None
        new = _new_key(
            "key", name, scope, venue_id=venue_id, camera_id=camera_id, created_by=by.name, expires_at=expires
        )
        self._store(new.key)
        return new

    def create_token(
        self,
        by: Caller,
        venue_id: str | None,
        expires_in_s: float | None = None,
        scope: TokenScope = "locate",
    ) -> NewKey:
        """Make a token for one venue; it expires with its key. Raises as `create`, and for a caller that has a token
        only, or lacks the scope."""
        by.check_scope(scope)
        if by.is_token:
            raise PermissionDeniedError("A token makes no further tokens; use a key.")
        venue_id = by.venue_or_own(venue_id)
        if venue_id is None:
            raise InvalidInputError("venue must name the venue that the token is for.")
        seconds = OPTIONS.default_token_expiry_s if expires_in_s is None else expires_in_s
        if not OPTIONS.min_expiry_s <= seconds <= OPTIONS.max_token_expiry_s:
            raise InvalidInputError(
                f"A token lives from {OPTIONS.min_expiry_s:g} to {OPTIONS.max_token_expiry_s:g} seconds."
            )
        expires = now() + timedelta(seconds=seconds)
        if by.expires_at is not None:
            expires = min(expires, by.expires_at)
        new = _new_key(
            "token",
            f"token of {by.name}"[:200],
            scope,
            venue_id=venue_id,
            parent_id=by.key_id,
            created_by=by.name,
            expires_at=expires,
        )
        self._store(new.key)
        return new

    def revoke(self, by: Caller, key_id: str) -> Key:
        """Revoke a key with its tokens, and return it; raises `NotFoundError`, also for one the caller may not see."""
        with self._database.write() as connection:
            key = get_key(connection, key_id, by.venue_id)
            revoke_key(connection, key_id)
            return key

    def list(self, by: Caller) -> list[Key]:
        """Return the keys that a caller may see, by id; no tokens."""
        with self._database.read() as connection:
            return list_keys(connection, by.venue_id)

    def note_act(self, act: Act) -> None:
        """Add an act to the audit log."""
        with self._database.write() as connection:
            record_act(connection, act)

    def exists(self) -> bool:
        """Whether there is a key that is valid."""
        with self._database.read() as connection:
            return has_valid_key(connection)

    def _store(self, key: Key) -> None:
        with self._database.write() as connection:
            if key.venue_id is not None:
                get_venue(connection, key.venue_id)
            delete_old_tokens(connection, now() - timedelta(seconds=OPTIONS.tokens_kept_s))
            if key.parent_id is not None and find_key(connection, key.parent_id) is None:
                raise NotFoundError("The key that the token is made with has been deleted.")
            add_key(connection, key)

    def _note_use(self, key: Key) -> None:
        """Store when the key was used, now and then; a busy database is no reason to hold up the call."""
        with self._lock:
            noted = self._noted.get(key.id, key.last_used_at)
            moment = now()
            if noted is not None and (moment - noted).total_seconds() < OPTIONS.use_noted_every_s:
                return
            self._noted = {
                name: at
                for name, at in self._noted.items()
                if (moment - at).total_seconds() < OPTIONS.use_noted_every_s
            }
            self._noted[key.id] = moment
        try:
            with self._database.write(OPTIONS.use_wait_s) as connection:
                note_use(connection, key.id)
        except DatabaseBusyError:
            return


@contextmanager
def key_service(settings: Settings) -> Iterator[KeyService]:
    """Give the keys of a server that need not run."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    database = Database(settings.resolved_database_url)
    try:
        database.migrate()
        yield KeyService(database, settings.admin_key)
    finally:
        database.close()


def any_key(settings: Settings) -> bool:
    """Whether a server with these settings has any key that it would take."""
    if settings.admin_key is not None:
        return True
    with key_service(settings) as keys:
        return keys.exists()


def _new_key(
    kind: str,
    name: str,
    scope: Scope,
    *,
    created_by: str,
    venue_id: str | None = None,
    camera_id: str | None = None,
    parent_id: str | None = None,
    expires_at: datetime | None = None,
) -> NewKey:
    key_id, secret = secrets.token_hex(ID_BYTES), secrets.token_urlsafe(SECRET_BYTES)
    key = Key(
        id=key_id,
        secret_sha256=_sha256(secret),
        kind="token" if kind == "token" else "key",
        name=name,
        scope=scope,
        venue_id=venue_id,
        camera_id=camera_id,
        parent_id=parent_id,
        created_by=created_by,
        created_at=now(),
        expires_at=expires_at,
        revoked_at=None,
        last_used_at=None,
    )
    return NewKey(key, f"{PREFIXES[kind]}_{key_id}_{secret}")


def _check_valid(key: Key, parent: Key | None) -> None:
    if key.revoked_at is not None or (parent is not None and parent.revoked_at is not None):
        raise RevokedKeyError("This key was revoked; ask for another.")
    if key.is_expired(now()):
        kind = "token" if key.kind == "token" else "key"
        raise ExpiredKeyError(f"This {kind} has expired; get another.")


def _unknown() -> AuthenticationError:
    return AuthenticationError("The key is not known; check it for missing letters.")


def _sha256(text: str) -> str:
    # A secret of 256 random bits needs no slow hash: there is nothing to guess it from.
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
