"""Depth images: reading depth between pixels, and registering one camera's depth to another's image."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose

DepthImage = NDArray[np.float32]
Points = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

# Neighbouring pixels of one surface differ by less than this unless it is seen at more than about 80 degrees.
MAX_RELATIVE_JUMP = 0.04
# Where depth can't be interpolated, the nearest pixel stands for points within this distance of its centre.
NEAREST_PIXEL_REACH = 0.25
_FAR_M = np.float32(1e6)


def sample_depth(depth_m: DepthImage, points_px: ArrayLike) -> DepthImage:
    """Return the z-depth (n,) in metres at sub-pixel positions (n, 2) of a depth image (height, width).

    The inverse of depth is interpolated bilinearly between the four pixels around a point: seen by a pinhole,
    a plane's inverse depth is affine in the pixel coordinates (A eq. 5-6 put into the plane's equation), so
    on planes this is exact where interpolating depth is not. 0 stands for no depth: outside the image, where
    one of the four pixels has none, and where they differ by more than 4 %, which is the edge of an object.
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
            corners.max(axis=0) <= (1 + MAX_RELATIVE_JUMP) * corners.min(axis=0)
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
    """Return the depth image (H, W) that the colour camera would have measured.

    `depth_m` holds z-depth in metres for the pixels of `depth_camera`, 0 where it is not known, and so does
    the result for the colour camera. In two steps: the depth pixels are unprojected, moved and projected (A
    eq. 5-6, 9, 10) and the nearest point wins each pixel, so that what the colour camera can't see stays
    hidden; then each pixel looks up its surface point in the depth image between the pixels, as
    `sample_depth` does, which makes planes exact and leaves no holes where the colour image is the larger
    one. Pixels where no surface is found, or another than the nearest one, are 0.

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
    """Return the depth (H, W) of the nearest point on each colour pixel, placed to half a depth pixel."""
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
    """Return the colour camera with pixels no smaller than the depth camera's, so that points fill it."""
    ratio = depth_camera.focal_px / color_camera.focal_px
    if ratio >= 0.95:
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

    Each point covers the four pixels around it, or a surface that a change of scale stretches would have
    holes.
    """
    inside = (u > -1) & (u < width) & (v > -1) & (v < height) & (z > 0)
    u, v, z = u[inside], v[inside], z[inside]
    # Far to near, so that in an assignment with repeated indices, where the last one stays, the nearest
    # stays. 16 bits of millimetres are enough for the order, and sorted by counting.
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
    """Return the depth (H, W) looked up in the depth image where the pixels' rays meet the surface found."""
    depth_from_color = color_from_depth.inverse()
    rays = _rays(color_camera)
    x, y, z = _move(depth_from_color, (rays[0] * nearest_m, rays[1] * nearest_m, nearest_m))
    u, v = _project(depth_camera, (x, y, z))
    found = _lookup(depth_m, u, v)
    found[nearest_m == 0] = 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = found / z
    r = color_from_depth.rotation[2].astype(np.float32)
    # A point on the same ray of the depth camera: its depth there is `found`, in the colour camera this.
    refined = (r[0] * x + r[1] * y + r[2] * z) * scale + np.float32(color_from_depth.translation[2])
    with np.errstate(invalid="ignore"):
        same_surface = (found > 0) & (np.abs(refined - nearest_m) <= MAX_RELATIVE_JUMP * nearest_m)
    return np.where(same_surface, refined, np.float32(0)).astype(np.float32)


def _lookup(depth_m: DepthImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> DepthImage:
    """Return `sample_depth` for maps of coordinates (H, W), but at edges the pixel whose centre is near."""
    valid = depth_m > 0
    inverse = np.zeros_like(depth_m)
    np.divide(1.0, depth_m, out=inverse, where=valid)
    sampled = cv2.remap(inverse, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    out = np.zeros(u.shape, dtype=np.float32)
    np.divide(1.0, sampled, out=out, where=sampled > 0)
    height, width = depth_m.shape
    # An index outside is clipped; the sample there is 0 or mixed with 0, and no block at the rim is smooth.
    column = np.clip(np.nan_to_num(u, nan=-1), -1, width).astype(np.intp)
    row = np.clip(np.nan_to_num(v, nan=-1), -1, height).astype(np.intp)
    smooth = np.zeros((height + 1, width + 1), dtype=bool)
    smooth[: height - 1, : width - 1] = _smooth_blocks(inverse)
    interpolated = smooth[row, column] & (u >= 0) & (v >= 0)
    at = np.nonzero(~interpolated)
    out[at] = _nearest_pixel(depth_m, u[at], v[at])
    return out


def _smooth_blocks(inverse: DepthImage) -> NDArray[np.bool_]:
    """Return for each block of 2 x 2 pixels (h - 1, w - 1) whether all have depth and no edge is in it."""
    kernel = np.ones((2, 2), np.uint8)
    # With its anchor at the top left a filter looks at the pixels right and below.
    largest = cv2.dilate(inverse, kernel, anchor=(0, 0))
    smallest = cv2.erode(inverse, kernel, anchor=(0, 0))
    smooth = (smallest > 0) & (largest <= (1 + MAX_RELATIVE_JUMP) * smallest)
    return np.asarray(smooth[:-1, :-1])


def _nearest_pixel(depth_m: DepthImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> DepthImage:
    """Return the depth (n,) of the pixels at points (n,), 0 for points that are not near a pixel's centre."""
    height, width = depth_m.shape
    column, row = np.rint(u), np.rint(v)
    with np.errstate(invalid="ignore"):
        near = (np.abs(u - column) <= NEAREST_PIXEL_REACH) & (np.abs(v - row) <= NEAREST_PIXEL_REACH)
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

    Points far outside the view are NaN too: there a lens's polynomial may bend them back into the image.
    """
    x, y, z = points
    front = np.where(z > 1e-6, z, np.nan).astype(np.float32)
    x, y = x / front, y / front
    if not camera.is_distorted:
        fx, fy, cx, cy = (np.float32(p) for p in camera.params[:4])
        return x * fx + cx, y * fy + cy
    rays = _rays(camera)
    with np.errstate(invalid="ignore"):
        seen = (x >= rays[0].min() - 0.1) & (x <= rays[0].max() + 0.1)
        seen &= (y >= rays[1].min() - 0.1) & (y <= rays[1].max() + 0.1)
    x, y = np.where(seen, x, np.float32(np.nan)), np.where(seen, y, np.float32(np.nan))
    return _project_through_lens(camera, x, y)


def _project_through_lens(
    camera: Camera, x: NDArray[np.float32], y: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the pixel coordinates of points at z = 1: `Camera.project`, but six times as fast."""
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
    bent_x = x * radial + p1 * xy + p2 * (square + 2 * x * x)
    bent_y = y * radial + p2 * xy + p1 * (square + 2 * y * y)
    return bent_x * fx + cx, bent_y * fy + cy


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> NDArray[np.float32]:
    """Return x and y (2, height, width) of the rays through the pixels at z = 1 (A eq. 5, lens removed)."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    pixels = np.stack([u.reshape(-1), v.reshape(-1)], axis=1)
    rays = camera.normalize(pixels).T.reshape(2, camera.height, camera.width).astype(np.float32)
    rays.setflags(write=False)
    return rays
