"""Prometheus accepts the files in deploy/prometheus, and these files name only metrics that exist."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from stampede_rt_channel_host.metrics import catalog as host_metrics
from stampede_rt_frontend import metrics as frontend_metrics
from stampede_rt_runtime.metrics import service_metrics
from stampede_rt_runtime.metrics.families import MetricKind
from stampede_rt_supernode import metrics as supernode_metrics

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "deploy" / "prometheus"
ALL = [*host_metrics.METRICS, *supernode_metrics.METRICS, *frontend_metrics.METRICS, *service_metrics.METRICS]
EXISTING = {
    f"{one.name}{end}"
    for one in ALL
    for end in (("_bucket", "_sum", "_count") if one.kind is MetricKind.HISTOGRAM else ("",))
}
OBSERVING = (ROOT / "docs" / "observing.md").read_text()


@pytest.mark.skipif(shutil.which("promtool") is None, reason="Debian's prometheus is not installed")
@pytest.mark.parametrize(
    "words",
    [("check", "config", "prometheus.yml"), ("check", "rules", "alerts.yml"), ("test", "rules", "alerts_test.yml")],
)
def test_promtool_accepts_the_file(words: tuple[str, ...]) -> None:
    done = subprocess.run(["promtool", *words], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("file", ["alerts.yml", "alerts_test.yml", "dashboard.json"])
def test_each_metric_in_the_file_exists(file: str) -> None:
    named = set(re.findall(r"\bstampede_[a-z_]+", (FOLDER / file).read_text()))
    assert named, "the file is about our metrics"
    assert named <= EXISTING, named - EXISTING


def test_the_dashboard_has_a_place_and_an_expression_for_each_panel() -> None:
    panels = json.loads((FOLDER / "dashboard.json").read_text())["panels"]
    places = {(one["gridPos"]["x"], one["gridPos"]["y"]) for one in panels}
    assert len(places) == len({one["id"] for one in panels}) == len(panels)
    assert all(target["expr"] for one in panels for target in one["targets"])


def test_the_docs_explain_each_metric() -> None:
    missing = [one.name for one in ALL if f"`{one.name}`" not in OBSERVING]
    assert not missing


def test_the_docs_name_no_other_metric() -> None:
    assert set(re.findall(r"`(stampede_[a-z_]+)`", OBSERVING)) <= {one.name for one in ALL}


def test_the_docs_give_advice_for_each_alert() -> None:
    alerts = re.findall(r"- alert: (\w+)", (FOLDER / "alerts.yml").read_text())
    assert alerts == re.findall(r"^### (Stampede\w+)$", OBSERVING, re.MULTILINE)


def test_names_and_labels_follow_the_rules_of_prometheus() -> None:
    assert len({one.name for one in ALL}) == len(ALL)
    for one in ALL:
        assert re.fullmatch(r"stampede_[a-z_]+", one.name)
        assert one.name.endswith("_total") == (one.kind is MetricKind.COUNTER), one.name
        assert one.help.endswith("."), one.name
