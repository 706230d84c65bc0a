"""What schemathesis is told beside the OpenAPI document: the member for a stream's events, which only 3.2 has, and how
the body of an upload's part is written."""

from __future__ import annotations

from typing import Any

import schemathesis

# A part of an upload is bytes, as any other binary body.
schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")


@schemathesis.hook
def before_load_schema(context: schemathesis.HookContext, raw_schema: dict[str, Any]) -> None:
    """Let the description of each event stand where schemathesis looks for it."""
    for calls in raw_schema["paths"].values():
        for call in calls.values():
            for answer in call["responses"].values():
                for content in answer.get("content", {}).values():
                    if "x-item-schema" in content:
                        content["schema"] = content.pop("x-item-schema")
