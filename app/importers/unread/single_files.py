"""Files that hold no scan, by suffixes and by first bytes: models, point clouds, archives of other kinds."""

from __future__ import annotations

from app.errors import InvalidScanError

_MODEL = "a model without the pictures that it was made from"
_POINTS = "a point cloud without the pictures that it was made from"
_SPLATS = "a model of Gaussian splats without the pictures that it was made from"
# Suffix -> what a file is called, and what it is.
MODELS: dict[str, tuple[str, str]] = {
    **dict.fromkeys((".usdz", ".usdc", ".usda", ".usd"), ("a USDZ", _MODEL)),
    **dict.fromkeys((".glb", ".gltf"), ("a glTF file", _MODEL)),
    ".obj": ("an OBJ file", _MODEL),
    ".fbx": ("an FBX file", _MODEL),
    ".dae": ("a Collada file", _MODEL),
    ".stl": ("an STL file", _MODEL),
    ".ply": ("a PLY file", "a mesh or points without the pictures that it was made from"),
    ".e57": ("an E57 file", _POINTS),
    **dict.fromkeys((".las", ".laz"), ("a LAS file", _POINTS)),
    **dict.fromkeys((".pts", ".ptx", ".pcd", ".xyz"), ("a file of points", _POINTS)),
    **dict.fromkeys((".splat", ".ksplat", ".spz"), ("a file of splats", _SPLATS)),
}
# Recordings of depth cameras in formats of their makers.
MAKERS_SUFFIXES = frozenset({".klg", ".oni", ".svo", ".svo2"})
ARCHIVE_SUFFIXES = frozenset(
    {".zip", ".tar", ".tgz", ".gz", ".xz", ".bz2", ".7z", ".rar", ".zst", ".zstd", ".001", ".z01"}
)
# What is kept of these in an unpacked scan is the name, so that what they are can be said.
UNREAD_SUFFIXES = MAKERS_SUFFIXES | ARCHIVE_SUFFIXES | frozenset(MODELS)

RAW_DATA = (
    "so that no photo can be found in it. Let the app that scanned export its raw data (pictures, depth, poses): "
    'Polycam "Raw data" (developer mode), Record3D ".r3d", 3D Scanner App "All Data", Stray Scanner the recording\'s '
    "folder, RTAB-Map its .db"
)
_PACK = "unpack it, and send a zip, tar, tar.gz, tar.xz or tar.bz2 file of the scan's folder"
SPLIT = "a part of an archive that was split: join the parts and send one zip, or upload the zip unsplit"

# First bytes -> the suffix of a model, or what an archive is.
_MAGIC_OF_MODELS = (
    (b"glTF", ".glb"),
    (b"ply\n", ".ply"),
    (b"ply\r\n", ".ply"),
    (b"ASTM-E57", ".e57"),
    (b"LASF", ".las"),
    (b"PXR-USDC", ".usdc"),
    (b"#usda", ".usda"),
    (b"Kaydara FBX", ".fbx"),
    (b"solid ", ".stl"),
    (b"# .PCD", ".pcd"),
)
_MAGIC_OF_ARCHIVES = (
    (b"7z\xbc\xaf\x27\x1c", f"a 7z archive, which is not read: {_PACK}"),
    (b"Rar!\x1a\x07", f"a RAR archive, which is not read: {_PACK}"),
    (b"\x28\xb5\x2f\xfd", f"compressed by zstd, which is not read: {_PACK}"),
    (b"PK\x07\x08", SPLIT),
)
# An OBJ file has no first bytes of its own: its lines begin with these words.
_OBJ_WORDS = (b"#", b"mtllib", b"o", b"g", b"v", b"vn", b"vt", b"usemtl", b"s", b"f")
_PICTURES = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")


def describe_model(suffix: str) -> str:
    """Return a sentence on a file of `MODELS`, without its end."""
    called, what = MODELS[suffix]
    return f"This is {called}, {what}, {RAW_DATA}"


def refuse_single_file(head: bytes) -> None:
    """Raise `InvalidScanError` that names a file by its first bytes, if it is known to hold no scan."""
    for magic, kind in _MAGIC_OF_ARCHIVES:
        if head.startswith(magic):
            raise InvalidScanError(f"The upload is {kind}.")
    suffix = next((suffix for magic, suffix in _MAGIC_OF_MODELS if head.startswith(magic)), None)
    if suffix is None and _is_obj(head):
        suffix = ".obj"
    if suffix is not None:
        raise InvalidScanError(f"{describe_model(suffix)}.")
    if head.startswith(_PICTURES):
        raise InvalidScanError(
            "The upload is a single picture: send three or more photos, or a scan's folder, in one zip."
        )


def _is_obj(head: bytes) -> bool:
    words = [line.split(maxsplit=1)[0] for line in head.splitlines()[:-1] if line.strip()]
    return b"v" in words and all(word in _OBJ_WORDS for word in words)
