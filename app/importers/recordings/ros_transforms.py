"""Transforms between the frames of a robot in a ROS recording, and the trajectory of its camera by them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.association import Trajectory
from app.importers.frames import ScanOptions

_MAX_CHAIN = 30
# A transform on /tf that was sent so often and stayed the same is one that never changes.
_MIN_REPEATS = 2


@dataclass(slots=True)
class Transforms:
    """Poses `parent_from_child` by the child's frame: those that never change, and rows over time."""

    fixed: dict[str, tuple[str, Pose]] = field(default_factory=dict)
    moving: dict[str, tuple[str, list[list[float]]]] = field(default_factory=dict)

    def add(self, message: Any, topic: str, stamp_ns: int) -> None:
        """Add the transforms of a message on /tf or /tf_static."""
        for stamped in message.transforms:
            parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
            t, q = stamped.transform.translation, stamped.transform.rotation
            pose = Pose.from_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
            if topic.endswith("static"):
                self.fixed[child] = parent, pose
                continue
            stamp = stamped.header.stamp
            time_s = float(stamp.sec) + 1e-9 * float(stamp.nanosec) or 1e-9 * stamp_ns
            rows = self.moving.setdefault(child, (parent, []))[1]
            rows.append([time_s, *pose.translation, *pose.quaternion])

    def place(self, reference: str, frame: str) -> Pose | None:
        """Return `reference_from_frame` by transforms that never change, None where they don't join the two."""
        joined, ways = self._way_up(reference), self._way_up(frame)
        for ancestor, ancestor_from_frame in ways.items():
            if ancestor in joined:
                return joined[ancestor].inverse() @ ancestor_from_frame
        return None

    def _way_up(self, frame: str) -> dict[str, Pose]:
        """Return a frame and its ancestors by transforms that never change, each with `ancestor_from_frame`."""
        current, found = frame.lstrip("/"), Pose.identity()
        ways = {current: found}
        for _ in range(_MAX_CHAIN):
            link = self._unchanging(current)
            if link is None:
                break
            current, pose = link
            found = pose @ found
            ways[current] = found
        return ways

    def _unchanging(self, frame: str) -> tuple[str, Pose] | None:
        """Return a frame's parent and its place there if that never changes.

        Publishers of ROS 1 send such transforms again and again on /tf.
        """
        if frame in self.fixed or frame not in self.moving:
            return self.fixed.get(frame)
        parent, rows = self.moving[frame]
        values = np.array(rows)[:, 1:]
        if len(values) < _MIN_REPEATS or np.ptp(values, axis=0).max() > 0:
            return None
        return parent, Pose.from_quaternion(rows[0][1:4], rows[0][4:8])

    def trajectory_of(
        self, camera_frame: str, rows: list[list[float]], posed_frame: str, topic: str | None
    ) -> Trajectory:
        """Return `scan_from_camera` over time, from a topic's poses (n, 8) of a frame, else from transforms.

        A topic that names no frame is taken to give the camera's poses, unless transforms lead to the camera. Raises
        `InvalidScanError` where neither gives any.
        """
        chain = self._moving_chain(camera_frame.lstrip("/"))
        if rows and (posed_frame or not chain):
            place = self.place(posed_frame, camera_frame) if posed_frame else Pose.identity()
            if place is None:
                raise InvalidScanError(
                    f"The poses of {topic} are those of {posed_frame}, and no static transform of the bag leads from "
                    f"there to the colour camera's frame {camera_frame}: record /tf_static too."
                )
            return _moved(rows, place)
        if not chain:
            raise InvalidScanError(
                "The bag has no poses: record a topic of nav_msgs/Odometry or geometry_msgs/PoseStamped, or /tf from "
                f"a fixed frame to {camera_frame or 'the camera'}."
            )
        return _along(chain)

    def _moving_chain(self, frame: str) -> list[Pose | list[list[float]]]:
        """Return what leads from a fixed frame to `frame`, outermost first; empty if nothing in it moves."""
        chain: list[Pose | list[list[float]]] = []
        for _ in range(_MAX_CHAIN):
            link = self._unchanging(frame)
            if link is not None:
                parent, pose = link
                chain.insert(0, pose)
            elif frame in self.moving:
                parent, rows = self.moving[frame]
                chain.insert(0, rows)
            else:
                break
            frame = parent
        return chain if any(isinstance(link, list) for link in chain) else []

    def with_place_of_depth(
        self, options: ScanOptions, color: str, depth: str, camera: CameraHint | None
    ) -> ScanOptions:
        """Return the options with the depth camera's intrinsics and its place, where fixed transforms say it."""
        place = self.place(color, depth)
        if place is None or camera is None:
            return options
        return replace(options, depth_camera=options.depth_camera or camera, color_from_depth=place)


def pose_of(message: Any) -> tuple[Pose, str]:
    """Return a message's pose and the frame that it is the pose of, "" where it doesn't say."""
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    p, q = pose.position, pose.orientation
    return Pose.from_quaternion([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]), getattr(message, "child_frame_id", "")


def _moved(rows: list[list[float]], place: Pose) -> Trajectory:
    table = []
    for row in rows:
        pose = Pose.from_quaternion(row[1:4], row[4:8]) @ place
        table.append([row[0], *pose.translation, *pose.quaternion])
    return Trajectory.from_rows(np.array(table))


def _along(chain: list[Pose | list[list[float]]]) -> Trajectory:
    """Return the product of a chain at the times of its most frequent moving link."""
    moving = {
        i: Trajectory.from_rows(np.array(link)) for i, link in enumerate(chain) if isinstance(link, list)
    }
    times_s = max(moving.values(), key=lambda track: len(track.times_s)).times_s
    table = []
    for time_s in times_s.tolist():
        product = Pose.identity()
        for i, link in enumerate(chain):
            # A link that is sent rarely, as map to odom is, holds until the next one.
            step = moving[i].pose_at(time_s, np.inf) if i in moving else link
            if not isinstance(step, Pose):
                break
            product = product @ step
        else:
            table.append([time_s, *product.translation, *product.quaternion])
    return Trajectory.from_rows(np.array(table).reshape(-1, 8))
