"""What a build publishes: where its scan lies in the world, what its report says, and which pictures it keeps."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.engine.mapping.options import BuildOptions
from app.engine.mapping.register_scan import UnregisteredScanError
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.services.builds.place_scan import replacement_warnings
from app.services.builds.run_build import run_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.settings import Settings
from app.storage.builds import claim_build, get_build
from app.storage.floors import put_floor
from app.storage.maps import MapVersion, get_map, list_keyframe_images, list_maps
from app.storage.venues import create_venue
from tests.scenes import CAMERA_TEXT, Room, View, pose_at, scan_files, zipped

# Without what these tests are not about.
QUICK = {"camera": CAMERA_TEXT, "refine_depth": False, "second_features": False}
POSES = [pose_at(1.6 + 0.2 * i, 1.4 + 0.02 * i, 1.4, -24.0 + 8.0 * i) for i in range(5)]
IDENTITY = np.eye(4).tolist()
# Another frame: beside the scan's, and turned about the vertical.
TURNED = Pose(pose_at(0, 0, 0, 40).rotation @ pose_at(0, 0, 0, 0).rotation.T, np.array([3.0, -2.0, 0.5]))


@dataclass
class Venue:
    """A venue whose builds run in this process."""

    resources: Resources

    def build(self, views: list[View], scan_from_world: Pose | None = None, **options: object) -> MapVersion:
        """Build a map of views, their poses in the frame that `scan_from_world` leads to, and return it."""
        archive = io.BytesIO(zipped(scan_files(views, scan_from_world)))
        submit_build(self.resources, "v", {**QUICK, **options}, archive)
        with self.resources.database.write() as connection:
            claimed = claim_build(connection)
        assert claimed is not None
        version = run_build(claimed, self.resources, MapLibrary(self.resources), NoProgress())
        with self.resources.database.read() as connection:
            published = get_map(connection, "v", version)
            build = get_build(connection, claimed.id)
        assert (build.state, build.map_version, build.report) == ("succeeded", version, published.statistics)
        assert published.build_id == build.id
        return published

    def place_floor(self, floor_id: str) -> None:
        """Add a floor whose plan has its axes in the world's."""
        with self.resources.database.write() as connection:
            put_floor(
                connection,
                "v",
                floor_id,
                name="",
                level=0,
                z_min_m=0.0,
                z_max_m=3.0,
                plan_from_world=np.eye(4),
                plan_residual_m=None,
            )

    def versions(self) -> int:
        """Return how many versions there are."""
        with self.resources.database.read() as connection:
            return len(list_maps(connection, "v"))

    def pictures(self, version: int) -> int:
        """Return how many keyframes of a version have their pictures."""
        with self.resources.database.read() as connection:
            return len(list_keyframe_images(connection, "v", version))


def opened(data_dir: Path) -> Resources:
    return Resources.open(Settings(_env_file=None, data_dir=data_dir, open=True))


@pytest.fixture
def venue(tmp_path: Path) -> Iterator[Venue]:
    """A venue without maps."""
    resources = opened(tmp_path)
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    yield Venue(resources)
    resources.close()


@pytest.fixture(scope="module")
def hall(room: Room) -> list[View]:
    """A scan of the room, just long enough to be registered."""
    return [room.view(pose) for pose in POSES]


@pytest.fixture(scope="module")
def built(hall: list[View], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data of a server with a map of the hall, of which nothing was said."""
    folder = tmp_path_factory.mktemp("built")
    resources = opened(folder)
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    Venue(resources).build(hall, store_images=False)
    resources.close()
    return folder


@pytest.fixture
def mapped(built: Path, tmp_path: Path) -> Iterator[Venue]:
    """A venue with that map, as its own."""
    shutil.copytree(built, tmp_path, dirs_exist_ok=True)
    resources = opened(tmp_path)
    yield Venue(resources)
    resources.close()


def placed(version: MapVersion) -> tuple[str, bool]:
    """Return where the placement comes from, and whether up is known by it."""
    placement = version.statistics["placement"]
    return placement["source"], placement["z_up"]


def off_m(version: MapVersion, world_from_scan: Pose) -> float:
    """Return how far a version's scan is from where it should be."""
    found = np.array(version.statistics["world_from_scan"])
    return float(np.abs(found - world_from_scan.matrix).max())


def test_without_a_word_the_first_scans_frame_is_the_world(mapped: Venue) -> None:
    with mapped.resources.database.read() as connection:
        first = get_map(connection, "v", 1)
    assert placed(first) == ("scan_frame", False)
    assert off_m(first, Pose.identity()) == 0.0
    assert mapped.pictures(1) == 0


def test_gravity_or_a_given_placement_says_which_way_is_up(venue: Venue, hall: list[View]) -> None:
    found = venue.build(hall[:4], gravity=[0, 0, -1], store_images=False)
    assert placed(found) == ("gravity", True)
    # A placement that is given is taken, whatever else is known.
    given = venue.build(hall, world_from_scan=TURNED.matrix.tolist(), store_images=False)
    assert placed(given) == ("given", True)
    assert off_m(given, TURNED) < 1e-9
    # Where up is known in the map that serves, it is for all that is registered to it.
    assert placed(venue.build(hall, store_images=False)) == ("registered", True)


@pytest.mark.parametrize(
    ("scan_from_world", "gravity", "z_up"),
    [(None, None, False), (None, [0, 0, -1], True), (TURNED, [0, 0, -1], True)],
    ids=["nothing said", "gravity in the same frame", "gravity in another frame"],
)
def test_a_scan_of_the_same_place_is_registered_to_the_map_that_serves(
    mapped: Venue, hall: list[View], scan_from_world: Pose | None, gravity: list[float] | None, z_up: bool
) -> None:
    said = {} if gravity is None else {"gravity": gravity}
    found = mapped.build(hall, scan_from_world, store_images=False, **said)
    assert placed(found) == ("registered", z_up)
    figures = found.statistics["placement"]
    assert (figures["tried"], figures["located"], figures["agreeing"]) == (5, 5, 5)
    if scan_from_world is None:
        # In the same frame the scan's own poses are better than any registration.
        assert off_m(found, Pose.identity()) == 0.0
    else:
        assert 0.0 < off_m(found, scan_from_world.inverse()) < 0.02


def test_gravity_that_shows_a_leaning_world_makes_an_upright_one(mapped: Venue, hall: list[View]) -> None:
    found = mapped.build(hall, gravity=[0, -1, 0], store_images=False)
    assert placed(found) == ("gravity", True)
    assert any("does not point up" in warning for warning in found.statistics["warnings"])


@pytest.mark.parametrize(
    ("located", "floors", "refused"),
    [
        (30, (), "contradicts the present map.*the map locates 30.*map is what is wrong"),
        (30, ("ground",), "contradicts the present map.*plan of floor ground was placed"),
        (
            9,
            ("ground", "upper"),
            "another place.*locates 9,.*plan of floors ground, upper was placed.*world_from_scan",
        ),
        (0, ("a", "b", "c", "d", "e"), "floors a, b, c and 2 more was placed"),
        (9, (), None),
        (0, (), None),
    ],
)
def test_a_scan_that_was_not_found_in_the_map_replaces_it_by_force_where_that_does_harm(
    located: int, floors: tuple[str, ...], refused: str | None
) -> None:
    error = UnregisteredScanError(40, located, 4)
    if refused is None:
        (warning,) = replacement_warnings(error, BuildOptions(), floors)
        assert "seems to show another place" in warning
    else:
        with pytest.raises(InvalidScanError, match=f'(?s){refused}.*"force": true'):
            replacement_warnings(error, BuildOptions(), floors)
    (warning,) = replacement_warnings(error, BuildOptions(force=True), floors)
    assert "as force says" in warning
    assert ("Place the floors anew" in warning) == bool(floors)


ASIDE = Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))


def test_a_given_placement_is_held_against_the_present_map(mapped: Venue, hall: list[View]) -> None:
    aside = ASIDE.matrix.tolist()
    with pytest.raises(
        InvalidScanError, match=r"1\.00 m and 0\.0 degrees from where the present map finds it"
    ):
        mapped.build(hall, mode="extend", world_from_scan=aside, store_images=False)
    mapped.place_floor("ground")
    with pytest.raises(InvalidScanError, match="plan of floor ground was placed"):
        mapped.build(hall, world_from_scan=aside, store_images=False)
    assert mapped.versions() == 1
    forced = mapped.build(hall, world_from_scan=aside, force=True, store_images=False)
    assert placed(forced) == ("given", True)
    assert off_m(forced, ASIDE) < 1e-9
    assert any("1.00 m" in warning for warning in forced.statistics["warnings"])


RAISED = Pose(np.eye(3), np.array([0.0, 0.0, 0.1]))
SKEWED = pose_at(0.0, 0.0, 0.0, 2.0) @ pose_at(0.0, 0.0, 0.0).inverse()


@pytest.mark.parametrize("beside", [RAISED, SKEWED], ids=["0.1 m higher", "turned by 2 degrees"])
def test_a_frame_that_is_a_little_off_is_another_one(mapped: Venue, hall: list[View], beside: Pose) -> None:
    found = mapped.build(hall, beside, store_images=False)
    assert placed(found) == ("registered", False)
    assert off_m(found, beside.inverse()) < 0.02
    assert off_m(found, Pose.identity()) > 0.02


def test_a_scan_of_another_place_replaces_the_map_but_does_not_extend_it(
    mapped: Venue, foreign_room: Room
) -> None:
    other = [foreign_room.view(pose) for pose in POSES[:4]]
    with pytest.raises(InvalidScanError, match="can't be placed"):
        mapped.build(other, mode="extend", store_images=False)
    assert mapped.versions() == 1
    found = mapped.build(other, gravity=[0, 0, -1], store_images=False)
    assert placed(found) == ("gravity", True)
    assert any("another place" in warning for warning in found.statistics["warnings"])


def test_floors_are_not_left_in_the_world_of_another_scan(mapped: Venue, foreign_room: Room) -> None:
    other = [foreign_room.view(pose) for pose in POSES[:4]]
    mapped.place_floor("ground")
    with pytest.raises(InvalidScanError, match="floor ground was placed"):
        mapped.build(other, store_images=False)
    assert mapped.versions() == 1
    given = mapped.build(other, world_from_scan=IDENTITY, store_images=False)
    assert placed(given) == ("given", True)


def test_a_map_grows_by_a_scan_and_keeps_the_pictures_of_all_keyframes(
    venue: Venue, hall: list[View]
) -> None:
    first = venue.build(hall[:4], world_from_scan=IDENTITY)
    second = venue.build(hall[2:], world_from_scan=IDENTITY, mode="extend")
    keyframes = first.statistics["keyframes"] + second.statistics["keyframes"]
    assert second.statistics["map_keyframes"] == venue.pictures(2) == keyframes
    # The version before stays what it was.
    assert venue.pictures(1) == first.statistics["map_keyframes"] == first.statistics["keyframes"]


def test_the_report_says_what_was_built_and_what_was_left_out(venue: Venue, hall: list[View]) -> None:
    dark = [View(view.world_from_camera, view.rgb // 60, view.depth_m) for view in hall[4:]]
    version = venue.build([*hall[:4], *dark], world_from_scan=IDENTITY, store_images=False)
    report: dict[str, Any] = version.statistics
    assert (report["frames"], report["keyframes"], report["map_keyframes"]) == (5, 4, 4)
    assert sum(report["discarded"].values()) == 1
    assert {reason: len(names) for reason, names in report["discarded_frames"].items()} == report["discarded"]
    assert report["feature_method"] == "sift"
    assert report["features"] > 1000
    paths = [
        venue.resources.blobs.local_path(digest) for digest in (version.artifact_blob, version.index_blob)
    ]
    assert list(report["bytes"].values()) == [path.stat().st_size for path in paths]
    assert {"unpack", "place", "verify", "store"} < set(report["seconds"])
    assert all(seconds >= 0.0 for seconds in report["seconds"].values())
    # The dark frame is tried, too.
    assert (report["self_check"]["located"], report["self_check"]["tried"]) == (4, 5)
    assert report["self_check"]["median_position_m"] < 0.02
    assert "calibration" not in report
    assert not list(venue.resources.scratch_dir.iterdir())


def test_what_a_killed_worker_left_is_no_hindrance(venue: Venue, hall: list[View]) -> None:
    archive = io.BytesIO(zipped(scan_files(hall[:4])))
    submit_build(venue.resources, "v", {"camera": CAMERA_TEXT, "store_images": False}, archive)
    with venue.resources.database.write() as connection:
        claimed = claim_build(connection)
    assert claimed is not None
    left = venue.resources.scratch_dir / claimed.id / "scan" / "rgb"
    left.mkdir(parents=True)
    (left / "0.000000.png").write_bytes(b"half a picture")
    assert run_build(claimed, venue.resources, MapLibrary(venue.resources), NoProgress()) == 1
    with venue.resources.database.read() as connection:
        assert get_map(connection, "v", 1).statistics["frames"] == 4
