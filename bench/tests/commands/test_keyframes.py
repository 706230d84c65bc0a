"""`roomfix keyframes` and `roomfix evaluate` by the paper's pipelines, on the tiny room."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.errors import InvalidInputError
from tests.scenes import CAMERA, View, scan_files

RUN = CliRunner()
OPTIONS = json.dumps({"camera": list(CAMERA.params)})


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for name, data in scan_files(views).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory, queries: list[View]) -> Path:
    """The queries as a folder with their poses."""
    folder = tmp_path_factory.mktemp("pictures")
    listed = []
    for i, query in enumerate(queries):
        (folder / f"{i}.jpg").write_bytes(query.jpeg())
        pose = query.world_from_camera
        listed.append(
            {
                "name": str(i),
                "image": f"{i}.jpg",
                "camera": {"model": "PINHOLE", "width": 320, "height": 240, "params": list(CAMERA.params)},
                "pose": {
                    "position": dict(zip("xyz", pose.translation.tolist(), strict=True)),
                    "quaternion": dict(zip("xyzw", pose.quaternion.tolist(), strict=True)),
                },
            }
        )
    (folder / "queries.json").write_text(json.dumps({"queries": listed}))
    return folder


def run(*arguments: object) -> str:
    result = RUN.invoke(app, [str(part) for part in arguments])
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_rules_are_compared_in_one_table(scan: Path, pictures: Path, tmp_path: Path) -> None:
    plot, figures = tmp_path / "errors.png", tmp_path / "figures.json"
    text = run(
        "keyframes", scan, "--rule", "content", "--rule", "dense", "--sparse", "--queries", pictures,
        "--options", OPTIONS, "--plot", plot, "--json", figures,
    )  # fmt: skip
    assert "content, no pictures" in text
    assert "largest keyframe, kB" in text
    assert plot.read_bytes().startswith(b"\x89PNG")
    rows = {row["name"]: row for row in json.loads(figures.read_text())["rules"]}
    assert rows["content"]["keyframes"] <= rows["dense"]["keyframes"] <= 14
    assert rows["dense"]["summary"]["located_percent"] == 100
    assert rows["content, no pictures"]["pictures_mb"] == 0 < rows["content"]["pictures_mb"]
    assert rows["content, no pictures"]["kb_per_keyframe"] <= 100
    assert rows["content"]["similarity_mean"] <= rows["dense"]["similarity_mean"]
    assert "keyframes among the first 20 frames" in text
    assert rows["dense"]["frames"] == list(range(rows["dense"]["keyframes"]))
    assert set(rows["content"]["frames"]) <= set(rows["dense"]["frames"])


def test_the_papers_tables_and_what_suits_the_scene(scan: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    text = run("keyframes", scan, "--sweep", "--bursts", "--options", OPTIONS, "--json", figures)
    assert 'Suggested for this scene: {"rule": ' in text
    found = json.loads(figures.read_text())
    pairs = {(row["alpha"], row["beta"]) for row in found["sweep"]}
    assert pairs == {
        (a, round(a - b, 3)) for a in (0.45, 0.4, 0.35, 0.3, 0.25) for b in (0.05, 0.1, 0.15, 0.2)
    }
    for row in found["sweep"]:
        assert 1 <= row["keyframes"] <= 14
        assert 0 <= row["mean"] <= 1
        assert row["variance"] >= 0
    by_pair = {(row["alpha"], row["beta"]): row["keyframes"] for row in found["sweep"]}
    assert by_pair[0.45, 0.4] >= by_pair[0.25, 0.05]
    suggested = found["suggested"]
    if found["neighbours"] < 0.45:
        assert suggested == {"rule": "pose"}
    else:
        assert (suggested["alpha"], suggested["beta"]) in pairs
    counts = {row["stretch"]: row["keyframes"] for row in found["bursts"]}
    assert counts["played twice"] == counts["as scanned"]


def test_single_pairs_have_their_features_matches_and_similarity(scan: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    text = run("keyframes", scan, "--pair", "3,3", "--pair", "0,1", "--options", OPTIONS, "--json", figures)
    same, next_to = json.loads(figures.read_text())["pairs"]
    assert same["first_features"] == same["second_features"] > 50
    # A picture is as similar to itself as the ratio test lets it be.
    assert same["matches"] > 0.9 * same["first_features"]
    assert 0 < next_to["matches"] < next_to["first_features"]
    assert f"{2 * next_to['matches'] / (next_to['first_features'] + next_to['second_features']):.3f}" in text


def test_pipelines_are_compared_on_the_same_queries(scan: Path, pictures: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    run(
        "keyframes", scan, "--rule", "pose", "--pipelines", "--queries", pictures, "--options", OPTIONS,
        "--json", figures,
    )  # fmt: skip
    rows = {row["name"]: row for row in json.loads(figures.read_text())["rules"]}
    assert list(rows) == ["default", "paper", "two-images", "vdm", "epipolar"]
    for name in ("default", "vdm"):
        assert rows[name]["summary"]["located_percent"] == 100
        assert rows[name]["summary"]["max_cm"] < 5


@pytest.mark.parametrize("pipeline", ["vdm", "epipolar"])
def test_evaluate_takes_the_papers_pipelines(scan: Path, pipeline: str, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    run("evaluate", scan, "--pipeline", pipeline, "--options", OPTIONS, "--json", figures)
    (result,) = json.loads(figures.read_text())
    assert pipeline in result["name"]
    assert result["summary"]["queries"] == 7
    if pipeline == "vdm":
        assert result["summary"]["located_percent"] > 70
        assert result["summary"]["max_cm"] < 10


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--rule", "magic"], "is not known"),
        (["--pipelines"], "need --queries"),
        (["--plot", "x.png"], "need --queries"),
        (["--queries", "1::2", "--plot", "x.txt"], "must end in"),
        (["--queries", "50:60"], "leaves no query"),
        (["--queries", "/tmp"], "queries.json"),
        (["--beta", "0.9"], "beta"),
        (["--pair", "3"], "first,second"),
        (["--pair", "0,99"], "beyond"),
        (["--options", "{"], "not JSON"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(scan: Path, arguments: list[str], says: str) -> None:
    given = arguments if "--options" in arguments else [*arguments, "--options", OPTIONS]
    with pytest.raises(InvalidInputError, match=says):
        run("keyframes", scan, *given)
