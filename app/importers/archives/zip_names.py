"""Names of a zip's entries, whatever packer wrote them."""

from __future__ import annotations

import struct
import zipfile
import zlib

# Zip: the flag of a name in UTF-8, and Info-ZIP's extra field with the name in UTF-8.
_UTF8_FLAG = 0x800
_UNICODE_PATH_FIELD = 0x7075


def zip_name(info: zipfile.ZipInfo) -> str:
    """Return an entry's name: by its flag, else by Info-ZIP's field, else as UTF-8 where its bytes are that.

    Packers of macOS and Java write UTF-8 without the flag. Other bytes stay in code page 437, as the format says;
    `ScanFolder` compares them with the names of lists in other code pages.
    """
    if info.flag_bits & _UTF8_FLAG:
        return info.orig_filename
    raw = info.orig_filename.encode("cp437", errors="replace")
    unicode_path = _unicode_path(info.extra, raw)
    try:
        return (unicode_path or raw).decode("utf-8")
    except UnicodeDecodeError:
        return info.orig_filename


def _unicode_path(extra: bytes, raw_name: bytes) -> bytes | None:
    """Return the name of Info-ZIP's Unicode Path field, None without one or when it is for another name."""
    while len(extra) >= 4:
        kind, size = struct.unpack("<HH", extra[:4])
        content, extra = extra[4 : 4 + size], extra[4 + size :]
        if kind == _UNICODE_PATH_FIELD and len(content) > 5:
            version, checksum = struct.unpack("<BI", content[:5])
            return content[5:] if version == 1 and checksum == zlib.crc32(raw_name) else None
    return None
