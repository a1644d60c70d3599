"""Statements of docs/operations.md."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from harness.server import ROOT
from server.monitoring.monitor import Metrics
from tests.server.monitoring.watched_parts import arm_health, watched_sources
from tests.test_readme import blocks

PAGE = ROOT / "docs" / "operations.md"

SUFFIXES = {"counter": "_total", "info": "_info"}


def rows() -> list[list[str]]:
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    return [re.split(r" *\| *", line)[1:-1] for line in lines]


def test_every_metric_is_on_the_page_with_its_kind_and_labels() -> None:
    told = {}
    for cells in rows():
        for name in re.findall(r"`(armbridge_\w+)`", cells[0]):
            told[name] = (cells[1], set(filter(None, re.split(r",? +", cells[2].strip()))))
    found = {}
    # Of no age, whatever the time is.
    condition = replace(arm_health(), monotonic_s=math.inf)
    for family in Metrics(replace(watched_sources(), arm_health=condition)).registry.collect():
        labels = {label for each in family.samples for label in each.labels} - {"le"}
        # Nobody has sent a goal.
        labels |= {"source", "result"} if family.name == "armbridge_goals" else set()
        kind = "gauge" if family.type == "info" else family.type
        found[family.name + SUFFIXES.get(family.type, "")] = (kind, labels)
    assert told == found


def test_prometheus_can_read_what_it_is_to_scrape() -> None:
    yaml = pytest.importorskip("yaml")
    (snippet,) = blocks(PAGE, "yaml")
    (job,) = yaml.safe_load(snippet)["scrape_configs"]
    assert job["static_configs"] == [{"targets": ["127.0.0.1:9090"]}]
    with_token = yaml.safe_load(re.sub(r"# (?=authorization|  credentials)", "", snippet))
    assert set(with_token["scrape_configs"][0]["authorization"]) == {"credentials_file"}
