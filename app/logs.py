"""The log: one line an event, as JSON or for people, with level, logger and request id, and without keys."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import MutableMapping
from contextlib import AbstractContextManager
from typing import Any, Literal

import structlog

LogFormat = Literal["console", "json"]
# Libraries whose log holds headers and bodies when it is detailed.
TALKATIVE = (
    "asyncio", "boto3", "botocore", "httpcore", "httpx", "multipart", "python_multipart", "uvicorn", "websockets",
)  # fmt: skip
# A key after its name in an address, after the scheme of the header, or of the form that keys have.
KEY_IN_TEXT = re.compile(r"([?&](?:key|token)=|bearer\s+|rf[kt]_[0-9a-f]{16}_)[^\s&\"']+", re.IGNORECASE)


def configure_logs(level: str = "info", log_format: LogFormat = "console") -> None:
    """Let everything that is logged go to standard error, in place of what was configured before."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(line_formatter(log_format))
    root = logging.getLogger()
    for earlier in root.handlers[:]:
        root.removeHandler(earlier)
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name in TALKATIVE:
        # Below this they write headers and the bytes of messages.
        logging.getLogger(name).setLevel(max(logging.INFO, root.level))


def log_context(**values: str) -> AbstractContextManager[Any]:
    """Return a context in which each line of this thread or task carries these values, such as `request_id`."""
    return structlog.contextvars.bound_contextvars(**values)


def line_formatter(log_format: LogFormat) -> logging.Formatter:
    """Return what makes a line of a record of the standard library's logging."""
    render: Any
    if log_format == "json":
        render = structlog.processors.JSONRenderer(ensure_ascii=False)
    else:
        render = structlog.dev.ConsoleRenderer(colors=False, pad_event_to=0)
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[
            structlog.contextvars.merge_contextvars,
            structlog.stdlib.add_log_level,
            structlog.stdlib.add_logger_name,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
        ],
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.format_exc_info,
            hide_keys,
            render,
        ],
    )


def hide_keys(_logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Replace whatever looks like a key in the text of a line, its traceback included: a processor of structlog."""
    for name, value in event.items():
        if isinstance(value, str):
            event[name] = KEY_IN_TEXT.sub(r"\1***", value)
    return event
