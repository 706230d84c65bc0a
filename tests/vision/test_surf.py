"""SURF, where its library is installed; a sentence where it isn't."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.vision import local_features
from app.vision.images import to_gray
from app.vision.local_features import check_features, create_extractor
from app.vision.matching import match_unit_vectors, to_unit_vectors
from tests.scenes import View


def test_without_its_library_surf_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_features, "find_spec", lambda name: None)
    with pytest.raises(InvalidInputError, match=r"mahotas.*roomfix\[surf\].*sift"):
        create_extractor("surf")
    assert check_features("sift") == "sift"


def test_surf_matches_what_both_pictures_show(views: list[View]) -> None:
    pytest.importorskip("mahotas")
    surf = create_extractor("surf")
    a, b = (surf.extract(to_gray(view.rgb)) for view in views[3:5])
    assert min(len(a), len(b)) > 100
    assert a.descriptors.shape == (len(a), surf.descriptor_size)
    rows, columns, _ = match_unit_vectors(
        *(to_unit_vectors(f.descriptors, False) for f in (a, b)), surf.ratio
    )
    # The camera turned by 9 degrees about the vertical: what both see moved along the rows.
    moved = b.keypoints_px[columns] - a.keypoints_px[rows]
    assert len(rows) > 30
    usual = np.median(moved, axis=0)
    assert np.mean(np.linalg.norm(moved - usual, axis=1) < 25) > 0.7


def test_a_blank_picture_has_no_features() -> None:
    pytest.importorskip("mahotas")
    assert len(create_extractor("surf").extract(np.full((240, 320), 128, np.uint8))) == 0
