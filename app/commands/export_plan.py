"""`roomfix export-plan`: a venue's floors and features as an indoor map for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import DataDir, console, settings_from
from app.errors import InvalidInputError
from app.importers.plans.frame import Frame
from app.services.plans.export_plan import ImdfDetails, export_imdf
from app.services.resources import Resources


def export_plan(
    venue: Annotated[str, typer.Argument(help="The venue.")],
    output: Annotated[Path, typer.Option(help="The zip to write.")],
    origin: Annotated[
        str | None,
        typer.Option(
            help="longitude,latitude[,rotation_deg] of (0, 0) on the lowest floor's plan; rotation is how far east "
            "lies counter-clockwise from plan x. Without it the venue's own origin."
        ),
    ] = None,
    format_name: Annotated[str, typer.Option("--format", help="imdf.")] = "imdf",
    category: Annotated[str, typer.Option(help="IMDF's category of the venue.")] = "businesscampus",
    address: Annotated[str, typer.Option(help="Street and number.")] = "unknown",
    locality: Annotated[str, typer.Option(help="Town.")] = "unknown",
    country: Annotated[str, typer.Option(help="Two letters of ISO 3166; ZZ: not known.")] = "ZZ",
    language: Annotated[str, typer.Option(help="Language of the names.")] = "en",
    data_dir: DataDir = None,
) -> None:
    """Write a venue's floors, areas, landmarks and links as an IMDF archive."""
    if format_name != "imdf":
        raise InvalidInputError("--format must be imdf.")
    details = ImdfDetails(
        category=category, address=address, locality=locality, country=country, language=language
    )
    resources = Resources.open(settings_from(data_dir=data_dir))
    try:
        frame = None if origin is None else frame_of(origin)
        counts = export_imdf(resources, venue, frame, output, details)
    finally:
        resources.close()
    shown = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    console.print(f"{output}: {shown}")


def frame_of(text: str) -> Frame:
    """Return the frame of an option `longitude,latitude[,rotation_deg]`; raises `InvalidInputError`."""
    try:
        longitude, latitude, *rest = (float(part) for part in text.split(","))
        (rotation_deg,) = rest or (0.0,)
    except ValueError:
        raise InvalidInputError(
            "--origin must be longitude,latitude or longitude,latitude,rotation_deg."
        ) from None
    return Frame(longitude, latitude, rotation_deg)
