"""What can't be read is named: models, half a scan, other archives, and how to export each rightly."""

from __future__ import annotations

import bz2
import gzip
import struct
import zipfile
from pathlib import Path

import pytest

from app.commands.build import zip_folder
from app.errors import InvalidScanError
from app.importers.recognition import PARTS
from app.importers.registry import find_scan, open_scan
from app.importers.unpack_scan import unpack_scan
from app.importers.unread.exports import EXPORTS
from app.importers.unread.incomplete import SIGNS
from tests.importers.scans import write_color, write_tum


def packed(path: Path, *names: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, b"x" * 50)
    return path


def said_of(sent: Path, unpacked: Path) -> str:
    with pytest.raises(InvalidScanError) as error:
        open_scan(unpack_scan(sent, unpacked))
    said = str(error.value)
    assert len(said) < 500
    assert said.endswith(".")
    return said


MODELS = {
    "a USDZ": (("room.usdc", "0/texture.png"), ("scan/room.usdz",)),
    "a glTF file": (("room.glb",),),
    "an OBJ file": (("model/textured.obj", "model/textured.mtl", "model/textured_0.jpg"),),
    "a PLY file": (("SiteScape/scan.ply",),),
    "an E57 file": (("office.e57", "notes.txt"),),
    "a file of points": (("matterpak/cloud.xyz", "matterpak/plan.pdf"),),
    "a file of splats": (("room.spz",),),
}


@pytest.mark.parametrize(
    ("called", "names"), [(called, names) for called, all_names in MODELS.items() for names in all_names]
)
def test_a_model_is_named_with_what_to_export_instead(
    tmp_path: Path, called: str, names: tuple[str, ...]
) -> None:
    said = said_of(packed(tmp_path / "a.zip", *names), tmp_path / "unpacked")
    assert said.startswith(f"This is {called}, ")
    assert all(word in said for word in ("without the pictures", "Polycam", "Raw data", ".r3d", "All Data"))


def test_textures_of_a_model_are_no_photos_unless_somebody_says_so(tmp_path: Path) -> None:
    names = ["room/m.obj", *(f"room/texture_{i}.jpg" for i in range(4))]
    assert 'give "format": "images"' in said_of(packed(tmp_path / "a.zip", *names), tmp_path / "unpacked")
    with pytest.raises(InvalidScanError, match="These are 4 photos"):
        open_scan(tmp_path / "unpacked/room", "images")


def test_a_scan_beside_its_model_is_read_and_the_model_left_out(tmp_path: Path) -> None:
    write_tum(tmp_path / "scan")
    (tmp_path / "scan/mesh.ply").write_bytes(b"ply\n" + bytes(10_000))
    (tmp_path / "scan/.hidden.ply").write_bytes(b"ply\n")
    root = unpack_scan(zip_folder(tmp_path / "scan", tmp_path / "scan.zip"), tmp_path / "unpacked")
    assert find_scan(root) == (root, "tum")
    assert (root / "mesh.ply").stat().st_size == 0
    assert not (root / ".hidden.ply").exists()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"glTF" + bytes(900), "This is a glTF file"),
        (b"ply\nformat binary_little_endian 1.0\n" + bytes(900), "This is a PLY file"),
        (b"ASTM-E57" + bytes(900), "This is an E57 file"),
        (b"LASF" + bytes(900), "This is a LAS file"),
        (b"# made by an app\nmtllib a.mtl\nv 0 0 1\n" + b"v 1 2 3\n" * 100, "This is an OBJ file"),
        (b"7z\xbc\xaf\x27\x1c" + bytes(900), "a 7z archive.*send a zip"),
        (b"Rar!\x1a\x07\x01\x00" + bytes(900), "a RAR archive.*send a zip"),
        (b"\x28\xb5\x2f\xfd" + bytes(900), "compressed by zstd"),
        (b"PK\x07\x08PK\x03\x04" + bytes(900), "split: join the parts"),
        # Without the present time, by which processes that collect tests would differ.
        (gzip.compress(b"#ROSBAG V2.0\n" + bytes(9000), mtime=0), "holds no tar archive.*unpack it"),
        (bz2.compress(b"7 numbers" * 2000), "holds no tar archive.*unpack it"),
        (b"\x89PNG\r\n\x1a\n" + bytes(900), "a single picture: send three or more photos"),
        (b"\xff\xd8\xff\xe0" + bytes(900), "a single picture"),
        (b"v" * 900, "not an archive, nor a recording"),
        (b"once upon a time\n" * 90, "not an archive, nor a recording"),
    ],
)
def test_a_file_by_itself_is_named(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "scan").write_bytes(data)
    with pytest.raises(InvalidScanError, match=said):
        unpack_scan(tmp_path / "scan", tmp_path / "unpacked")


def test_the_last_part_of_a_split_zip(tmp_path: Path) -> None:
    path = packed(tmp_path / "a.zip", "rgb.txt")
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x05\x06")
    data[at + 4 : at + 8] = struct.pack("<2H", 2, 1)
    path.write_bytes(data)
    with pytest.raises(InvalidScanError, match="split: join the parts"):
        unpack_scan(path, tmp_path / "unpacked")
    # A comment at its end doesn't hide a whole zip's own record.
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("rgb.txt", b"x")
        archive.comment = b"walk of the ground floor"
    unpack_scan(tmp_path / "b.zip", tmp_path / "whole")


@pytest.mark.parametrize("inner", ["seq-01.zip", "scan/part.7z", "scan.tar.zstd", "scan.zip.001"])
def test_archives_in_an_archive_are_named(tmp_path: Path, inner: str) -> None:
    said = said_of(packed(tmp_path / "a.zip", inner, "readme.txt"), tmp_path / "unpacked")
    assert f"holds other archives, such as {inner.rpartition('/')[2]}: unpack those first" in said


INCOMPLETE = {
    "a recording of Stray Scanner, and odometry.csv": ("a/rgb.mp4", "a/camera_matrix.csv", "a/depth/000000.png"),
    "a raw export of Polycam, and keyframes/cameras": ("keyframes/images/1.jpg", "keyframes/depth/1.png"),
    "an export of 3D Scanner App, and frame_00000.json": ("frame_00000.jpg", "depth_00000.png", "info.json"),
    "a recording of Record3D, and metadata": ("EXR_RGBD/rgb/0.jpg", "EXR_RGBD/depth/0.exr"),
    "a recording of ARKitScenes, and lowres_wide": (
        "41/lowres_depth/41_1.000.png", "41/lowres_wide.traj", "41/lowres_wide_intrinsics/41_1.000.pincam",
    ),
    "a scan of ScanNet, and pose": ("color/0.jpg", "depth/0.png", "intrinsic/intrinsic_color.txt"),
    "an export of RTAB-Map, and poses.txt": ("map_rgb/1.jpg", "map_depth/1.png", "map_calib/1.yaml"),
    "a data set of kapture, and sensors/records_camera.txt": ("sensors/sensors.txt", "sensors/trajectories.txt"),
    "a COLMAP model, and images.txt or images.bin": ("sparse/0/cameras.bin", "sparse/0/points3D.bin", "images/1.jpg"),
    "a scan of 7-Scenes, and frame-000000.color.png": ("frame-000000.depth.png", "frame-000000.pose.txt"),
    "a scan in TUM layout, and rgb.txt": ("groundtruth.txt", "depth.txt", "rgb/1.png", "depth/1.png"),
    "a scan of Open3D or Redwood, and trajectory.log": ("color/1.jpg", "depth/1.png", "intrinsic.json"),
}  # fmt: skip


@pytest.mark.parametrize("said", INCOMPLETE)
def test_half_a_scan_says_what_it_lacks(tmp_path: Path, said: str) -> None:
    found = said_of(packed(tmp_path / "a.zip", *INCOMPLETE[said]), tmp_path / "unpacked")
    assert found.startswith(f"This looks like {said}")
    assert "missing: " in found


def test_each_sign_is_of_a_format_with_parts_and_a_remedy() -> None:
    assert set(SIGNS) <= set(PARTS) & set(EXPORTS)


def test_little_of_a_scan_is_called_none(tmp_path: Path) -> None:
    said = said_of(
        packed(tmp_path / "a.zip", "depth_001.png", "rgb_001.png", "poses.json"), tmp_path / "unpacked"
    )
    assert said.startswith("The format of the scan can't be told from its files")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("odometry.csv", "camera_matrix.csv"), "Stray Scanner.*rgb.mp4 is missing.*whole folder"),
        (
            ("keyframes/cameras/a.txt",),
            "Polycam.*keyframes/cameras with its .json files is missing.*Raw data",
        ),
        (("lowres_wide/1_1.0.png", "lowres_depth/1_1.0.png"), "ARKitScenes.*lowres_wide.traj is missing"),
    ],
)
def test_a_scan_that_is_known_says_how_to_export_what_it_lacks(
    tmp_path: Path, names: tuple[str, ...], said: str
) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("timestamp, frame, x, y, z, qx, qy, qz, qw\n0, 0, 0, 0, 0, 0, 0, 0, 1\n")
    with pytest.raises(InvalidScanError, match=said):
        open_scan(tmp_path)


def test_photos_beside_an_archive_of_them_are_still_photos(tmp_path: Path) -> None:
    for name in ("0.jpg", "1.jpg", "2.jpg"):
        write_color(tmp_path / name)
    (tmp_path / "photos.zip").write_bytes(b"")
    with pytest.raises(InvalidScanError, match="These are 3 photos"):
        open_scan(tmp_path)


def test_a_project_of_colmap_without_its_model(tmp_path: Path) -> None:
    names = ("database.db", "images/a.jpg", "project.ini")
    said = said_of(packed(tmp_path / "a.zip", *names), tmp_path / "unpacked")
    assert said.startswith("This is a project of COLMAP without its model: send cameras and images")


def test_photos_without_a_model_are_still_photos(tmp_path: Path) -> None:
    for i in range(3):
        write_color(tmp_path / f"{i}.jpg")
    with pytest.raises(InvalidScanError, match="These are 3 photos"):
        open_scan(tmp_path)
