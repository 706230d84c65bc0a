"""All writers, by what is written."""

from __future__ import annotations

from bench.formats import layouts, phones, recordings
from bench.formats.frames import WITHOUT_DEPTH, Writer, without_depth

WRITERS: dict[str, Writer] = {
    "TUM": layouts.tum,
    "TUM, ORB-SLAM trajectories": layouts.orb_slam,
    "ICL-NUIM": layouts.icl_nuim,
    "7-Scenes": layouts.seven_scenes,
    "12-Scenes": layouts.twelve_scenes,
    "ScanNet, extracted": layouts.scannet,
    "ScanNet .sens": recordings.sens,
    "Open3D, Redwood": layouts.redwood,
    "nerfstudio": layouts.nerfstudio,
    "kapture": layouts.kapture,
    "COLMAP text": layouts.colmap_text,
    "COLMAP binary": layouts.colmap_binary,
    "RTAB-Map .db": recordings.rtabmap,
    "RTAB-Map export": layouts.rtabmap_export,
    "ROS 1 .bag": recordings.ros1,
    "ROS 2 .db3": recordings.ros2_sqlite,
    "ROS 2 .mcap": recordings.ros2_mcap,
    "Polycam raw": phones.polycam,
    "Stray Scanner": phones.stray_scanner,
    "Record3D, LZFSE": phones.record3d_lzfse,
    "Record3D, plain": phones.record3d_plain,
    "3D Scanner App": phones.scanner_app,
    "ARKitScenes": phones.arkit_scenes,
    f"TUM{WITHOUT_DEPTH}": without_depth(layouts.tum, "depth", "depth.txt"),
    f"COLMAP binary{WITHOUT_DEPTH}": without_depth(layouts.colmap_binary, "depth"),
    f"Stray Scanner{WITHOUT_DEPTH}": without_depth(phones.stray_scanner, "depth", "confidence"),
    f"kapture{WITHOUT_DEPTH}": without_depth(
        layouts.kapture, "sensors/records_data/tof", "sensors/records_depth.txt"
    ),
}
