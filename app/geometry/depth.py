"""Depth images: interpolation between pixels, and registration of one camera's depth to another's image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

DepthImage = NDArray[np.float32]
Points = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

# The depth of pixels that no point fell on, until the end of `_splat`.
_FAR_M = np.float32(1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthOptions:
    """When depth is interpolated, and how depth images are registered."""

    max_jump_ratio: float = limit(
        0.04,
        "Neighbouring pixels whose depths differ by at most this ratio are on one surface.",
        chosen="By hand: a surface exceeds it only when it is seen at more than about 80 degrees from its normal.",
    )
    max_nearest_offset_px: float = limit(
        0.25,
        "Where depth can't be interpolated, a pixel's depth is used for points this near its centre, in u and v.",
        chosen="By hand: far enough from the pixel's border.",
    )
    min_focal_ratio: float = limit(
        0.95,
        "Least ratio of the depth camera's focal length to the colour camera's at which depth isn't upsampled.",
        chosen="By hand: the points then leave no holes.",
    )
    view_margin: float = limit(
        0.1,
        "Points further outside the view than this, on the image plane, are not projected through a lens model.",
        chosen="By hand: a lens model is valid a little beyond the image's border.",
    )


OPTIONS = DepthOptions()


def sample_depth(depth_m: DepthImage, points_px: ArrayLike) -> DepthImage:
    """Return the z-depth (n,) in metres at sub-pixel positions (n, 2) of a depth image (height, width).

    The inverse depth is interpolated bilinearly between the four pixels around a point. For a pinhole camera the
    inverse depth of a plane is an affine function of the pixel coordinates (A eq. 5-6 in the plane's equation), so
    this is exact on planes, unlike interpolation of the depth. The result is 0, no depth, outside the image, where
    one of the four pixels has no depth, and where they differ by more than `OPTIONS.max_jump_ratio`, at the edge of
    an object.
    """
    points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
    height, width = depth_m.shape
    out = np.zeros(len(points), dtype=np.float32)
    if min(height, width) < 2:
        return out
    with np.errstate(invalid="ignore"):
        inside = ((points >= 0) & (points <= [width - 1, height - 1])).all(axis=1)
    u, v = points[inside].T
    column = np.minimum(u.astype(np.intp), width - 2)
    row = np.minimum(v.astype(np.intp), height - 2)
    corners = np.stack([depth_m[row + i, column + j] for i in (0, 1) for j in (0, 1)]).astype(np.float64)
    with np.errstate(invalid="ignore"):
        smooth = (corners > 0).all(axis=0) & (
            corners.max(axis=0) <= (1 + OPTIONS.max_jump_ratio) * corners.min(axis=0)
        )
    a, b = (u - column)[smooth], (v - row)[smooth]
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    values = np.zeros(len(u))
    values[smooth] = 1.0 / (weights / corners[:, smooth]).sum(axis=0)
    out[inside] = values
    return out


def register_depth(
    depth_m: DepthImage, depth_camera: Camera, color_camera: Camera, color_from_depth: Pose
) -> DepthImage:
    """Return the depth image (H, W) as seen by the colour camera.

    `depth_m` holds the z-depth in metres of the pixels of `depth_camera`, 0 where it is not known; the result holds
    that of the colour camera's pixels. First the depth pixels are unprojected, moved and projected (A eq. 5-6, 9,
    10); each pixel keeps the nearest point, so that hidden surfaces stay hidden. Then the depth of each pixel is
    interpolated in the depth image, as `sample_depth` does, at the projection of its point: that is exact on planes
    and leaves no holes where the colour image has more pixels. Pixels for which this finds no surface, or another
    one than the nearest, are 0.

    Raises `ValueError` if `depth_m` has another size than its camera.
    """
    if depth_m.shape != (depth_camera.height, depth_camera.width):
        raise ValueError(
            f"Depth of shape {depth_m.shape} for {depth_camera.width} x {depth_camera.height} pixels."
        )
    nearest_m = _nearest_surface(depth_m, depth_camera, color_camera, color_from_depth)
    return _refine(nearest_m, depth_m, depth_camera, color_camera, color_from_depth)


def _nearest_surface(
    depth_m: DepthImage, depth_camera: Camera, color_camera: Camera, color_from_depth: Pose
) -> DepthImage:
    """Return the depth (H, W) of the nearest point on each colour pixel, at the resolution of the depth image."""
    coarse = _with_pixels_of(color_camera, depth_camera)
    rows, columns = np.nonzero(depth_m > 0)
    z = depth_m[rows, columns]
    rays = _rays(depth_camera)[:, rows, columns]
    x, y, z = _move(color_from_depth, (rays[0] * z, rays[1] * z, z))
    u, v = _project(coarse, (x, y, z))
    splat = _splat(u, v, z, coarse.width, coarse.height)
    if (coarse.width, coarse.height) == (color_camera.width, color_camera.height):
        return splat
    size = (color_camera.width, color_camera.height)
    return np.asarray(cv2.resize(splat, size, interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def _with_pixels_of(color_camera: Camera, depth_camera: Camera) -> Camera:
    """Return the colour camera with pixels no smaller than the depth camera's, so that the points leave no holes."""
    ratio = depth_camera.focal_px / color_camera.focal_px
    if ratio >= OPTIONS.min_focal_ratio:
        return color_camera
    width, height = (max(2, round(ratio * n)) for n in (color_camera.width, color_camera.height))
    sx, sy = width / color_camera.width, height / color_camera.height
    fx, fy, cx, cy = color_camera.params[:4]
    scaled = (fx * sx, fy * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5)
    return Camera(color_camera.model, width, height, (*scaled, *color_camera.params[4:]))


def _splat(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], width: int, height: int
) -> DepthImage:
    """Return the least depth (height, width) of the points that fall on each pixel or beside it.

    Each point covers the four pixels around it; otherwise a surface that is magnified would have holes.
    """
    inside = (u > -1) & (u < width) & (v > -1) & (v < height) & (z > 0)
    u, v, z = u[inside], v[inside], z[inside]
    # Sorted from far to near: an assignment with repeated indices keeps the last value, the nearest point.
    # NumPy sorts 16-bit integers (here millimetres) by counting, which is fast.
    far_to_near = np.argsort(65535 - np.minimum(z * 1000, 65535).astype(np.uint16), kind="stable")
    u, v, z = u[far_to_near], v[far_to_near], z[far_to_near]
    stride = width + 2
    corner = (np.floor(v).astype(np.intp) + 1) * stride + np.floor(u).astype(np.intp) + 1
    best = np.full((height + 2) * stride, _FAR_M, dtype=np.float32)
    layer = best.copy()
    for offset in (0, 1, stride, stride + 1):
        layer[corner + offset] = z
        np.minimum(best, layer, out=best)
        layer.fill(_FAR_M)
    best[best == _FAR_M] = 0.0
    return best.reshape(height + 2, stride)[1:-1, 1:-1]


def _refine(
    nearest_m: DepthImage,
    depth_m: DepthImage,
    depth_camera: Camera,
    color_camera: Camera,
    color_from_depth: Pose,
) -> DepthImage:
    """Return the depth (H, W), interpolated in the depth image at the projections of the pixels' nearest points."""
    depth_from_color = color_from_depth.inverse()
    rays = _rays(color_camera)
    x, y, z = _move(depth_from_color, (rays[0] * nearest_m, rays[1] * nearest_m, nearest_m))
    u, v = _project(depth_camera, (x, y, z))
    found = _lookup(depth_m, u, v)
    found[nearest_m == 0] = 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = found / z
    r = color_from_depth.rotation[2].astype(np.float32)
    # The depth, in the colour camera, of the point on the depth camera's ray whose depth there is `found`.
    refined = (r[0] * x + r[1] * y + r[2] * z) * scale + np.float32(color_from_depth.translation[2])
    with np.errstate(invalid="ignore"):
        same_surface = (found > 0) & (np.abs(refined - nearest_m) <= OPTIONS.max_jump_ratio * nearest_m)
    return np.where(same_surface, refined, np.float32(0)).astype(np.float32)


def _lookup(depth_m: DepthImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> DepthImage:
    """Return `sample_depth` at coordinates u, v (H, W); at edges the depth of the nearest pixel if it is close."""
    valid = depth_m > 0
    inverse = np.zeros_like(depth_m)
    np.divide(1.0, depth_m, out=inverse, where=valid)
    sampled = cv2.remap(inverse, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    out = np.zeros(u.shape, dtype=np.float32)
    np.divide(1.0, sampled, out=out, where=sampled > 0)
    height, width = depth_m.shape
    # Indices outside the image are clipped to its border, where no block counts as smooth.
    column = np.clip(np.nan_to_num(u, nan=-1), -1, width).astype(np.intp)
    row = np.clip(np.nan_to_num(v, nan=-1), -1, height).astype(np.intp)
    smooth = np.zeros((height + 1, width + 1), dtype=bool)
    smooth[: height - 1, : width - 1] = _smooth_blocks(inverse)
    interpolated = smooth[row, column] & (u >= 0) & (v >= 0)
    at = np.nonzero(~interpolated)
    out[at] = _nearest_pixel(depth_m, u[at], v[at])
    return out


def _smooth_blocks(inverse: DepthImage) -> NDArray[np.bool_]:
    """Return which blocks of 2 x 2 pixels (h - 1, w - 1) have depth everywhere and contain no edge."""
    kernel = np.ones((2, 2), np.uint8)
    # With its anchor at the top left, the filter covers the pixels to the right and below.
    largest = cv2.dilate(inverse, kernel, anchor=(0, 0))
    smallest = cv2.erode(inverse, kernel, anchor=(0, 0))
    smooth = (smallest > 0) & (largest <= (1 + OPTIONS.max_jump_ratio) * smallest)
    return np.asarray(smooth[:-1, :-1])


def _nearest_pixel(depth_m: DepthImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> DepthImage:
    """Return the depth (n,) of the pixels nearest to points (n,), 0 where the pixel's centre is too far away."""
    height, width = depth_m.shape
    column, row = np.rint(u), np.rint(v)
    with np.errstate(invalid="ignore"):
        reach_px = OPTIONS.max_nearest_offset_px
        near = (np.abs(u - column) <= reach_px) & (np.abs(v - row) <= reach_px)
        near &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
    out = np.zeros(len(u), dtype=np.float32)
    out[near] = depth_m[row[near].astype(np.intp), column[near].astype(np.intp)]
    return out


def _move(target_from_source: Pose, points: Points) -> Points:
    """Return the coordinates x, y, z (each of any shape) in the target frame (A eq. 9), single precision."""
    x, y, z = points
    R = target_from_source.rotation.astype(np.float32)
    t = target_from_source.translation.astype(np.float32)
    a, b, c = (R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + t[i] for i in range(3))
    return a, b, c


def _project(camera: Camera, points: Points) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the pixel coordinates u and v, shaped like the points' x, y, z; NaN for points not in front.

    Points far outside the view are NaN too, because a lens model may fold them back into the image.
    """
    x, y, z = points
    front = np.where(z > 1e-6, z, np.nan).astype(np.float32)
    x, y = x / front, y / front
    if not camera.is_distorted:
        fx, fy, cx, cy = (np.float32(p) for p in camera.params[:4])
        return x * fx + cx, y * fy + cy
    rays = _rays(camera)
    with np.errstate(invalid="ignore"):
        margin = OPTIONS.view_margin
        seen = (x >= rays[0].min() - margin) & (x <= rays[0].max() + margin)
        seen &= (y >= rays[1].min() - margin) & (y <= rays[1].max() + margin)
    x, y = np.where(seen, x, np.float32(np.nan)), np.where(seen, y, np.float32(np.nan))
    return _project_through_lens(camera, x, y)


def _project_through_lens(
    camera: Camera, x: NDArray[np.float32], y: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the pixel coordinates u, v of points x, y at z = 1, like `Camera.project` but six times as fast."""
    if camera.model == "OPENCV_FISHEYE":
        points = np.stack([x.reshape(-1), y.reshape(-1), np.ones(x.size, np.float32)], axis=1)
        u, v = camera.project(points).T.astype(np.float32)
        return u.reshape(x.shape), v.reshape(x.shape)
    fx, fy, cx, cy = (np.float32(p) for p in camera.params[:4])
    k1, k2, p1, p2, k3, k4, k5, k6 = (np.float32(k) for k in (*camera.params[4:], 0, 0, 0, 0)[:8])
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    if k4 or k5 or k6:
        radial = radial / (1 + square * (k4 + square * (k5 + square * k6)))
    xy = 2 * x * y
    distorted_x = x * radial + p1 * xy + p2 * (square + 2 * x * x)
    distorted_y = y * radial + p2 * xy + p1 * (square + 2 * y * y)
    return distorted_x * fx + cx, distorted_y * fy + cy


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> NDArray[np.float32]:
    """Return x and y (2, height, width) of the rays through the pixels at z = 1 (A eq. 5, lens removed)."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    pixels = np.stack([u.reshape(-1), v.reshape(-1)], axis=1)
    rays = camera.normalize(pixels).T.reshape(2, camera.height, camera.width).astype(np.float32)
    rays.setflags(write=False)
    return rays
