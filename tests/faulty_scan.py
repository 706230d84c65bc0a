"""A scan some of whose frames a build leaves out: blurred ones, and ones without depth."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tests import scenes

# Rows of keyframes that are blurred, and of frames that the list of depth files lacks.
BLURRED, WITHOUT_DEPTH = (4, 9), (2, 3, 5, 6, 7, 8, 11, 12)


def faulty_scan(
    views: Sequence[scenes.View],
    blurred: Sequence[int] = BLURRED,
    without_depth: Sequence[int] = WITHOUT_DEPTH,
) -> dict[str, bytes]:
    """Return the files of a scan in TUM layout with such frames."""
    files = scenes.scan_files(views)
    for row in blurred:
        soft = cv2.GaussianBlur(views[row].rgb, (0, 0), 12)
        files[f"rgb/{row / 10:.6f}.png"] = scenes.encode(soft[..., ::-1].astype(np.uint8), ".png")
    gone = {f"{row / 10:.6f}" for row in without_depth}
    lines = files["depth.txt"].decode().splitlines()
    files["depth.txt"] = "\n".join(line for line in lines if line.split()[0] not in gone).encode()
    return files
