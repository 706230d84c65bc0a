import numpy as np

from bench.recordings.scan import SCAN_CAMERA
from bench.render.sensor import ColourSensor, colour_picture, depth_picture, depth_sigma_m

SHAPE = (SCAN_CAMERA.height, SCAN_CAMERA.width)


def flat_wall(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def test_depth_noise_grows_with_the_square_of_the_distance():
    for depth_m in (1.0, 2.5, 5.0):
        measured = depth_picture(np.random.default_rng(0), flat_wall(depth_m), SCAN_CAMERA) / 1000
        expected = float(depth_sigma_m(np.float32(depth_m)))
        assert abs(measured.mean() - depth_m) < 0.0006
        assert 0.9 * expected < measured.std() < 1.1 * expected + 0.0003


def test_far_near_and_hidden_depth_is_invalid():
    rng = np.random.default_rng(0)
    assert not depth_picture(rng, flat_wall(8.5), SCAN_CAMERA).any()
    assert not depth_picture(rng, flat_wall(0.2), SCAN_CAMERA).any()
    assert 0.3 < np.mean(depth_picture(rng, flat_wall(7.0), SCAN_CAMERA) > 0) < 0.7
    step = flat_wall(2.0)
    step[:, 320:] = 3.0
    measured = depth_picture(rng, step, SCAN_CAMERA)
    assert not measured[:, 319:321].any()
    assert measured[:, :318].all()


def test_surfaces_seen_at_a_grazing_angle_give_no_depth():
    u = np.arange(SCAN_CAMERA.width, dtype=np.float32)
    x = np.tile((u - SCAN_CAMERA.params[2]) / SCAN_CAMERA.params[0], (SHAPE[0], 1))
    for slant_deg, visible in ((70.0, True), (87.0, False)):
        # The wall cos(s) z + sin(s) x = cos(s) * 1.5 m.
        tangent = np.tan(np.radians(slant_deg))
        depth_m = 1.5 / np.maximum(1 + tangent * (x + 0.02), 0.2)
        measured = depth_picture(np.random.default_rng(0), depth_m.astype(np.float32), SCAN_CAMERA)
        assert bool(measured[240, 320] > 0) is visible


def test_colour_noise_is_seeded_and_small():
    grey = np.full((*SHAPE, 3), 128, np.uint8)
    first, second = (
        colour_picture(np.random.default_rng(3), grey, SCAN_CAMERA, ColourSensor(vignetting=0.0))
        for _ in range(2)
    )
    assert np.array_equal(first, second)
    assert 1.0 < first.std() < 3.0
    assert abs(first.mean() - 128) < 0.5


def test_vignetting_darkens_corners_only_and_blur_softens():
    noise = np.random.default_rng(1).integers(0, 255, (*SHAPE, 3)).astype(np.uint8)
    sensor = ColourSensor(read_noise=0, shot_noise=0, vignetting=0.3, blur_px=8.0)
    picture = colour_picture(np.random.default_rng(0), noise, SCAN_CAMERA, sensor)
    assert picture[:40, :40].mean() < 0.85 * picture[220:260, 300:340].mean()
    assert picture.std() < 0.6 * noise.std()
