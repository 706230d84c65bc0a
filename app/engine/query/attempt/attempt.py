"""One attempt to localize a picture by its matches with a map."""

from __future__ import annotations

from functools import partial

import numpy as np

from app.engine.query.attempt.pose import Matcher, PoseSearch
from app.engine.query.attempt.rival import against_rival
from app.engine.query.attempt.verdict import conclude
from app.engine.query.camera import lens_of_query
from app.engine.query.hints import view_hints
from app.engine.query.intrinsics import checked_camera
from app.engine.query.localization import Localization
from app.engine.query.matches import Matches
from app.engine.query.query import Query
from app.engine.query.verification import Evidence
from app.geometry.camera import Camera
from app.geometry.focal import focal_sigma_of


def attempt(search: PoseSearch, matcher: Matcher, matches: Matches) -> Localization:
    """Localize a picture by these matches and those that a first pose leads to."""
    query, known, settings = matcher.query, matcher.query.known, search.settings
    camera = known if isinstance(known, Camera) else search.find_camera(matches, query)
    if camera is None:
        return nothing(query, matches, None)
    lens = lens_of_query(search.map.artifact.metadata, known) if settings.fit_lens else None
    camera = camera if lens is None else lens.of(camera)
    best = search.best(matcher, matches, camera)
    if best is not None and (not isinstance(known, Camera) or (lens is not None and lens.is_guess)):
        camera, best = search.fit_camera(best, camera, known, lens)
    if best is None:
        return nothing(query, matches, camera)
    stated = isinstance(known, Camera), settings.check_intrinsics
    find = partial(search.find_camera, query=query)
    checked = checked_camera(best, camera, search, find, *stated)
    contest = against_rival(search, matcher, checked.best, checked.camera)
    if contest.best is not checked.best:
        # What the matches of one place say of the camera says nothing of the other's.
        checked = checked_camera(contest.best, camera, search, find, *stated)
        contest = contest.won_by(checked.best)
    sigmas = focal_sigma_of(known, checked.camera), 0.0 if lens is None else lens.sigma
    return conclude(search, matcher, contest, checked, sigmas)


def nothing(query: Query, matches: Matches, camera: Camera | None) -> Localization:
    """Return the outcome of an attempt whose matches agree on no pose."""
    return Localization(
        evidence=Evidence(matches=matches.feature_count),
        reason="no_match",
        camera=camera,
        timings_ms=query.timings_ms,
        hints=view_hints("no_match", np.zeros((0, 2)), query.size_px),
    )
