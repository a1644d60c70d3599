"""A few seeds of the fault campaign, one for each kind of trouble that is cheap; ``make campaign`` runs them all."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.campaign.scenario import Happening
from benchmarks.campaign.seed_run import run_seed

SEEDS = {
    Happening.UNPLUG: 2,
    Happening.POWER_CYCLE_ONE: 5,
    Happening.EMERGENCY_STOP: 14,
}


@pytest.mark.parametrize("happening", SEEDS)
def test_a_seed_of_the_campaign_finds_no_violation(happening: Happening, tmp_path: Path) -> None:
    result = run_seed(SEEDS[happening], tmp_path)
    assert result.happening == happening.value
    assert result.writes
    assert not result.violations
