"""Calibration on made-up counts and on the synthetic scan."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.build_map import build_map
from app.engine.mapping.calibrate import calibrate
from app.engine.mapping.calibration_curves import Calibration, PairCounts, fit_curves
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import NoProgress
from app.errors import InvalidInputError, InvalidScanError
from app.geometry.camera_hint import hint_of
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.vision.keyframes import ATTITUDE_CURVE, POSITION_CURVE
from tests.scenes import CAMERA, View, scan_files

CALIBRATED = parse_build_options({"keyframes": {"rule": "pose", "thresholds": "calibrated"}})


def counted(seed: int = 0, count: int = 3000, share: float = 1.0) -> PairCounts:
    """Return pairs that have what both of the paper's curves leave, whichever is less."""
    rng = np.random.default_rng(seed)
    position_m = np.exp(rng.uniform(np.log(0.01), np.log(2.0), count))
    attitude_rad = np.exp(rng.uniform(np.log(0.01), np.log(1.0), count))
    left = np.minimum(POSITION_CURVE(position_m), ATTITUDE_CURVE(attitude_rad)) * share
    matches = np.rint(left * np.exp(rng.normal(0, 0.1, count))).astype(np.int64)
    return PairCounts(position_m, attitude_rad, matches, rng.random(count) < 0.3)


@pytest.fixture(scope="module")
def scan(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Scan:
    folder = tmp_path_factory.mktemp("scan")
    for name, data in scan_files(views).items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    return open_scan(folder, "tum", ScanOptions(camera=hint_of(CAMERA)))


def calibrated(scan: Scan, options: BuildOptions = CALIBRATED, wanted: float | None = None) -> Calibration:
    with ThreadPoolExecutor(2) as executor:
        return calibrate(scan, options, VisionModels(), executor, NoProgress(), wanted)


def test_pairs_that_follow_the_papers_curves_give_its_thresholds() -> None:
    found = fit_curves(counted(), 50, "orb", 100)
    assert found.thresholds.position_m == pytest.approx(0.1757, rel=0.1)
    assert found.thresholds.attitude_rad == pytest.approx(0.1304, rel=0.1)
    assert found.position.curve.b == pytest.approx(POSITION_CURVE.b, abs=0.15)
    assert found.attitude.curve.b == pytest.approx(ATTITUDE_CURVE.b, abs=0.15)
    for curve in (found.position, found.attitude):
        assert curve.reached == "within"
        assert curve.left_at_threshold == pytest.approx(50, rel=0.2)
        assert curve.rmse_validation == pytest.approx(curve.rmse_fit, rel=0.3)
    assert not found.warnings


def test_thresholds_shrink_as_more_matches_are_wanted() -> None:
    found = [fit_curves(counted(), wanted, "orb", 100).thresholds for wanted in (30, 50, 80)]
    assert found[0].position_m > found[1].position_m > found[2].position_m
    assert found[0].attitude_rad > found[1].attitude_rad > found[2].attitude_rad


def test_a_number_that_is_not_reached_is_said_and_not_extrapolated() -> None:
    poor, rich = fit_curves(counted(share=0.01), 50, "orb", 9), fit_curves(counted(share=500), 50, "orb", 9)
    assert (poor.position.reached, poor.attitude.reached) == ("below", "below")
    assert (rich.position.reached, rich.attitude.reached) == ("beyond", "beyond")
    assert poor.thresholds.position_m == pytest.approx(0.01, rel=0.1)
    assert rich.thresholds.position_m == pytest.approx(2.0, rel=0.1)
    assert len(poor.warnings) == len(rich.warnings) == 2
    assert "fewer than 50" in poor.warnings[0]
    assert "more than 50" in rich.warnings[0]


def test_too_few_pairs_or_matches_are_refused() -> None:
    with pytest.raises(InvalidScanError, match="pairs of frames"):
        fit_curves(counted(count=8), 50, "orb", 4)
    with pytest.raises(InvalidScanError, match="confirm"):
        fit_curves(counted(share=0.0), 50, "orb", 4)


def test_a_scan_gives_thresholds_inside_its_own_differences(scan: Scan) -> None:
    found = calibrated(scan)
    assert found.frames == len(scan.frames)
    assert 0.05 < found.thresholds.position_m < 1.2
    assert 0.1 < found.thresholds.attitude_rad < 1.2
    assert found.position.pairs_validation > 0
    assert calibrated(scan).as_dict() == found.as_dict()
    json.dumps(found.as_dict())


def test_false_matches_do_not_count(scan: Scan) -> None:
    """With the depth of another scale hardly any match is confirmed, though as many descriptors match."""
    good = calibrated(scan)
    wrong = replace(scan, depth=replace(scan.depth, scale=scan.depth.scale * 3))
    assert calibrated(wrong).position.matches.mean() < 0.2 * good.position.matches.mean()


def test_a_build_chooses_keyframes_by_its_calibration(scan: Scan) -> None:
    with ThreadPoolExecutor(2) as executor:
        built = build_map(scan, CALIBRATED, VisionModels(), executor, NoProgress())
        default = build_map(scan, BuildOptions(), VisionModels(), executor, NoProgress())
    assert built.calibration is not None
    assert default.calibration is None
    assert "calibrate" in built.seconds
    assert 0 < built.artifact.keyframe_count < default.artifact.keyframe_count


def test_a_scan_of_two_frames_is_refused(scan: Scan) -> None:
    short = replace(scan, frames=scan.frames[:2])
    with pytest.raises(InvalidScanError):
        calibrated(short)
    with pytest.raises(InvalidScanError, match="moving camera"):
        calibrated(replace(scan, frames=scan.frames[:1]))


@pytest.mark.parametrize(
    "keyframes",
    [
        {"thresholds": "measured"},
        {"thresholds": None},
        {"thresholds": "calibrated", "position_m": 0.2},
        {"wanted_matches": 0},
        {"wanted_matches": "many"},
        {"wanted_matches": 1e9},
    ],
)
def test_options_that_contradict_themselves_are_refused(keyframes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match="keyframes"):
        parse_build_options({"keyframes": keyframes})


def test_options_ask_for_a_calibration() -> None:
    rule = parse_build_options({"keyframes": {"thresholds": "calibrated", "wanted_matches": 80}}).keyframes
    assert (rule.rule, rule.calibrated, rule.wanted_matches) == ("pose", True, 80)
    assert not BuildOptions().keyframes.calibrated


def test_the_command_writes_figures(scan: Scan, tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from app.cli import app

    folder, figures = scan.frames[0].color.parents[1], tmp_path / "figures.json"
    options = json.dumps({"camera": list(CAMERA.params)})
    arguments = ["calibrate", str(folder), "--options", options, "--matches", "40"]
    result = CliRunner().invoke(app, [*arguments, "--json", str(figures)])
    assert result.exit_code == 0, result.output
    assert "threshold" in result.output
    assert json.loads(figures.read_text())["wanted_matches"] == 40
