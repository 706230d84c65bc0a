"""What a build publishes of its map: what is stored, removed again, and said in the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.engine.mapping.calibration_curves import PairCounts, fit_curves
from app.errors import CancelledBuildError
from app.geometry.lens import Lens
from app.importers.frames import Scan
from app.services.builds import run_build as module
from app.services.builds.run_build import MadeMap
from app.services.resources import Resources
from app.services.submit_build import withdraw_build
from app.storage.builds import get_build
from app.storage.maps import list_maps
from tests.made_map import (
    Noted,
    extending,
    left_out,
    pictures,
    with_options,
)
from tests.scenes import CAMERA


def test_map_pictures_and_left_out_frames_are_published_and_reported(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    progress = Noted()
    report = publish(progress=progress)
    assert (report["keyframes"], report["map_keyframes"], report["frames"]) == (3, 3, 4)
    assert progress.reports == [("store", 0, 1), ("publish", 0, 1)]
    assert [resources.blobs.get(each.color_blob) for each in pictures(resources, 1)] == [
        frame.color.read_bytes() for frame in made.built.keyframes
    ]
    assert left_out(resources, 1) == [name for names in made.built.discarded.values() for name in names]
    assert len(left_out(resources, 1)) == 1
    with resources.database.read() as connection:
        (version,) = list_maps(connection, "v")
    sizes = [
        resources.blobs.local_path(blob).stat().st_size
        for blob in (version.artifact_blob, version.index_blob)
    ]
    assert list(report["bytes"].values()) == sizes
    assert not list(resources.scratch_dir.iterdir())


def test_without_pictures_none_are_kept_of_what_was_left_out_either(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    publish(with_options(made, store_images=False))
    assert (pictures(resources, 1), left_out(resources, 1)) == ([], [])


def test_an_extension_keeps_the_pictures_of_all_keyframes_or_none(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    publish()
    assert publish(extending(made, resources), queued=False)["map_keyframes"] == 6
    assert len(pictures(resources, 2)) == 6
    assert publish(extending(made, resources, store_images=False), queued=False)["map_keyframes"] == 9
    assert pictures(resources, 3) == []
    # Now the keyframes of the map have none.
    assert publish(extending(made, resources), queued=False)["map_keyframes"] == 12
    assert (pictures(resources, 4), left_out(resources, 4)) == ([], [])


def test_only_an_extension_of_a_map_is_joined_with_it(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    # There is nothing to extend yet.
    assert publish(with_options(made, mode="extend"))["map_keyframes"] == 3
    instead = replace(extending(made, resources), examined=made.examined)
    assert publish(instead, queued=False)["map_keyframes"] == 3
    assert len(pictures(resources, 2)) == 3


@pytest.mark.parametrize("shows_one", [True, False])
def test_faces_are_blurred_where_that_is_asked_and_a_picture_shows_one(
    publish: Callable[..., dict[str, Any]],
    resources: Resources,
    made: MadeMap,
    monkeypatch: pytest.MonkeyPatch,
    shows_one: bool,
) -> None:
    detectors: list[object] = []

    def blurred(data: bytes, detector: object) -> bytes | None:
        detectors.append(detector)
        return b"blurred" + data if shows_one else None

    def described(_scan: Scan, _discarded: object, detector: object) -> list[object]:
        detectors.append(detector)
        return []

    own = object()
    monkeypatch.setattr(module, "with_blurred_faces", blurred)
    monkeypatch.setattr(module, "left_out_frames", described)
    monkeypatch.setattr(type(resources.models), "faces", own)
    publish(with_options(made, blur_faces=True))
    assert detectors == [own] * 4
    plain = [frame.color.read_bytes() for frame in made.built.keyframes]
    stored = [resources.blobs.get(each.color_blob) for each in pictures(resources, 1)]
    assert stored == ([b"blurred" + data for data in plain] if shows_one else plain)
    detectors.clear()
    publish(with_options(made, blur_faces=False), queued=False)
    assert detectors == [None]
    assert [resources.blobs.get(each.color_blob) for each in pictures(resources, 2)] == plain


def test_the_report_counts_frames_and_names_a_hundred_of_a_kind(
    publish: Callable[..., dict[str, Any]], made: MadeMap
) -> None:
    names = tuple(f"{number}.png" for number in range(101))
    scan = replace(made.examined.scan, discarded={"no_pose": names, "no_depth": names[:2]})
    report = publish(
        replace(
            made,
            built=replace(made.built, discarded={"no_pose": names}),
            examined=replace(made.examined, scan=scan),
        )
    )
    assert report["frames"] == len(scan.frames) + 103
    assert report["discarded"] == {"no_pose": 101}
    assert report["discarded_frames"] == {"no_pose": list(names[:100])}


def test_the_report_holds_examination_lens_and_calibration_where_there_are_some(
    publish: Callable[..., dict[str, Any]], made: MadeMap
) -> None:
    assert made.examined.examination is not None
    metadata = replace(
        made.built.artifact.metadata, cameras=(Lens(0.123456).of(CAMERA),), lens_sigmas=(0.0123456,)
    )
    artifact = replace(made.built.artifact, metadata=metadata)
    rng = np.random.default_rng(0)
    apart = rng.uniform(0.01, 1.0, 400)
    calibration = fit_curves(
        PairCounts(apart, apart, np.round(20 * apart**-0.5).astype(np.int64), rng.random(400) < 0.2),
        50.0,
        "sift",
        30,
    )
    found = publish(replace(made, built=replace(made.built, artifact=artifact, calibration=calibration)))
    assert found["lens"] == {"k1": 0.1235, "sigma": 0.0123}
    assert found["calibration"] == calibration.as_dict(points=False)
    assert found["examination"] == made.examined.examination.as_dict()
    bare = replace(made, examined=replace(made.examined, examination=None))
    found = publish(bare, queued=False)
    assert (found["lens"], found["examination"], "calibration" in found) == (None, None, False)


def test_a_cancellation_or_another_worker_ends_a_build_before_it_is_published(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    before = resources.blobs.digests()

    def cancelled() -> None:
        with resources.database.read() as connection:
            build = connection.exec_driver_sql("select id from builds").scalar()
        withdraw_build(resources, str(build))

    with pytest.raises(CancelledBuildError):
        publish(progress=Noted("publish", cancelled))
    assert resources.blobs.digests() == before


def test_what_was_stored_is_removed_when_publishing_breaks(
    publish: Callable[..., dict[str, Any]], resources: Resources, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = resources.blobs.digests()

    def full_disk(*_: object) -> None:
        # Map, index, two pictures of each keyframe, one of the dark frame.
        assert len(resources.blobs.digests() - before) == 9
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "add_left_out", full_disk)
    with pytest.raises(OSError, match="No space"):
        publish()
    assert resources.blobs.digests() == before
    assert not list(resources.scratch_dir.iterdir())
    with resources.database.read() as connection:
        assert list_maps(connection, "v") == []


def test_a_build_shows_the_stage_that_it_ended_in(
    publish: Callable[..., dict[str, Any]], resources: Resources
) -> None:
    publish(worker="")
    with resources.database.read() as connection:
        build = get_build(connection, str(connection.exec_driver_sql("select id from builds").scalar()))
    assert (build.stage, build.done, build.total) == ("publish", 0, 1)
