"""A build from its row in the database to a published map version."""

from __future__ import annotations

import logging
import os
import shutil
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from app.engine.mapping.build_map import BuiltMap, build_map, in_chunks
from app.engine.mapping.extend_map import join_maps
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.mapping.self_check import SelfCheck, check_map
from app.engine.maps.artifact import MapArtifact
from app.engine.progress import Progress
from app.errors import CancelledBuildError, ConflictError, MapDamagedError
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.frames import Frame
from app.importers.unpack_scan import unpack_scan
from app.services.builds.left_out import left_out_frames
from app.services.builds.place_scan import Placement, PresentMap, place_scan
from app.services.builds.shared_work import SharedExecutor
from app.services.examine_scan import ExaminedScan, read_scan
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.builds import Build, finish_build, report_progress
from app.storage.floors import list_floors
from app.storage.map_files import write_map
from app.storage.maps import KeptFrame, KeyframeImages, add_left_out, list_keyframe_images, publish_map
from app.storage.sweep import discard_blobs
from app.vision.faces.blur import with_blurred_faces
from app.vision.faces.detector import FaceDetector

log = logging.getLogger("roomfix.builds")
# In the scratch folder of a build: the files of its scan.
SCAN = "scan"
# Beside them once all are there: the file that says where among them the scan is.
UNPACKED = "unpacked"


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeMap:
    """The map of a scan before it is stored: the scan, the map, its place, its check, and the seconds of each stage.

    `present` is the map that served when the build began.
    """

    examined: ExaminedScan
    built: BuiltMap
    placement: Placement
    check: SelfCheck
    seconds: dict[str, float]
    present: PresentMap | None


def run_build(build: Build, resources: Resources, library: MapLibrary, progress: Progress) -> int:
    """Run a build and publish its map in one transaction; return the version.

    Raises `InvalidScanError`, `InvalidInputError` or `CancelledBuildError`; nothing is visible then.
    """
    with scratch(scratch_folder(resources, build)) as folder:
        made = make_map(build, resources, library, progress, folder)
        with _discarded_on_failure(build, resources) as written:
            return _publish(build, made, resources, folder, written, progress)


def make_map(
    build: Build,
    resources: Resources,
    library: MapLibrary,
    progress: Progress,
    folder: Path,
    root: Path | None = None,
) -> MadeMap:
    """Return the map of a build's scan, which is unpacked to a folder unless it is at `root`; raises as `run_build`.

    The executor of `resources` does all heavy work, whose results depend on the build and on what is stated to it.
    """
    started = time.perf_counter()
    options = parse_build_options(build.options)
    root = unpack(build, resources, folder, progress) if root is None else root
    progress.report("read", 0, 1)
    unpacked = time.perf_counter()
    present = _present_map(build, options, library, resources)
    _state(resources.executor, version("roomfix"), resources.models.global_descriptor.sha256)
    if present is not None:
        _state(resources.executor, present.version.artifact_blob, present.placed_floors)
    z_is_up = present is not None and present.version.z_up
    examined = read_scan(root, build.options, resources, progress, up_is_known=z_is_up, scratch=folder)
    source, options = examined.scan, examined.options
    seen = time.perf_counter()
    placement = place_scan(source, options, present, resources.executor, progress)
    placed = time.perf_counter()
    _state(resources.executor, placement.world_from_scan.matrix.tobytes(), placement.z_up)
    built = build_map(
        source,
        options,
        resources.models,
        resources.executor,
        progress,
        placement.world_from_scan,
        placement.z_up,
    )
    seconds = {
        "unpack": round(unpacked - started, 3),
        "examine": round(seen - unpacked, 3),
        "place": round(placed - seen, 3),
        **built.seconds,
    }
    began = time.perf_counter()
    check = check_map(built, source, resources.models, resources.executor, progress, examined.examination)
    seconds["verify"] = round(time.perf_counter() - began, 3)
    return MadeMap(
        examined=examined, built=built, placement=placement, check=check, seconds=seconds, present=present
    )


def _state(executor: Executor, *values: object) -> None:
    """Let results of other workers be used only if they stated the same."""
    if isinstance(executor, SharedExecutor):
        executor.depend_on(*values)


def _present_map(
    build: Build, options: BuildOptions, library: MapLibrary, resources: Resources
) -> PresentMap | None:
    """Return the map that serves. One that can't be opened, as after a change of the global descriptor, is what
    a new build replaces, so it doesn't stand in its way."""
    try:
        # The version before a damaged one may give the world, but isn't what is to be extended.
        found = library.active(build.venue_id, is_whole=options.mode == "extend")
    except (ConflictError, MapDamagedError) as error:
        if options.mode == "extend":
            raise
        log.warning("the present map of venue %s can't be used: %s", build.venue_id, error)
        return None
    if found is None:
        return None
    with resources.database.read() as connection:
        floors = list_floors(connection, build.venue_id)
    return PresentMap(*found, tuple(floor.id for floor in floors if floor.plan_from_world is not None))


def scratch_folder(resources: Resources, build: Build) -> Path:
    """Return the folder of one attempt at a build."""
    return resources.scratch_dir / f"{build.id}-{build.attempts}"


@contextmanager
def scratch(folder: Path) -> Iterator[Path]:
    """Make an empty folder, and remove it in the end."""
    # A worker that was killed may have left a half-unpacked scan.
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _discarded_on_failure(build: Build, resources: Resources) -> Iterator[set[str]]:
    """Give a set for the blobs that are stored; they are removed again when the block raises."""
    written: set[str] = set()
    try:
        yield written
    except BaseException:
        discard_blobs(resources.database, resources.blobs, written, written_by=build.id)
        raise


def unpack(build: Build, resources: Resources, folder: Path, progress: Progress) -> Path:
    """Unpack a build's scan to a folder, and note there that it is whole; return the scan's own folder."""
    archive = resources.blobs.local_path(build.archive_blob)
    limits = ArchiveLimits(max_total_bytes=resources.settings.max_unpacked_bytes)

    def report(done: int, total: int) -> None:
        progress.report("unpack", done, total)

    root = unpack_scan(archive, folder / SCAN, limits, report)
    noted = folder / f"{UNPACKED}.part"
    noted.write_text(root.relative_to(folder).as_posix())
    noted.replace(folder / UNPACKED)
    return root


def linked_scan(unpacked: Path, folder: Path) -> Path | None:
    """Link the files of a scan that another worker has unpacked into a folder of our own, where they stay when that
    worker removes its own; return the scan's folder, None while the scan isn't whole. Raises `OSError`."""
    try:
        root = (unpacked / UNPACKED).read_text()
    except FileNotFoundError:
        return None
    shutil.copytree(unpacked / SCAN, folder / SCAN, copy_function=os.link)
    return folder / root


def _publish(
    build: Build, made: MadeMap, resources: Resources, folder: Path, written: set[str], progress: Progress
) -> int:
    began = time.perf_counter()
    options, present, seconds = made.examined.options, made.present, made.seconds
    progress.report("store", 0, 1)
    artifact, index = made.check.stated_in(made.built.artifact), made.built.index
    images = _store_images(made.built, options, resources, written)
    if options.mode == "extend" and present is not None:
        opened = present.map
        artifact, index = join_maps(
            opened.artifact,
            opened.index,
            artifact,
            index,
            resources.models.extractor(options.features).binary,
            in_chunks(resources.executor, progress),
        )
        with resources.database.read() as connection:
            before = list_keyframe_images(connection, build.venue_id, present.version.version)
        # Pictures are kept for all keyframes or for none.
        images = [*before, *images] if len(before) == opened.artifact.keyframe_count and images else []
    # Nor is there a picture of what was left out in a map without pictures.
    left_out = _store_left_out(made, resources, written) if images else []
    artifact_path, index_path = folder / "map.rfmap", folder / "global.faiss"
    write_map(artifact, index, artifact_path, index_path)
    artifact_blob = resources.blobs.put_file(artifact_path)
    index_blob = resources.blobs.put_file(index_path)
    written.update((artifact_blob, index_blob))
    seconds["store"] = round(time.perf_counter() - began, 3)
    sizes = {"features": artifact_path.stat().st_size, "index": index_path.stat().st_size}
    report = _report(made, artifact, sizes)
    progress.report("publish", 0, 1)
    with resources.database.write() as connection:
        # Once more with the lock: a cancellation that was acknowledged counts, however late it came.
        if report_progress(connection, build.id, "publish", 0, 1, build.worker or ""):
            raise CancelledBuildError(f"Build {build.id} was cancelled.")
        version = publish_map(connection, build.venue_id, build.id, artifact_blob, index_blob, report, images)
        add_left_out(connection, build.venue_id, version, left_out)
        finish_build(
            connection,
            build.id,
            "succeeded",
            worker=build.worker or "",
            report=report,
            map_version=version,
        )
    return version


def _report(made: MadeMap, artifact: MapArtifact, sizes: dict[str, int]) -> dict[str, Any]:
    """Return what the build tells its admin; `artifact` is the venue's whole map."""
    examined, built, placement, check = made.examined, made.built, made.placement, made.check
    source, options = examined.scan, examined.options
    report = {
        **examined.repairs_report(),
        "warnings": [*examined.warnings, *placement.warnings, *check.warnings],
        "frames": len(source.frames) + sum(len(names) for names in source.discarded.values()),
        "discarded": {reason: len(names) for reason, names in built.discarded.items()},
        "discarded_frames": {reason: list(names[:100]) for reason, names in built.discarded.items()},
        "notes": list(source.notes),
        "replaced": built.replaced,
        "keyframes": built.artifact.keyframe_count,
        "features": built.artifact.feature_count,
        "feature_method": options.features,
        "map_keyframes": artifact.keyframe_count,
        "bytes": sizes,
        "seconds": made.seconds,
        "world_from_scan": placement.world_from_scan.matrix.tolist(),
        "placement": {
            "source": placement.source,
            "z_up": placement.z_up,
            "has_scale": source.has_scale,
            **placement.figures,
        },
        "examination": None if examined.examination is None else examined.examination.as_dict(),
        "self_check": check.as_dict(),
        "lens": next(
            (
                {"k1": round(lens.coefficient, 4), "sigma": round(lens.sigma, 4)}
                for _, lens in built.artifact.metadata.shown_lenses
            ),
            None,
        ),
    }
    if built.calibration is not None:
        report["calibration"] = built.calibration.as_dict(points=False)
    return report


def _store_images(
    built: BuiltMap, options: BuildOptions, resources: Resources, written: set[str]
) -> list[KeyframeImages]:
    if not options.store_images:
        return []

    faces = _faces(options, resources)

    def store(frame: Frame) -> KeyframeImages:
        changed = None if faces is None else with_blurred_faces(frame.color.read_bytes(), faces)
        color = resources.blobs.put_file(frame.color) if changed is None else resources.blobs.put(changed)
        images = KeyframeImages(color, resources.blobs.put_file(frame.depth))
        written.update((images.color_blob, images.depth_blob))
        return images

    return [store(frame) for frame in built.keyframes]


def _store_left_out(made: MadeMap, resources: Resources, written: set[str]) -> list[KeptFrame]:
    """Store pictures of frames that were left out."""
    faces = _faces(made.examined.options, resources)
    kept = []
    for frame in left_out_frames(made.examined.scan, made.built.discarded, faces):
        blob = resources.blobs.put(frame.jpeg)
        written.add(blob)
        kept.append(KeptFrame(reason=frame.reason, name=frame.name, time_s=frame.time_s, picture_blob=blob))
    return kept


def _faces(options: BuildOptions, resources: Resources) -> FaceDetector | None:
    """Return what finds the faces that are to be blurred, None where none are."""
    return resources.models.faces if options.blur_faces else None
