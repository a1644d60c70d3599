"""A few seeds of the fault campaign, one for each kind of trouble that is cheap; ``make campaign`` runs them all."""

from dataclasses import replace
from pathlib import Path

import pytest

from robot.emulator.populations import POPULATIONS
from tests.processes.campaign.__main__ import run_seed
from tests.processes.campaign.scenario import Happening, scenario_of

SEEDS = {
    Happening.UNPLUG: 2,
    Happening.POWER_CYCLE_ONE: 5,
    Happening.EMERGENCY_STOP: 14,
}


@pytest.mark.parametrize("happening", SEEDS)
def test_a_seed_of_the_campaign_finds_no_violation(happening: Happening, tmp_path: Path) -> None:
    result = run_seed(SEEDS[happening], tmp_path, "factory")
    assert result.happening == happening.value
    assert result.writes
    assert not result.violations


@pytest.mark.parametrize("population", [name for name in POPULATIONS if name != "factory"])
def test_a_seed_of_the_campaign_finds_no_violation_on_other_servos(population: str, tmp_path: Path) -> None:
    result = run_seed(SEEDS[Happening.UNPLUG], tmp_path, population)
    assert result.population == population
    assert result.states
    assert not result.violations


def test_the_seed_draws_the_servos_and_nothing_else_depends_on_them() -> None:
    drawn = [scenario_of(seed) for seed in range(200)]
    assert {scenario.population for scenario in drawn} == set(POPULATIONS)
    assert replace(drawn[7], population="kit") == scenario_of(7, "kit")
