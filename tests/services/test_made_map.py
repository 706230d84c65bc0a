"""The steps of a build around its map, which is made once for all of these tests: what each step is given, what it
reports, what is stored and what the report says."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.engine.mapping.calibration_curves import PairCounts, fit_curves
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError, MapDamagedError
from app.geometry.lens import Lens
from app.importers.frames import Scan
from app.services.builds import run_build as module
from app.services.builds.place_scan import PresentMap
from app.services.builds.run_build import MadeMap, linked_scan, make_map, run_build, scratch, unpack
from app.services.builds.shared_work import SharedExecutor
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build, withdraw_build
from app.settings import Settings
from app.storage.builds import Build, claim_build, get_build
from app.storage.floors import put_floor
from app.storage.maps import KeyframeImages, get_map, list_keyframe_images, list_left_out, list_maps
from app.storage.venues import create_venue
from tests.scenes import CAMERA, CAMERA_TEXT, View, scan_files, zipped

OPTIONS = {"camera": CAMERA_TEXT, "refine_depth": False, "second_features": False}
# Stages that are reported, with how much is done of how much.
Reports = list[tuple[str, int, int]]


class Noted:
    """Progress that notes what is reported, and does something at a stage."""

    def __init__(self, stage: str = "", action: Callable[[], object] = lambda: None) -> None:
        self.reports: Reports = []
        self._stage, self._action = stage, action

    def report(self, stage: str, done: int, total: int) -> None:
        self.reports.append((stage, done, total))
        if stage == self._stage:
            self._action()


class Inline(SharedExecutor):
    """Makes each call at once, and notes what results are stated to depend on."""

    def __init__(self) -> None:
        self.stated: list[tuple[object, ...]] = []

    def depend_on(self, *values: object) -> None:
        self.stated.append(values)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Nothing runs."""


@dataclass(frozen=True)
class Prepared:
    """A data folder with a venue and a queued build, and the map that this build makes; its scan stays unpacked."""

    data_dir: Path
    made: MadeMap
    root: Path


def opened(data_dir: Path) -> Resources:
    return Resources.open(Settings(_env_file=None, data_dir=data_dir, open=True, workers=1))


@pytest.fixture(scope="module")
def prepared(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prepared]:
    """A scan of three frames that become keyframes and one that is too dark."""
    folder = tmp_path_factory.mktemp("made")
    resources = opened(folder / "data")
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    dark = View(views[4].world_from_camera, views[4].rgb // 60, views[4].depth_m)
    submit_build(resources, "v", OPTIONS, io.BytesIO(zipped(scan_files([*views[:3], dark]))))
    kept = folder / "kept"
    shutil.copytree(folder / "data", kept)
    build = claimed(resources)
    with scratch(folder / "scratch") as unpacked:
        root = unpack(build, resources, unpacked, NoProgress())
        made = make_map(build, resources, MapLibrary(resources), NoProgress(), unpacked, root)
        yield Prepared(kept, made, root)
    resources.close()


def claimed(resources: Resources, worker: str = "") -> Build:
    with resources.database.write() as connection:
        build = claim_build(connection, worker)
    assert build is not None
    return build


@pytest.fixture
def resources(prepared: Prepared, tmp_path: Path) -> Iterator[Resources]:
    """A venue of its own with the queued build."""
    shutil.copytree(prepared.data_dir, tmp_path, dirs_exist_ok=True)
    found = opened(tmp_path)
    yield found
    found.close()


@pytest.fixture
def made(prepared: Prepared) -> MadeMap:
    """The map, whose times are this test's alone."""
    return replace(prepared.made, seconds=dict(prepared.made.seconds))


@pytest.fixture
def publish(
    resources: Resources, made: MadeMap, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., dict[str, Any]]:
    """Runs a build whose map is made already, and returns the report of the version; the build is claimed anew."""

    def run(
        found: MadeMap | None = None, progress: Noted | None = None, worker: str = "w", queued: bool = True
    ) -> dict[str, Any]:
        if not queued:
            submit_build(resources, "v", OPTIONS, io.BytesIO(zipped({"rgb.txt": b"#"})))
        build = claimed(resources, worker)
        given = made if found is None else found
        with monkeypatch.context() as patched:
            patched.setattr(module, "make_map", lambda *_: given)
            version = run_build(build, resources, MapLibrary(resources), progress or Noted())
        with resources.database.read() as connection:
            ended, published = get_build(connection, build.id), get_map(connection, "v", version)
        assert (ended.state, ended.map_version, ended.report) == ("succeeded", version, published.statistics)
        return published.statistics

    return run


def with_options(made: MadeMap, **options: Any) -> MadeMap:
    return replace(made, examined=replace(made.examined, options=replace(made.examined.options, **options)))


def extending(made: MadeMap, resources: Resources, **options: Any) -> MadeMap:
    """Return the map as one that extends what serves."""
    found = MapLibrary(resources).active("v")
    assert found is not None
    return replace(with_options(made, mode="extend", **options), present=PresentMap(*found, ()))


def pictures(resources: Resources, version: int) -> list[KeyframeImages]:
    with resources.database.read() as connection:
        return list_keyframe_images(connection, "v", version)


def left_out(resources: Resources, version: int) -> list[str]:
    with resources.database.read() as connection:
        return [frame.name for frame in list_left_out(connection, "v", version)]


# What is published.


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


# How the map is made.


@dataclass
class Steps:
    """Stands in for the parts of a build that take time: returns what they made of the scan."""

    made: MadeMap
    up_is_known: list[bool]

    def put_in(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "read_scan", self._read_scan)
        monkeypatch.setattr(module, "place_scan", lambda *_: self.made.placement)
        monkeypatch.setattr(module, "build_map", lambda *_: self.made.built)
        monkeypatch.setattr(module, "check_map", lambda *_: self.made.check)

    def _read_scan(self, *_: object, up_is_known: bool, scratch: Path) -> object:
        assert scratch.is_dir()
        self.up_is_known.append(up_is_known)
        return self.made.examined


@pytest.fixture
def steps(made: MadeMap, monkeypatch: pytest.MonkeyPatch) -> Steps:
    found = Steps(made, [])
    found.put_in(monkeypatch)
    return found


def test_a_scan_is_unpacked_unless_another_worker_has_done_so(
    steps: Steps, resources: Resources, prepared: Prepared, tmp_path: Path
) -> None:
    build = claimed(resources)
    for root, unpacks in ((None, True), (prepared.root, False)):
        progress = Noted()
        folder = tmp_path / f"scratch-{unpacks}"
        folder.mkdir()
        found = make_map(build, resources, MapLibrary(resources), progress, folder, root)
        assert found.built is steps.made.built
        assert (progress.reports[0][0] == "unpack") == unpacks == (folder / module.UNPACKED).exists()
        assert progress.reports[-1] == ("read", 0, 1)
        assert {stage for stage, *_ in progress.reports} <= {"unpack", "read"}
    assert steps.up_is_known == [False, False]


def test_the_seconds_of_each_stage_are_the_clocks(
    steps: Steps,
    publish: Callable[..., dict[str, Any]],
    resources: Resources,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    def clock(*times: float) -> None:
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=iter(times).__next__))

    library = MapLibrary(resources)
    with resources.database.read() as connection:
        build = get_build(connection, str(connection.exec_driver_sql("select id from builds").scalar()))
    clock(10.0, 11.23456, 14.35802, 19.70370, 30.0, 36.78912)
    found = make_map(build, resources, library, NoProgress(), tmp_path)
    built = steps.made.built.seconds
    assert found.seconds == {"unpack": 1.235, "examine": 3.123, "place": 5.346, **built, "verify": 6.789}
    clock(100.0, 107.65432)
    assert publish(found)["seconds"] == {**found.seconds, "store": 7.654}


@pytest.mark.parametrize("z_is_up", [None, False, True], ids=str)
def test_what_results_depend_on_is_stated_before_they_are_made(
    steps: Steps,
    publish: Callable[..., dict[str, Any]],
    resources: Resources,
    tmp_path: Path,
    z_is_up: bool | None,
) -> None:
    if z_is_up is not None:
        publish(replace(steps.made, placement=replace(steps.made.placement, z_up=z_is_up)))
        submit_build(resources, "v", OPTIONS, io.BytesIO(zipped({"rgb.txt": b"#"})))
    with resources.database.write() as connection:
        for floor, plan in (("ground", np.eye(4)), ("roof", None)):
            put_floor(
                connection,
                "v",
                floor,
                name="",
                level=0,
                z_min_m=0.0,
                z_max_m=3.0,
                plan_from_world=plan,
                plan_residual_m=None,
            )
    together = replace(resources, executor=Inline())
    make_map(claimed(resources), together, MapLibrary(resources), NoProgress(), tmp_path, tmp_path)
    assert steps.up_is_known == [bool(z_is_up)]
    placement = steps.made.placement
    assert isinstance(together.executor, Inline)
    first, *present, last = together.executor.stated
    assert first[1] == resources.models.global_descriptor.sha256
    assert last == (placement.world_from_scan.matrix.tobytes(), placement.z_up)
    if z_is_up is None:
        assert present == []
    else:
        with resources.database.read() as connection:
            version = get_map(connection, "v", 1)
        assert present == [(version.artifact_blob, ("ground",))]


def test_a_damaged_map_is_replaced_by_what_fits_the_one_before_and_not_extended(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    build, library = claimed(resources, "other"), MapLibrary(resources)
    options = made.examined.options
    assert module._present_map(build, options, library, resources) is None
    publish(queued=False)
    publish(extending(made, resources), queued=False)
    found = module._present_map(build, options, MapLibrary(resources), resources)
    assert found is not None
    assert (found.version.version, found.placed_floors) == (2, ())
    resources.blobs.local_path(found.version.artifact_blob).write_bytes(b"damaged" * 99)
    before = module._present_map(build, options, MapLibrary(resources), resources)
    assert before is not None
    assert before.version.version == 1
    with pytest.raises(MapDamagedError):
        module._present_map(build, replace(options, mode="extend"), MapLibrary(resources), resources)
    resources.blobs.local_path(before.version.artifact_blob).write_bytes(b"damaged" * 99)
    assert module._present_map(build, options, MapLibrary(resources), resources) is None


# Folders.


def test_a_scratch_folder_is_empty_at_first_and_gone_in_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "of" / "a build"
    for leaves in (True, False):
        with scratch(folder) as found:
            assert list(found.iterdir()) == []
            (found / "file").write_text("")
            if not leaves:
                shutil.rmtree(found)
        assert not folder.exists()
    folder.mkdir()
    (folder / "left by a killed worker").write_text("")
    with scratch(folder) as found:
        assert list(found.iterdir()) == []


def test_an_unpacked_scan_is_linked_by_another_worker_once_it_is_whole(
    resources: Resources, tmp_path: Path
) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir()
    assert linked_scan(own, other) is None
    progress = Noted()
    root = unpack(claimed(resources), resources, own, progress)
    assert {stage for stage, *_ in progress.reports} == {"unpack"}
    assert progress.reports[-1][1] == progress.reports[-1][2] > 0
    found = linked_scan(own, other)
    assert found == other / root.relative_to(own)
    names = sorted(path.relative_to(root) for path in root.rglob("*.png"))
    assert len(names) == 8
    assert all((root / name).samefile(found / name) for name in names)
    assert not (own / f"{module.UNPACKED}.part").exists()
