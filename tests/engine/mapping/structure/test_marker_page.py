"""The printed marker has the size that was asked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest

from app.engine.mapping.structure.marker_page import write_marker_page
from app.engine.mapping.structure.markers import DICTIONARY

MM_PER_POINT = 25.4 / 72


@pytest.mark.parametrize(("side_mm", "number"), [(160.0, 0), (50.0, 49)])
def test_a_page_shows_the_marker_at_its_size(tmp_path: Path, side_mm: float, number: int) -> None:
    path = tmp_path / "marker.pdf"
    write_marker_page(path, side_mm, number)
    page = pypdfium2.PdfDocument(path)[0]
    assert np.array(page.get_size()) * MM_PER_POINT == pytest.approx([210, 297], abs=0.5)
    picture = np.asarray(page.render(scale=2).to_pil().convert("L"))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARY))
    (corners,), numbers, _ = detector.detectMarkers(picture)
    assert numbers.ravel().tolist() == [number]
    sides = np.linalg.norm(corners[0] - np.roll(corners[0], 1, axis=0), axis=1) / 2 * MM_PER_POINT
    assert sides == pytest.approx([side_mm] * 4, abs=0.5)
