"""Photos of a room become a scan with poses, scale and up; what is stated of the scale is found in the pictures."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.engine.mapping.structure import estimate
from app.engine.mapping.structure.chosen import ChosenPictures, choose_pictures
from app.engine.mapping.structure.estimate import OPTIONS, estimate_poses
from app.engine.mapping.structure.floor.levels import find_floor
from app.engine.mapping.structure.markers import DICTIONARY
from app.engine.mapping.structure.matches import MatchedPictures, match_pictures
from app.engine.mapping.structure.reconstruction import Reconstruction, reconstruct
from app.engine.mapping.structure.scale import FoundScale, doubts_of, find_scale
from app.engine.mapping.structure.scale_options import (
    KnownDistance,
    KnownHeight,
    KnownMarker,
    KnownPlaces,
    PlanPlace,
    Scale,
)
from app.engine.mapping.structure.sequence import Path3D
from app.engine.mapping.structure.up import DownDirection, down_by_sensor, find_down
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError, InvalidScanError
from app.geometry.alignment import Alignment, align_points
from app.geometry.se3 import Pose
from app.importers.frames import DepthFormat
from app.importers.unposed.scan import UnposedScan
from app.vision.images import Gray, decode_image, to_gray
from tests.rendered_maps import models
from tests.scenes import CAMERA, DEPTH_SCALE, TEXELS_PER_M, Room, encode, pose_at

MARKER_M = 0.4
# Texels from the left and from the floor, on the wall that the photos show.
MARKER_AT = (250, 150)
BORDER = 12
COUNT = 14
HEIGHT_M = 1.4


def poses() -> list[Pose]:
    """A walk along a wall, looking down enough to see the floor."""
    return [
        pose_at(0.9 + 0.12 * i, 0.7 + 0.03 * i, HEIGHT_M + 0.05 * (i % 3 - 1), 62 + 3.0 * i, -24 + i % 4)
        for i in range(COUNT)
    ]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    room = Room(seed=4)
    side = int(MARKER_M * TEXELS_PER_M)
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(DICTIONARY), 0, side)
    wall, (left, bottom) = room._prints[1, 1], MARKER_AT
    wall[bottom - BORDER : bottom + side + BORDER, left - BORDER : left + side + BORDER] = 255
    # Rows of a wall go upwards.
    wall[bottom : bottom + side, left : left + side] = marker[::-1, :, None]
    folder = tmp_path_factory.mktemp("photos")
    for i, pose in enumerate(poses()):
        (folder / f"{i:03d}.png").write_bytes(room.view(pose).png())
    return tuple(sorted(folder.iterdir()))


@pytest.fixture(scope="module")
def executor() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as threads:
        yield threads


@pytest.fixture(scope="module")
def chosen(photos: tuple[Path, ...]) -> ChosenPictures:
    return choose_pictures(UnposedScan(format="images", photos=photos), (), 8, NoProgress())


@pytest.fixture(scope="module")
def matched(chosen: ChosenPictures, executor: ThreadPoolExecutor) -> MatchedPictures:
    return match_pictures(chosen, models(), executor, NoProgress())


@pytest.fixture(scope="module")
def part(chosen: ChosenPictures, matched: MatchedPictures) -> Reconstruction:
    (whole,) = reconstruct(
        matched, chosen.scan.camera, is_calibrated=False, scratch=None, progress=NoProgress()
    )
    return whole


@pytest.fixture(scope="module")
def true_from_scan(part: Reconstruction) -> Alignment:
    estimated = [pose.translation for pose in part.poses.values()]
    return align_points(estimated, [poses()[row].translation for row in part.poses], with_scale=True)


@cache
def gray_of(path: Path) -> Gray:
    return to_gray(decode_image(path.read_bytes()))


@pytest.fixture(scope="module")
def down(
    part: Reconstruction, photos: tuple[Path, ...], executor: ThreadPoolExecutor
) -> DownDirection | None:
    return find_down(part, lambda row: gray_of(photos[row]), executor, NoProgress())


def test_nothing_is_known_of_the_camera_and_all_is_found(
    part: Reconstruction, true_from_scan: Alignment
) -> None:
    assert sorted(part.poses) == list(range(COUNT))
    assert part.camera.focal_px == pytest.approx(CAMERA.focal_px, rel=0.02)
    assert true_from_scan.residual_rms_m < 0.01


def test_down_is_found_by_the_edges(down: DownDirection | None, true_from_scan: Alignment) -> None:
    assert down is not None
    in_room = true_from_scan.target_from_source.rotation @ down.down
    assert np.degrees(np.arccos(-in_room[2])) < 2.0


def test_down_is_found_by_the_phones_sensors_unless_they_contradict_each_other(
    part: Reconstruction, true_from_scan: Alignment
) -> None:
    rng = np.random.default_rng(0)
    held = {}
    for row in part.poses:
        down = poses()[row].rotation.T @ [0.0, 0.0, -1.0] + np.radians(1.5) * rng.standard_normal(3)
        held[row] = (float(down[0]), float(down[1]), float(down[2]))
    found = down_by_sensor(part, held)
    assert found is not None
    assert found.source == "sensor"
    in_room = true_from_scan.target_from_source.rotation @ found.down
    assert np.degrees(np.arccos(-in_room[2])) < 1.5
    assert down_by_sensor(part, dict(list(held.items())[:4])) is None
    # Axes that turn with nothing, as those of a browser that states them otherwise.
    wrong = {row: ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))[row % 3] for row in part.poses}
    assert down_by_sensor(part, wrong) is None


def corner_pixels(row: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """The lower corners of the marker in a photo."""
    left, bottom = (texel / TEXELS_PER_M for texel in MARKER_AT)
    wall_m = Room(seed=4).size_m[1]
    corners = np.array([[left, wall_m, bottom], [left + MARKER_M, wall_m, bottom]])
    first, second = CAMERA.project(poses()[row].inverse().apply(corners)).tolist()
    return (first[0], first[1]), (second[0], second[1])


def places(count: int = 4, wrong: float = 0.0) -> KnownPlaces:
    """Where the camera stood, on a plan that is turned by a quarter and moved."""
    stood = [(row, poses()[row].translation) for row in np.linspace(0, COUNT - 1, count).round().astype(int)]
    given = [PlanPlace(f"{row:03d}.png", (7.0 - y, 2.0 + x), None) for row, (x, y, _) in stood]
    given[-1] = replace(given[-1], plan=(given[-1].plan[0] + wrong, given[-1].plan[1]))
    # A point on the wall: the places of a straight walk alone are nearly on one line.
    left, bottom = MARKER_AT[0] / TEXELS_PER_M, Room(seed=4).size_m[1]
    return KnownPlaces((*given, PlanPlace("006.png", (7.0 - bottom, 2.0 + left), corner_pixels(6)[0])))


@pytest.mark.parametrize(
    ("scale", "source", "tolerance"),
    [
        (KnownMarker(MARKER_M), "marker", 0.02),
        (KnownDistance(MARKER_M, "006.png", corner_pixels(6)), "distance", 0.03),
        (KnownHeight(HEIGHT_M), "camera_height", 0.03),
        (places(), "correspondences", 0.03),
    ],
    ids=["marker", "distance", "height", "places"],
)
def test_the_scale_by_what_is_known(
    scale: Scale,
    source: str,
    tolerance: float,
    part: Reconstruction,
    chosen: ChosenPictures,
    down: DownDirection | None,
    photos: tuple[Path, ...],
    executor: ThreadPoolExecutor,
    true_from_scan: Alignment,
) -> None:
    found = find_scale(scale, part, chosen, down, lambda row: gray_of(photos[row]), executor, NoProgress())
    assert found is not None
    assert found.source == source
    assert found.metres_per_unit == pytest.approx(true_from_scan.scale, rel=tolerance)
    if found.plan_from_scan is not None:
        stood = found.metres_per_unit * part.poses[3].translation
        x, y, _ = poses()[3].translation
        assert found.plan_from_scan.apply(stood[None])[0, :2] == pytest.approx([7.0 - y, 2.0 + x], abs=0.05)


def test_the_floor_is_found_below_photos(
    part: Reconstruction, down: DownDirection | None, true_from_scan: Alignment
) -> None:
    assert down is not None
    floor = find_floor(part, down.down)
    assert floor is not None
    assert floor.height * true_from_scan.scale == pytest.approx(HEIGHT_M, rel=0.02)


@pytest.mark.parametrize(
    ("source", "height_m", "said"),
    [
        ("marker", 1.4, None),
        ("marker", 4.6, "check the numbers of scale, which are metres"),
        ("depth", 0.3, "check depth_scale"),
    ],
)
def test_a_camera_that_was_held_high_or_low_raises_doubts(
    part: Reconstruction, down: DownDirection | None, source: str, height_m: float, said: str | None
) -> None:
    assert down is not None
    floor = find_floor(part, down.down)
    assert floor is not None
    scale = FoundScale(metres_per_unit=height_m / floor.height, source=source)
    expected = (
        [] if said is None else [f"By this scale the camera was held {height_m:g} m above the floor: {said}."]
    )
    assert doubts_of(scale, floor, 1.0) == expected
    assert doubts_of(replace(scale, source="camera_height"), floor, 1.0) == []
    assert doubts_of(scale, None, 2.0 / scale.metres_per_unit) == doubts_of(None, floor, 1.0) == []


def test_the_report_says_how_high_the_camera_was_held_and_a_warning_how_unsteadily(
    part: Reconstruction, chosen: ChosenPictures, down: DownDirection | None
) -> None:
    assert down is not None
    floor = find_floor(part, down.down)
    assert floor is not None
    scale = FoundScale(metres_per_unit=1.37 / floor.height, source="marker")
    path = Path3D([part], None, joined=2)
    unsteady = replace(floor, held=np.linspace(0.9, 1.1, 11))
    found = estimate._report(chosen, path, down, unsteady, scale)["floor"]
    assert found == {
        "points": len(floor.points),
        "camera_height_m": 1.37,
        "camera_height_varies_by": pytest.approx(0.16),
    }
    assert estimate._report(chosen, path, down, floor, None)["floor"]["camera_height_m"] is None
    (said,) = estimate._warnings(chosen, path, unsteady, scale)
    assert "varies by 16% along the path" in said
    (said,) = estimate._warnings(chosen, path, None, scale)
    assert "joined of 2 parts, and too little of the floor is in view" in said
    for steady, joined in ((floor, 2), (unsteady, 1), (None, 1)):
        assert estimate._warnings(chosen, Path3D([part], None, joined=joined), steady, scale) == ()
    with_depth = replace(chosen, scan=replace(chosen.scan, has_depth=True))
    for doubtful in (unsteady, None):
        assert estimate._warnings(with_depth, path, doubtful, scale) == ()


def test_a_camera_that_hardly_moves_is_warned_of(part: Reconstruction, chosen: ChosenPictures) -> None:
    moved = {row: Pose(pose.rotation, 0.1 * pose.translation) for row, pose in part.poses.items()}
    path, scale = Path3D([replace(part, poses=moved)], None), FoundScale(metres_per_unit=1.0, source="marker")
    (said,) = estimate._warnings(chosen, path, None, scale)
    assert "the camera hardly moved" in said
    assert estimate._report(chosen, path, None, None, scale)["angle_deg"] < OPTIONS.warned_angle_deg
    with_depth = replace(chosen, scan=replace(chosen.scan, has_depth=True))
    assert estimate._warnings(with_depth, path, None, scale) == ()


@pytest.mark.parametrize("height_m", [145.0, 0.002])
def test_a_scale_in_another_unit_is_refused(
    part: Reconstruction, down: DownDirection | None, height_m: float
) -> None:
    assert down is not None
    floor = find_floor(part, down.down)
    assert floor is not None
    scale = FoundScale(metres_per_unit=height_m / floor.height, source="marker")
    with pytest.raises(
        InvalidScanError, match=f"held {height_m:g} m above the floor: check the numbers of scale"
    ):
        doubts_of(scale, floor, 1.0)


def scale_by_depth(
    part: Reconstruction, chosen: ChosenPictures, folder: Path, executor: ThreadPoolExecutor, later: int
) -> FoundScale | None:
    """Return the scale by the depth images of pictures that are so many later."""
    room, frames = Room(seed=4), []
    for row, frame in enumerate(chosen.scan.frames):
        depth, pose = folder / f"{row}.png", poses()[(row + later) % COUNT]
        depth.write_bytes(encode(np.rint(room.view(pose).depth_m * DEPTH_SCALE).astype(np.uint16), ".png"))
        frames.append(replace(frame, depth=depth))
    scan = replace(chosen.scan, frames=tuple(frames), has_depth=True, depth=DepthFormat(scale=DEPTH_SCALE))
    own = replace(chosen, scan=scan)
    return find_scale(None, part, own, None, lambda _: np.zeros((9, 9), np.uint8), executor, NoProgress())


def test_the_scale_by_depth_images(
    part: Reconstruction,
    chosen: ChosenPictures,
    tmp_path: Path,
    executor: ThreadPoolExecutor,
    true_from_scan: Alignment,
) -> None:
    found = scale_by_depth(part, chosen, tmp_path, executor, 0)
    assert found is not None
    assert found.source == "depth"
    assert found.metres_per_unit == pytest.approx(true_from_scan.scale, rel=0.01)
    with pytest.raises(InvalidScanError, match="contradict the pictures"):
        scale_by_depth(part, chosen, tmp_path, executor, COUNT // 2)


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (places(wrong=5.0), "don't fit the walk"),
        (KnownDistance(1.0, "nowhere.png", ((1.0, 1.0), (9.0, 9.0))), "no frame 'nowhere.png'"),
        (KnownDistance(1.0, "003.png", ((1.0, 1.0), (900.0, 9.0))), "outside of a picture of 320 x 240"),
    ],
    ids=["places", "frame", "pixel"],
)
def test_a_scale_that_makes_no_sense_is_named(
    scale: Scale,
    message: str,
    part: Reconstruction,
    chosen: ChosenPictures,
    down: DownDirection | None,
    photos: tuple[Path, ...],
    executor: ThreadPoolExecutor,
) -> None:
    with pytest.raises(InvalidScanError, match=message):
        find_scale(scale, part, chosen, down, lambda row: gray_of(photos[row]), executor, NoProgress())


def test_a_marker_that_is_not_there_is_missed(
    part: Reconstruction, chosen: ChosenPictures, executor: ThreadPoolExecutor
) -> None:
    blank = np.full((240, 320), 128, np.uint8)
    with pytest.raises(InvalidScanError, match="No marker was seen"):
        find_scale(KnownMarker(0.1), part, chosen, None, lambda _: blank, executor, NoProgress())


def test_without_a_floor_a_height_gives_no_scale(
    part: Reconstruction, chosen: ChosenPictures, down: DownDirection | None, executor: ThreadPoolExecutor
) -> None:
    assert down is not None
    floor = find_floor(part, down.down)
    assert floor is not None
    off_floor = part.observations[~np.isin(part.observations[:, 2], floor.points)]
    walls = replace(part, observations=off_floor)
    with pytest.raises(InvalidScanError, match="floor can't be found"):
        find_scale(
            KnownHeight(HEIGHT_M),
            walls,
            chosen,
            down,
            lambda _: np.zeros((9, 9), np.uint8),
            executor,
            NoProgress(),
        )


def test_without_up_a_height_gives_no_scale(
    part: Reconstruction, chosen: ChosenPictures, executor: ThreadPoolExecutor
) -> None:
    with pytest.raises(InvalidScanError, match="which way is up"):
        find_scale(
            KnownHeight(1.4), part, chosen, None, lambda _: np.zeros((9, 9), np.uint8), executor, NoProgress()
        )


class Stopped:
    """Progress of a build that is cancelled while poses are estimated."""

    def report(self, stage: str, done: int, total: int) -> None:
        if stage == "reconstruct" and done > 3:
            raise CancelledBuildError("stop")


def test_a_cancelled_build_stops_the_reconstruction(chosen: ChosenPictures, matched: MatchedPictures) -> None:
    with pytest.raises(CancelledBuildError):
        reconstruct(matched, chosen.scan.camera, is_calibrated=False, scratch=None, progress=Stopped())


def test_photos_of_different_places_are_not_connected(
    photos: tuple[Path, ...], tmp_path: Path, executor: ThreadPoolExecutor
) -> None:
    apart = []
    for seed in range(9):
        path = tmp_path / f"{seed}.png"
        path.write_bytes(Room(seed=50 + seed).view(poses()[seed]).png())
        apart.append(path)
    with pytest.raises(InvalidScanError, match="overlap too little"):
        estimate_poses(
            UnposedScan(format="images", photos=tuple(apart)), None, models(), executor, NoProgress()
        )


def test_a_few_photos_are_too_few(photos: tuple[Path, ...], executor: ThreadPoolExecutor) -> None:
    few = UnposedScan(format="images", photos=photos[:4])
    with pytest.raises(InvalidScanError, match="a map needs 8"):
        estimate_poses(few, None, models(), executor, NoProgress())
