"""The page of an evaluation of anchors."""

from __future__ import annotations

from pathlib import Path

from bench.anchors.pairs import AnchorSummary
from bench.anchors.report import anchor_section, query_section, write_report


def test_the_page_holds_tables_and_figures(tmp_path: Path) -> None:
    (tmp_path / "plot.png").write_bytes(b"")
    summary = AnchorSummary(
        pairs=20,
        located_percent=85.0,
        good_percent=80.0,
        mean_m=0.12,
        median_m=0.05,
        wrong_percent=0.0,
        sigma_m=0.15,
    )
    sections = [
        anchor_section("a hall", {"angle": {"0-15": summary}}, tmp_path, {"plot.png": "by angle"}),
        query_section({"timings": {"total_ms": 150.5, "stages_ms": {"akaze": 80.0}}}),
    ]
    page = write_report(sections, tmp_path).read_text()
    for text in ("a hall", "within 0.46 m %", "<td>85</td>", "plot.png", "stages_ms akaze", "150.5"):
        assert text in page
