"""Localizers on an open map, by the limits that the server's settings state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from app.engine.maps.open_map import OpenMap
from app.engine.query.localizer import Localizer
from app.engine.query.settings import LocalizerSettings
from app.engine.query.vdm.localizer import VdmLocalizer
from app.engine.query.verification import Limits
from app.settings import Settings


def limits_for(settings: Settings, opened: OpenMap) -> Limits:
    """Return the limits of a map's feature method, with those that the settings state in their place."""
    stated: dict[str, Any] = {
        "min_confidence": settings.min_confidence,
        "max_rival_share": settings.max_rival_share,
        "max_position_sigma_m": settings.max_position_sigma_m,
    }
    own = Limits(min_inliers=opened.extractor.min_inliers)
    return replace(own, **{name: value for name, value in stated.items() if value is not None})


def localizer_on(settings: Settings, opened: OpenMap, *, second_look: bool = True) -> Localizer:
    """Return the localizer on an open map; without a second look a frame that is not located is answered sooner."""
    own = LocalizerSettings(limits=limits_for(settings, opened), second_look=second_look)
    return Localizer(opened, own)


def vdm_localizer_on(settings: Settings, opened: OpenMap) -> VdmLocalizer:
    """Return the localizer by lines on the plan (B 2.3) on an open map."""
    return VdmLocalizer(opened, limits=limits_for(settings, opened))
