"""All settings, from the environment (`ROOMFIX_*`); `docs/settings.md` lists them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, SettingsConfigDict

from app.build_kinds import Kind, parse_kinds
from app.errors import InvalidInputError

# As browsers write it in the header `Origin`; of apps in a web view too, such as capacitor://localhost.
ORIGIN = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://[^/?#\s\"']+")


class Settings(BaseSettings):
    """One value per environment variable: `data_dir` is `ROOMFIX_DATA_DIR`, and so on."""

    model_config = SettingsConfigDict(env_prefix="ROOMFIX_", env_file=".env", extra="ignore")

    data_dir: Path = Field(Path(".roomfix"), description="Folder for database, blobs and scratch files.")
    database_url: str | None = Field(
        None,
        description="SQLAlchemy URL; default: SQLite in the data folder. PostgreSQL: postgresql+psycopg://...",
    )
    blob_url: str | None = Field(
        None,
        description="Where blobs live, for example s3://bucket/prefix; default: a folder in the data folder.",
    )
    blob_cache_bytes: int = Field(
        20_000_000_000, ge=0, description="Bytes of a remote store's blobs that are kept in the data folder."
    )
    admin_key: SecretStr | None = Field(
        None, description="A key with all rights, to make the first other keys with; see docs/keys.md."
    )
    open: bool = Field(False, description="Serve without a key; allowed on a loopback address only.")
    calls_per_minute: int = Field(
        3000, ge=0, description="Calls that one key may make in a minute from one address; 0 is no limit."
    )
    wrong_keys_per_minute: int = Field(
        30,
        ge=0,
        description="Wrong keys in a minute after which an address is refused for a while; 0 is no limit.",
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="What goes to the log: debug, info, warning or error."
    )
    log_format: Literal["console", "json"] = Field(
        "console", description="How a line of the log is written: console for people, json for programs."
    )
    cors_origins: str = Field(
        "", description="Origins of web pages that may call, separated by commas; * for all of them."
    )
    host: str = Field("127.0.0.1", description="Address to listen on.")
    https: bool = Field(
        False,
        description="Serve https with a certificate of the data folder's own authority, on all addresses.",
    )
    port: int = Field(8000, ge=1, le=65535, description="Port to listen on.")
    workers: int = Field(
        2, ge=1, le=64, description="Threads that compute, in the server and in the build worker."
    )
    queue_size: int = Field(16, ge=1, le=10_000, description="Queries that may wait before 503.")
    drain_s: float = Field(
        0.0,
        ge=0,
        le=3600,
        description="Seconds for which a server that is stopped (SIGTERM) still serves but is not ready, so that its "
        "balancer sends no more.",
    )
    finish_build_s: float = Field(
        0.0,
        ge=0,
        le=86_400,
        description="Seconds that a worker which is stopped has to finish its build before another one begins it anew.",
    )
    share_builds: bool = Field(
        False,
        description="Let workers of one data folder that have nothing to build help with each other's builds.",
    )
    worker_kinds: str = Field(
        "",
        description="Kinds of builds that the worker takes, separated by commas: scan, recording, pictures; all where "
        "it is empty.",
    )
    run_worker: bool = Field(True, description="Start the embedded build worker with the server.")
    max_image_bytes: int = Field(25_000_000, ge=1000, description="Largest image that is accepted.")
    max_image_pixels: int = Field(50_000_000, ge=10_000, description="Most pixels that are decoded.")
    max_plan_pixels: int = Field(
        400_000_000, ge=10_000, description="Most pixels of a plan; one of more than are decoded is reduced."
    )
    max_archive_bytes: int = Field(
        8_000_000_000, ge=1000, description="Largest scan archive that is accepted."
    )
    max_unpacked_bytes: int = Field(20_000_000_000, ge=1000, description="Most bytes a scan may unpack to.")
    descriptor_model: Path | None = Field(
        None, description="ONNX file of another global descriptor; default: the shipped one."
    )
    descriptor_width: int = Field(320, ge=32, le=2048, description="Input width of the global descriptor.")
    descriptor_height: int = Field(240, ge=32, le=2048, description="Input height of the global descriptor.")
    face_model: Path | None = Field(
        None, description="ONNX file of YuNet that finds faces to blur; default: the package roomfix[faces]."
    )
    blur_anchor_faces: bool = Field(
        False, description="Blur faces in the pictures of monitoring cameras that are kept."
    )
    session_timeout_s: float = Field(
        3600.0, gt=0, description="Seconds without a frame after which a session expires."
    )
    session_live_max: int = Field(
        64,
        ge=1,
        le=10_000,
        description="Sessions that are followed in memory; others relocalize when they go on.",
    )
    session_trajectory_points: int = Field(
        20_000, ge=10, description="Points of a session's trajectory that are kept, the newest."
    )

    anchor_max_age_s: float = Field(
        60.0, gt=0, le=1e9, description="Age in seconds from which an anchor's frame is not used any more."
    )

    min_confidence: float | None = Field(
        None, ge=0, le=1, description="Least confidence of an answer; default: see docs/limits.md."
    )
    max_rival_share: float | None = Field(
        None,
        gt=0,
        le=1,
        description="Most inliers of another place, over those of the answer, before it is ambiguous; default: see "
        "docs/limits.md.",
    )
    max_position_sigma_m: float | None = Field(
        None,
        gt=0,
        le=100,
        description="Largest standard deviation of an answer's position in metres; default: see docs/limits.md.",
    )

    @field_validator("worker_kinds")
    @classmethod
    def _are_kinds(cls, text: str) -> str:
        parse_kinds(text)
        return text

    @field_validator("cors_origins")
    @classmethod
    def _are_origins(cls, text: str) -> str:
        for origin in filter(None, (part.strip() for part in text.split(","))):
            if origin != "*" and not ORIGIN.fullmatch(origin):
                raise ValueError(
                    f"{origin} is no origin: write scheme://host or scheme://host:port, without a slash after it and "
                    "without quotes, separated by commas"
                )
        return text

    @property
    def allowed_origins(self) -> tuple[str, ...]:
        """The origins whose pages may call."""
        return tuple(origin.strip() for origin in self.cors_origins.split(",") if origin.strip())

    @property
    def kinds_of_builds(self) -> tuple[Kind, ...]:
        """The kinds of builds that the worker takes."""
        return parse_kinds(self.worker_kinds)

    @property
    def resolved_database_url(self) -> str:
        """The database URL, the SQLite default filled in."""
        return self.database_url or f"sqlite:///{(self.data_dir / 'roomfix.db').resolve()}"

    @property
    def scratch_dir(self) -> Path:
        """Where archives are unpacked and maps are packed before they are stored."""
        return self.data_dir / "scratch"

    @property
    def uploads_dir(self) -> Path:
        """Where uploads are until they are whole."""
        return self.data_dir / "uploads"

    @property
    def cache_dir(self) -> Path:
        """Where blobs of a remote store are kept for memory-mapping."""
        return self.data_dir / "cache"


def read_settings(given: Mapping[str, Any]) -> Settings:
    """Return the settings of the environment, with those that are given in place of it.

    Raises `InvalidInputError` that names each setting that can't be used.
    """
    try:
        return Settings(**given)
    except ValidationError as error:
        raise InvalidInputError(" ".join(map(_in_words, error.errors()))) from None


def _in_words(error: ErrorDetails) -> str:
    # Without the value, which may be a key.
    name = "_".join(map(str, error["loc"])).upper()
    return f"ROOMFIX_{name}: {error['msg'].removeprefix('Value error, ')}."
