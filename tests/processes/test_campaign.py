"""Fault campaign on the emulated arm: a few seeds, one for each kind of trouble that is cheap.

``make campaign`` runs more: ``CAMPAIGN_SEEDS`` says how many, each with the trouble and the servos that it draws.
"""

import asyncio
import os
from dataclasses import replace
from pathlib import Path

import pytest

from robot.emulator.populations import POPULATIONS
from tests.processes.campaign.arm_run import run_arm
from tests.processes.campaign.scenario import Happening, Result, scenario_of

SEEDS = {Happening.UNPLUG: 2, Happening.POWER_CYCLE_ONE: 5, Happening.EMERGENCY_STOP: 14}


def run_seed(seed: int, folder: Path, population: str | None = None) -> Result:
    return asyncio.run(run_arm(scenario_of(seed, population), folder))


@pytest.mark.parametrize("seed", range(int(os.environ.get("CAMPAIGN_SEEDS", "0"))))
def test_a_drawn_scenario_finds_no_violation(seed: int, tmp_path: Path) -> None:
    result = run_seed(seed, tmp_path)
    assert not result.violations, result


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
