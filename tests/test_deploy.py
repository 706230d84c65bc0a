"""What deploy/ holds: rules and dashboards name metrics that the server has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.api.metrics import Metrics

DEPLOY = Path(__file__).parents[1] / "deploy"
NAME = re.compile(r"\b(roomfix_[a-z_]+|process_[a-z_]+)\b")


@pytest.mark.parametrize("name", ["alerts.yml", "grafana-dashboard.json"])
def test_metrics_exist(name: str) -> None:
    named = set(NAME.findall((DEPLOY / name).read_text(encoding="utf-8")))
    known = set(re.findall(r"^# TYPE (\S+)", Metrics().render().decode(), re.MULTILINE))
    histograms = {f"{metric}_bucket" for metric in known}
    assert len(named) >= 6
    assert named <= known | histograms
