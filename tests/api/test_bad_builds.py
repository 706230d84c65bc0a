"""Scans that can't become a map: refused, or a failed build with one clear sentence; nothing else changes."""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from collections.abc import Callable

import numpy as np
import pytest

from app.importers.archives.archive_readers import MIB
from tests.scenes import CAMERA_TEXT, View, encode, scan_files, zipped
from tests.server import Server, assert_problem, assert_sentence

Files = dict[str, bytes]


def tarred(*members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for member, data in members:
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return buffer.getvalue()


def link(name: str, target: str, kind: bytes) -> bytes:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, target
    return tarred((tarfile.TarInfo("rgb.txt"), b"0 rgb/0.png\n"), (member, b""))


def zip_bomb() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("rgb.txt", "0 rgb/a.png\n")
        with archive.open(zipfile.ZipInfo("rgb/a.png"), "w", force_zip64=True) as file:
            for _ in range(100):
                file.write(bytes(MIB))
    return buffer.getvalue()


def tar_bomb() -> bytes:
    """Return 600 MB of zeros as a tar.gz: members of a gzip file may follow one another."""
    member = tarfile.TarInfo("rgb/a.png")
    member.size = 600 * MIB
    return gzip.compress(member.tobuf()) + gzip.compress(bytes(MIB)) * 600 + gzip.compress(bytes(1024))


def replaced(files: Files, name: str, old: str, new: str) -> Files:
    text = files[name].decode()
    assert old in text
    return {**files, name: text.replace(old, new).encode()}


def without_poses(files: Files) -> Files:
    return {name: data for name, data in files.items() if name != "groundtruth.txt"}


def with_nan_poses(files: Files) -> Files:
    rows = [f"{i / 10:.6f} nan nan nan 0 0 0 1" for i in range(4)]
    return {**files, "groundtruth.txt": "\n".join(rows).encode()}


def with_other_depth_size(files: Files) -> Files:
    depth = encode(np.full((120, 160), 5000, np.uint16), ".png")
    return {name: depth if name.startswith("depth/") else data for name, data in files.items()}


def with_8_bit_depth(files: Files) -> Files:
    depth = encode(np.full((240, 320), 200, np.uint8), ".png")
    return {name: depth if name.startswith("depth/") else data for name, data in files.items()}


def without_depth(files: Files) -> Files:
    depth = encode(np.zeros((240, 320), np.uint16), ".png")
    return {name: depth if name.startswith("depth/") else data for name, data in files.items()}


def all_black(files: Files) -> Files:
    black = encode(np.zeros((240, 320, 3), np.uint8), ".png")
    return {name: black if name.startswith("rgb/") else data for name, data in files.items()}


def with_broken_pictures(files: Files) -> Files:
    return {name: data[:3000] if name.startswith("rgb/") else data for name, data in files.items()}


def with_shuffled_poses(files: Files) -> Files:
    """Give every frame the pose of another one: no map of it can be right."""
    rows = files["groundtruth.txt"].decode().splitlines()[1:]
    times, poses = zip(*(row.split(" ", 1) for row in rows), strict=True)
    return {
        **files,
        "groundtruth.txt": "\n".join(f"{t} {p}" for t, p in zip(times, poses[::-1], strict=True)).encode(),
    }


BAD_SCANS: dict[str, Callable[[Files], bytes]] = {
    "not an archive": lambda _: b"PK nonsense" * 50,
    "text": lambda _: b"hello" * 1000,
    "an image": lambda files: files["rgb/0.000000.png"],
    "cut short": lambda files: zipped(files)[:20_000],
    "an empty zip": lambda _: zipped({}),
    "a path up": lambda files: zipped({**files, "../" * 12 + "tmp/roomfix_slip.txt": b"x"}),
    "a path up with backslashes": lambda files: zipped({**files, "..\\..\\slip.txt": b"x"}),
    "an absolute path": lambda files: zipped({**files, "/tmp/roomfix_slip.txt": b"x"}),
    "a symbolic link": lambda _: link("rgb", "/etc", tarfile.SYMTYPE),
    "a hard link": lambda _: link("depth.txt", "/etc/passwd", tarfile.LNKTYPE),
    "a device": lambda _: link("depth.txt", "", tarfile.CHRTYPE),
    "zeros in a zip": lambda _: zip_bomb(),
    "zeros in a tar": lambda _: tar_bomb(),
    "another archive inside": lambda files: zipped({"scan.zip": zipped(files)}),
    "no poses": lambda files: zipped(without_poses(files)),
    "empty poses": lambda files: zipped({**files, "groundtruth.txt": b"# nothing\n"}),
    "poses in words": lambda files: zipped({**files, "groundtruth.txt": b"0 a b c d e f g\n"}),
    "NaN poses": lambda files: zipped(with_nan_poses(files)),
    "list leads out": lambda files: zipped(replaced(files, "rgb.txt", "rgb/0.0", "../../rgb/0.0")),
    "no files listed": lambda files: zipped({**files, "rgb.txt": b""}),
    "times far apart": lambda files: zipped(replaced(files, "depth.txt", "\n0.", "\n9.")),
    "depth of another size": lambda files: zipped(with_other_depth_size(files)),
    "8-bit depth": lambda files: zipped(with_8_bit_depth(files)),
    "no depth anywhere": lambda files: zipped(without_depth(files)),
    "black pictures": lambda files: zipped(all_black(files)),
    "broken pictures": lambda files: zipped(with_broken_pictures(files)),
    "poses of other frames": lambda files: zipped(with_shuffled_poses(files)),
}


@pytest.fixture(scope="module")
def files(views: list[View]) -> Files:
    """The files of a short good scan."""
    return scan_files(views[:8])


@pytest.mark.parametrize("name", BAD_SCANS)
def test_a_scan_that_can_not_become_a_map_fails(museum: Server, files: Files, name: str) -> None:
    with museum.unchanged("builds"):
        answer = museum.submit(BAD_SCANS[name](files), "museum")
        if answer.status_code != 202:
            assert_problem(answer, 422)
            return
        build = museum.wait(answer.json()["build"])
        assert (build["state"], build["map_version"]) == ("failed", None)
        assert build["error_code"] in ("invalid_scan", "invalid_camera"), build["error"]
        assert_sentence(build["error"])


def test_a_camera_that_does_not_fit_the_scan_fails(museum: Server, files: Files) -> None:
    cameras = ["9000,9000,160,120", "262,262,1,1"]
    sized = {"model": "PINHOLE", "width": 640, "height": 480, "params": [525, 525, 320, 240]}
    for camera in (*cameras, sized):
        with museum.unchanged("builds"):
            build = museum.build(zipped(files), "museum", camera=camera)
            assert build["state"] == "failed"
            assert_sentence(build["error"])


def test_a_wrong_depth_scale_fails_the_check_of_the_map(museum: Server, files: Files) -> None:
    with museum.unchanged("builds"):
        build = museum.build(zipped(files), "museum", depth_scale=1000)
        assert (build["state"], build["error_code"]) == ("failed", "invalid_scan")


BAD_OPTIONS: dict[str, object] = {
    "no JSON": "{",
    "deep JSON": "[" * 50_000,
    "a list": [],
    "a text": '"tum"',
    "null": "null",
    "an unknown option": {"colour": True},
    "unknown format": {"format": "rosbag"},
    "format of a wrong type": {"format": ["tum"]},
    "unknown features": {"features": "surfest"},
    "features of a wrong type": {"features": {"sift": 1}},
    "unknown mode": {"mode": "merge"},
    "zero depth scale": {"depth_scale": 0},
    "negative depth scale": {"depth_scale": -5000},
    "depth scale in words": {"depth_scale": "5000"},
    "depth scale true": {"depth_scale": True},
    "NaN depth scale": '{"depth_scale": NaN}',
    "endless depth scale": f'{{"depth_scale": 1{"0" * 400}}}',
    "keyframes in words": {"keyframes": "pose"},
    "unknown rule": {"keyframes": {"rule": "random"}},
    "unknown key of a rule": {"keyframes": {"rule": "pose", "metres": 1}},
    "NaN in a rule": '{"keyframes": {"rule": "pose", "metres": NaN}}',
    "negative threshold": {"keyframes": {"rule": "pose", "position_m": -1}},
    "every zeroth": {"keyframes": {"rule": "interval", "every": 0}},
    "every half": {"keyframes": {"rule": "interval", "every": 0.5}},
    "gravity in words": {"gravity": "down"},
    "gravity of two": {"gravity": [0, 1]},
    "gravity of none": {"gravity": [0, 0, 0]},
    "endless gravity": f'{{"gravity": [1{"0" * 400}, 0, 0]}}',
    "NaN gravity": '{"gravity": [NaN, 0, 1]}',
    "nested gravity": {"gravity": [[0], [0], [1]]},
    "camera of three": {"camera": [1, 2, 3]},
    "NaN camera": '{"camera": [NaN, 262, 159, 119]}',
    "zero camera": {"camera": "0,0,0,0"},
    "camera true": {"camera": True},
    "camera of unknown model": {"camera": {"model": {}, "width": 1, "height": 1, "params": []}},
    "mirrored world": {"world_from_scan": np.diag([1, 1, -1, 1]).tolist()},
    "scaled world": {"world_from_scan": np.diag([2, 2, 2, 1]).tolist()},
    "world of nine": {"world_from_scan": np.eye(3).tolist()},
    "world in words": {"world_from_scan": "here"},
    "endless world": f'{{"world_from_scan": [[1{"0" * 400}, 0, 0, 0]]}}',
    "NaN world": f'{{"world_from_scan": {[[float("nan")] * 4] * 4}}}'.replace("nan", "NaN"),
    "refine in words": {"refine_depth": "yes"},
    "negative time": {"max_time_difference_s": -1},
    "color_from_depth alone": {"color_from_depth": np.eye(4).tolist()},
}


@pytest.mark.parametrize("name", BAD_OPTIONS)
def test_options_that_can_not_be_meant_are_refused(museum: Server, name: str) -> None:
    with museum.unchanged():
        answer = museum.submit(b"PK", "museum", BAD_OPTIONS[name])
        assert_problem(answer, 422)


def test_an_upload_without_what_it_needs_is_refused(museum: Server, files: Files) -> None:
    good = {"camera": CAMERA_TEXT}
    with museum.unchanged():
        assert_problem(museum.submit(zipped(files), "nowhere", good), 404, "not_found")
        assert_problem(museum.submit(b"", "museum", good), 422, "invalid_scan")
        no_venue = museum.client.post("/database/build", files={"archive": b"x"})
        assert "venue" in assert_problem(no_venue, 422, "invalid_request")
        no_archive = museum.client.post("/database/build", data={"venue": "museum"})
        assert "archive" in assert_problem(no_archive, 422, "invalid_request")
