"""Keys: what they allow, what is stored of them, how they end."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from pydantic import SecretStr
from sqlalchemy import update

from app.errors import (
    AuthenticationError,
    ExpiredKeyError,
    InvalidInputError,
    NotFoundError,
    PermissionDeniedError,
    RevokedKeyError,
)
from app.services.keys.caller import OPEN
from app.services.keys.key_service import OPTIONS, KeyService
from app.storage.db import Database, now
from app.storage.keys import find_key, list_keys
from app.storage.tables import keys as table
from app.storage.venues import create_venue, delete_venue


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    opened = Database(f"sqlite:///{tmp_path / 'test.db'}")
    opened.migrate()
    with opened.write() as connection:
        create_venue(connection, "museum", "Museum")
        create_venue(connection, "hotel", "Hotel")
    yield opened
    opened.close()


@pytest.fixture
def service(database: Database) -> KeyService:
    return KeyService(database, SecretStr("bootstrap"))


def test_a_key_is_who_it_was_made_for(service: KeyService) -> None:
    made = service.create(OPEN, "app", "locate", "museum", expires_in_s=3600)
    caller = service.identify(made.text)
    assert (caller.name, caller.scope, caller.venue_id, caller.key_id) == (
        "app",
        "locate",
        "museum",
        made.key.id,
    )
    caller.check_scope("locate")
    caller.check_venue("museum")
    with pytest.raises(PermissionDeniedError, match="scope admin"):
        caller.check_scope("admin")
    with pytest.raises(PermissionDeniedError, match="museum"):
        caller.check_venue("hotel")
    assert caller.venue_or_own(None) == "museum"


def test_the_database_holds_no_key(service: KeyService, database: Database, tmp_path: Path) -> None:
    made = service.create(OPEN, "app", "locate", "museum")
    token = service.create_token(service.identify(made.text), None)
    content = b"".join(file.read_bytes() for file in tmp_path.glob("test.db*"))
    for new in (made, token):
        assert new.key.id.encode() in content
        secret = new.text.partition(f"{new.key.id}_")[2]
        assert len(secret) == 43
        assert secret.encode() not in content


@pytest.mark.parametrize(
    "change", [lambda t: t[:-1] + ("A" if t[-1] != "A" else "B"), lambda t: t.replace("rfk_", "rfk_0", 1), str.upper,
               lambda t: t + "x", lambda _: "", lambda _: "rfk_" + "0" * 16 + "_" + "A" * 43, lambda _: "\udcff"],
)  # fmt: skip
def test_a_key_that_differs_at_all_is_unknown(service: KeyService, change: object) -> None:
    text = service.create(OPEN, "app", "admin").text
    assert service.identify(text).scope == "admin"
    with pytest.raises(AuthenticationError) as refused:
        service.identify(change(text))  # type: ignore[operator]
    assert type(refused.value) is AuthenticationError


def test_the_key_of_the_settings_has_all_rights(service: KeyService, database: Database) -> None:
    caller = service.identify("bootstrap")
    assert (caller.scope, caller.venue_id, caller.key_id) == ("admin", None, None)
    with pytest.raises(AuthenticationError):
        KeyService(database, None).identify("bootstrap")


def test_a_revoked_key_takes_its_tokens_along(service: KeyService) -> None:
    made = service.create(OPEN, "app", "locate", "museum")
    token = service.create_token(service.identify(made.text), None)
    assert service.identify(token.text).is_token
    service.revoke(OPEN, made.key.id)
    for text in (made.text, token.text):
        with pytest.raises(RevokedKeyError):
            service.identify(text)
    assert service.list(OPEN)[0].revoked_at is not None


def test_a_token_can_be_revoked_alone(service: KeyService) -> None:
    made = service.create(OPEN, "app", "locate", "museum")
    token = service.create_token(service.identify(made.text), None)
    service.revoke(OPEN, token.key.id)
    with pytest.raises(RevokedKeyError):
        service.identify(token.text)
    assert service.identify(made.text).name == "app"


def test_a_key_ends_when_it_expires(service: KeyService, database: Database) -> None:
    made = service.create(OPEN, "app", "locate", "museum", expires_in_s=60)
    with database.write() as connection:
        connection.execute(update(table).values(expires_at=now() - timedelta(seconds=1)))
    with pytest.raises(ExpiredKeyError, match="key has expired"):
        service.identify(made.text)


def test_a_token_lives_no_longer_than_its_key(service: KeyService) -> None:
    made = service.create(OPEN, "app", "locate", "museum", expires_in_s=120)
    token = service.create_token(service.identify(made.text), "museum", 3600)
    assert token.key.expires_at == made.key.expires_at
    with pytest.raises(PermissionDeniedError, match="no further tokens"):
        service.create_token(service.identify(token.text), None)


def test_old_tokens_are_deleted_when_new_ones_are_made(service: KeyService, database: Database) -> None:
    first = service.create_token(OPEN, "museum")
    with database.write() as connection:
        age = timedelta(seconds=OPTIONS.tokens_kept_s + 1)
        connection.execute(update(table).values(expires_at=now() - age))
    second = service.create_token(OPEN, "museum")
    with database.read() as connection:
        assert find_key(connection, first.key.id) is None
        assert find_key(connection, second.key.id) is not None
        assert list_keys(connection) == []


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"scope": "locate", "camera_id": "c"}, InvalidInputError),
        ({"scope": "locate", "venue_id": "nowhere"}, NotFoundError),
        ({"scope": "locate", "expires_in_s": 1}, InvalidInputError),
        ({"scope": "locate", "expires_in_s": 1e300}, InvalidInputError),
    ],
)
def test_a_key_that_makes_no_sense_is_refused(
    service: KeyService, values: dict[str, object], error: type
) -> None:
    with pytest.raises(error):
        service.create(OPEN, "app", **values)  # type: ignore[arg-type]


def test_an_admin_of_a_venue_makes_and_sees_keys_of_that_venue_alone(service: KeyService) -> None:
    admin = service.identify(service.create(OPEN, "museum's", "admin", "museum").text)
    other = service.create(OPEN, "hotel's", "locate", "hotel")
    assert service.create(admin, "app", "locate").key.venue_id == "museum"
    assert {key.name for key in service.list(admin)} == {"museum's", "app"}
    with pytest.raises(PermissionDeniedError):
        service.create(admin, "app", "locate", "hotel")
    with pytest.raises(NotFoundError):
        service.revoke(admin, other.key.id)


def test_a_venue_that_is_deleted_takes_its_keys_along(service: KeyService, database: Database) -> None:
    made = service.create(OPEN, "app", "locate", "museum")
    with database.write() as connection:
        delete_venue(connection, "museum")
        create_venue(connection, "museum", "Another museum")
    with pytest.raises(AuthenticationError):
        service.identify(made.text)


def test_use_is_noted_once_a_minute(service: KeyService, database: Database) -> None:
    made = service.create(OPEN, "app", "locate", "museum")
    assert made.key.last_used_at is None
    service.identify(made.text)
    first = service.list(OPEN)[0].last_used_at
    assert first is not None
    service.identify(made.text)
    assert service.list(OPEN)[0].last_used_at == first
    # Another server process notes it too, when the minute is over.
    with database.write() as connection:
        connection.execute(update(table).values(last_used_at=now() - timedelta(seconds=61)))
    KeyService(database, None).identify(made.text)
    assert service.list(OPEN)[0].last_used_at is not None
    assert service.list(OPEN)[0].last_used_at >= first  # type: ignore[operator]
