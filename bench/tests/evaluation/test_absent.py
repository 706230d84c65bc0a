"""Places that no map holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidInputError
from bench.evaluation.absent import check_places, pictures_of, synthetic_pictures
from tests.scenes import View


def test_synthetic_places_are_forty_and_always_the_same() -> None:
    first, again = (list(synthetic_pictures(160, 120)) for _ in range(2))
    assert len(first) == 40
    assert len({name for name, _ in first}) == 40
    assert all(rgb.shape == (120, 160, 3) and rgb.dtype == np.uint8 for _, rgb in first)
    assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(first, again, strict=True))


def test_synthetic_places_are_what_they_are_called() -> None:
    pictures = dict(synthetic_pictures(160, 120))
    assert pictures["black 1"].max() == 0
    assert pictures["white 1"].min() == 255
    assert pictures["noise 1"].std() > 50
    walls = [rgb for name, rgb in pictures.items() if name.startswith("wall")]
    # Light falls off softly: neighbours differ by sensor noise alone.
    assert all(np.abs(np.diff(rgb.astype(int), axis=1)).mean() < 6 for rgb in walls)
    assert np.std([rgb.mean() for rgb in walls]) > 10


def test_a_folder_gives_its_images(tmp_path: Path, views: list[View]) -> None:
    (tmp_path / "b.jpg").write_bytes(views[0].jpeg())
    (tmp_path / "a.png").write_bytes(views[1].png())
    (tmp_path / "notes.txt").write_text("no image")
    check_places(["synthetic", str(tmp_path)])
    found = list(pictures_of(str(tmp_path), 1, 1))
    assert [name for name, _ in found] == ["a.png", "b.jpg"]
    assert np.array_equal(found[0][1], views[1].rgb)


def test_a_folder_without_images_is_refused(tmp_path: Path) -> None:
    for place in (str(tmp_path), str(tmp_path / "nowhere")):
        with pytest.raises(InvalidInputError, match="synthetic"):
            check_places([place])
