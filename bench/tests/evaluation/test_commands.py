"""The evaluation commands, from a tiny scan to page and numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.errors import InvalidInputError
from app.importers.frames import ScanOptions
from bench.evaluation import absent
from bench.evaluation.dataset import split_scan
from bench.evaluation.over_http import evaluate_over_http
from bench.evaluation.variations import parse_variations
from bench.tests.evaluation.test_report import Page
from tests.server import Server

SPLIT = ("--database", "0:14", "--queries", "14:")
# For what is asked of the tables and not of the answers.
SMALL = ("--database", "0:7", "--queries", "14:15")


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    if result.exception is not None:
        raise result.exception
    return result.output


@pytest.fixture(scope="module")
def report(scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of three variations, two of them with a camera, and of synthetic places."""
    directory = tmp_path_factory.mktemp("report")
    degrade = [each for name in ("none", "rot90", "no-camera-mixed") for each in ("--degrade", name)]
    with pytest.MonkeyPatch.context() as patched:
        # Some of each kind: a picture in which nothing is found is searched longest.
        patched.setattr(absent, "SYNTHETIC_COUNTS", {"black": 1, "white": 1, "noise": 2, "wall": 2})
        output = run("evaluate", scan, *SPLIT, *degrade, "--absent", "synthetic", "--report", directory)
    assert "index.html" in output
    assert "no-camera-mixed" in output
    return directory


def results_in(directory: Path) -> list[dict[str, Any]]:
    results: list[dict[str, Any]] = json.loads((directory / "evaluation.json").read_text())
    return results


def test_the_queries_of_a_variation_are_located_where_they_are(report: Path) -> None:
    plain, turned, mixed = results_in(report)
    assert [each["variation"] for each in (plain, turned, mixed)] == ["none", "rot90", "no-camera-mixed"]
    for each in (plain, turned):
        assert each["summary"]["within_10cm_5deg_percent"] == 100.0
    assert mixed["summary"]["queries"] == 4
    assert plain["keyframes"] == len(plain["keyframe_centres"]) > 3
    assert plain["keyframe_thresholds"] == {"position_m": 0.1757, "attitude_rad": 0.1304}


def test_absent_places_are_asked_with_and_without_a_camera(report: Path) -> None:
    plain, turned, mixed = results_in(report)
    assert (plain["absent"]["images"], plain["absent"]["located"]) == (6, 0)
    assert mixed["absent"]["located"] == 0
    assert "absent" not in turned


def test_outcomes_hold_what_confidence_is_made_of(report: Path) -> None:
    for outcome in results_in(report)[0]["outcomes"]:
        assert outcome["inlier_ratio"] == pytest.approx(outcome["inliers"] / outcome["matches"])
        assert 0 < outcome["coverage"] <= 1
        assert 0 <= outcome["rival_share"] < 1
        assert 0 < outcome["sigma_m"] < 0.25
        assert outcome["confidence"] > 0.5
        distance = (
            sum((a - b) ** 2 for a, b in zip(outcome["truth_m"], outcome["estimate_m"], strict=True)) ** 0.5
        )
        assert distance == pytest.approx(outcome["position_m"], abs=2e-4)


def test_the_page_has_the_numbers_and_every_picture(report: Path) -> None:
    page = Page(report / "index.html")
    rows = {row[0]: dict(zip(header, row, strict=True)) for header, row in tables(page)}
    plain, turned, _ = results_in(report)
    name = f"{plain['name']}, {plain['features']}"
    assert name == "museum default, sift"
    assert {"museum default, sift", "museum default, sift, rot90"} <= set(rows)
    assert any(row[3] == str(turned["summary"]["mean_cm"]) for row in page.rows if len(row) > 3)
    assert any(str(plain["keyframes"]) in row for row in page.rows)
    assert len(page.images) == 3 + 5
    for image in page.images:
        assert (report / image).read_bytes().startswith(b"\x89PNG")


def tables(page: Page) -> list[tuple[list[str], list[str]]]:
    """Return each row of a page together with the header above it."""
    out, header = [], page.rows[0]
    for row in page.rows:
        if len(row) != len(header) or row[0] in ("map", "queries of", "configuration"):
            header = row
        else:
            out.append((header, row))
    return out


def test_reliability_pools_what_evaluations_wrote(report: Path, tmp_path: Path) -> None:
    file = report / "evaluation.json"
    output = run("reliability", file, file, "--report", tmp_path / "out", "--json", tmp_path / "r.json")
    assert "ECE" in output
    found = json.loads((tmp_path / "r.json").read_text())["museum default, sift"]
    located = sum(outcome["located"] for each in results_in(report) for outcome in each["outcomes"])
    assert found["located"] == 2 * located
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "index.html", "reliability.json", "reliability.png", "coverage_risk.png"
    }  # fmt: skip


def test_configurations_stand_side_by_side(scan: Path, tmp_path: Path) -> None:
    file = tmp_path / "all.json"
    every = '{"keyframes": {"rule": "interval", "every": 3}}'
    output = run(
        "evaluate", scan, *SMALL, "--features", "sift", "--features", "orb",
        "--options", "{}", "--options", every, "--json", file,
    )  # fmt: skip
    results = json.loads(file.read_text())
    assert [(each["name"], each["features"]) for each in results] == [
        ("museum default, defaults", "sift"),
        ("museum default, defaults", "orb"),
        ("museum default, keyframes.rule=interval, keyframes.every=3", "sift"),
        ("museum default, keyframes.rule=interval, keyframes.every=3", "orb"),
    ]
    assert results[2]["keyframes"] == 3
    assert results[2]["keyframe_thresholds"] is None
    assert "wrong by over 1 m %" in output


def test_both_pipelines_and_several_datasets(scan: Path, tmp_path: Path) -> None:
    file = tmp_path / "all.json"
    copy = tmp_path / "again"
    copy.symlink_to(scan)
    run("evaluate", scan, copy, *SMALL, "--pipeline", "default", "--pipeline", "paper", "--json", file)
    results = json.loads(file.read_text())
    assert [each["features"] for each in results] == ["sift", "orb"] * 2
    assert results[1]["name"] == "museum paper"


def test_over_http_the_queries_are_made_worse_as_well(scan: Path, museum: Server) -> None:
    split = split_scan(scan, "0:14", "14:", "auto", ScanOptions())
    variations = parse_variations(["none", "rot90"])
    before = museum.client.get("/venues").json()
    plain, turned = evaluate_over_http(museum.client, split, "museum", {}, variations)
    for each in (plain, turned):
        assert each.summary.within_10cm_5deg_percent == 100.0
        assert all(outcome.sigma_m and outcome.truth_m and outcome.estimate_m for outcome in each.outcomes)
    assert (plain.label, turned.label) == ("museum over HTTP, sift", "museum over HTTP, sift, rot90")
    assert set(plain.stages_ms) >= {"describe", "match", "pose"}
    assert museum.client.get("/venues").json() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--degrade", "upside-down"], "not known"),
        (["--absent", "/nowhere"], "synthetic"),
        (["--options", "{"], "not JSON"),
        (["--options", "[]"], "JSON object"),
        (["--server", "http://127.0.0.1:9", "--absent", "synthetic"], "leave out"),
        (["--queries", "0:3"], "left for the database"),
    ],
)
def test_what_cannot_be_meant_is_said(scan: Path, arguments: list[str], words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        run("evaluate", scan, *SPLIT, *arguments)


def test_by_the_papers_protocol_keyframes_are_the_database_and_all_other_frames_are_queries(
    scan: Path, tmp_path: Path
) -> None:
    file = tmp_path / "protocol.json"
    rule = '{"keyframes": {"position_m": 0.5, "attitude_rad": 0.5}}'
    output = run(
        "evaluate", scan, "--protocol", "keyframes", "--options", rule, "--pipeline", "default",
        "--pipeline", "paper", "--pipeline", "two-images", "--json", file,
    )  # fmt: skip
    default, paper, reference = json.loads(file.read_text())
    frames = len((scan / "rgb.txt").read_text().splitlines())
    for each in (default, paper, reference):
        assert each["frames"] + each["summary"]["queries"] <= frames
        assert each["keyframes"] == each["frames"]
        assert each["keyframe_thresholds"] == {"position_m": 0.5, "attitude_rad": 0.5}
    assert default["summary"]["queries"] >= 5
    assert default["summary"]["gross_percent"] == 0.0
    located = [outcome for outcome in paper["outcomes"] if outcome["located"]]
    assert all(outcome["matches"] >= 50 for outcome in located)
    for caption in ("A tables 2 and 3", "A table 4", "A table 5"):
        assert caption in output


def test_the_papers_protocol_chooses_the_frames_itself(scan: Path) -> None:
    with pytest.raises(InvalidInputError, match="itself"):
        run("evaluate", scan, "--protocol", "keyframes", "--database", "0::2")
