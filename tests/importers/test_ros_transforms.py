"""Which poses of a ROS bag are read, and how its transforms lead from them to the colour camera."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.importers.recordings.ros_bag import chosen_topics
from app.importers.recordings.ros_transforms import Transforms

IMAGE = "sensor_msgs/msg/Image"
ODOMETRY = "nav_msgs/msg/Odometry"
STAMPED = "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
CAMERA = "camera_color_optical_frame"
ON_BASE = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.1, 0.0, 0.2]))
ON_LINK = Pose.from_quaternion([0.0, 0.3, 0.0], [0.0, 0.0, 0.6, 0.8])


def rows(*poses: Pose) -> list[list[float]]:
    return [[float(i), *pose.translation, *pose.quaternion] for i, pose in enumerate(poses)]


WAY = rows(ON_LINK, Pose.identity(), ON_BASE)


@pytest.mark.parametrize(
    ("poses", "chosen"),
    [
        ({"/zed/zed_node/pose": STAMPED, "/zed/zed_node/odom": ODOMETRY}, "/zed/zed_node/odom"),
        ({"/amcl_pose": WITH_COVARIANCE, "/odom": ODOMETRY}, "/odom"),
        ({"/vins/odometry": ODOMETRY, "/vins/camera_pose": ODOMETRY}, "/vins/camera_pose"),
        ({"/goal_pose": STAMPED, "/orb_slam3/tracked": STAMPED}, "/orb_slam3/tracked"),
        ({"/initialpose": WITH_COVARIANCE, "/move_base_simple/goal": STAMPED}, None),
    ],
)
def test_poses_that_name_their_frame_come_first_and_goals_are_none(
    poses: dict[str, str], chosen: str | None
) -> None:
    topics = {"/camera/color/image_raw": IMAGE, **poses}
    connections = [SimpleNamespace(topic=topic, msgtype=kind, msgcount=1) for topic, kind in topics.items()]
    assert chosen_topics(SimpleNamespace(connections=connections)).poses == chosen


def assert_camera_is_at(transforms: Transforms, posed_frame: str, place: Pose) -> None:
    trajectory = transforms.trajectory_of(CAMERA, WAY, posed_frame, "/odom")
    for row in WAY:
        pose = trajectory.pose_at(row[0], 0.0)
        assert isinstance(pose, Pose)
        expected = Pose.from_quaternion(row[1:4], row[4:8]) @ place
        np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-9)


def test_transforms_that_are_sent_again_and_again_are_fixed() -> None:
    repeated = Transforms(moving={CAMERA: ("base_link", rows(ON_BASE, ON_BASE, ON_BASE))})
    assert_camera_is_at(repeated, "/base_link", ON_BASE)


@pytest.mark.parametrize("places", [(ON_BASE, ON_LINK), (ON_BASE,)])
def test_a_transform_that_changes_or_was_sent_once_is_not_fixed(places: tuple[Pose, ...]) -> None:
    turning = Transforms(moving={CAMERA: ("base_link", rows(*places))})
    with pytest.raises(InvalidScanError, match="no static transform of the bag leads from there"):
        turning.trajectory_of(CAMERA, WAY, "base_link", "/odom")


def test_a_tracker_and_a_camera_on_one_mount() -> None:
    mounted = Transforms(fixed={"t265_pose_frame": ("mount", ON_LINK), CAMERA: ("mount", ON_BASE)})
    assert_camera_is_at(mounted, "t265_pose_frame", ON_LINK.inverse() @ ON_BASE)


def test_transforms_to_the_camera_come_before_poses_of_an_unnamed_frame() -> None:
    moving = Transforms(fixed={CAMERA: ("base_link", ON_BASE)}, moving={"base_link": ("odom", WAY)})
    pose = moving.trajectory_of(CAMERA, rows(ON_LINK, ON_LINK), "", "/amcl_pose").pose_at(1.0, 0.0)
    assert isinstance(pose, Pose)
    np.testing.assert_allclose(pose.matrix, ON_BASE.matrix, atol=1e-9)


def test_where_the_robot_was_lost_there_are_no_poses_though_its_mount_is_sent_on() -> None:
    lost = [[time_s, *row[1:]] for time_s, row in zip((0.0, 0.1, 5.0), WAY, strict=True)]
    mount = [[i / 10, *ON_BASE.translation, *ON_BASE.quaternion] for i in range(51)]
    moving = Transforms(moving={CAMERA: ("base_link", mount), "base_link": ("odom", lost)})
    trajectory = moving.trajectory_of(CAMERA, [], "", None)
    assert trajectory.times_s.tolist() == [0.0, 0.1, 5.0]
    assert trajectory.pose_between(2.0, 0.25, 0.02) == "no_pose"
