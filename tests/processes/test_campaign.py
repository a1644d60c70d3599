"""Fault campaign on the emulated arm: a few seeds, of the kinds of trouble that are cheap, on servos of every kind.

``make campaign`` runs more: ``CAMPAIGN_SEEDS`` says how many, each with the trouble and the servos that it draws.
"""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from robot.emulator.populations import POPULATIONS
from tests.processes.campaign.arm_run import run_arm
from tests.processes.campaign.scenario import Happening, scenario_of

SEEDS = {Happening.UNPLUG: 2, Happening.POWER_CYCLE_ONE: 5, Happening.EMERGENCY_STOP: 14}
RUNS = [
    (Happening.POWER_CYCLE_ONE, "factory"),
    (Happening.EMERGENCY_STOP, "factory"),
    *((Happening.UNPLUG, name) for name in POPULATIONS if name != "factory"),
]


@pytest.mark.parametrize("seed", range(int(os.environ.get("CAMPAIGN_SEEDS", "0"))))
async def test_a_drawn_scenario_finds_no_violation(seed: int, tmp_path: Path) -> None:
    result = await run_arm(scenario_of(seed), tmp_path)
    assert not result.violations, result


@pytest.mark.parametrize(("happening", "population"), RUNS)
async def test_a_seed_of_the_campaign_finds_no_violation(happening: Happening, population: str, tmp_path: Path) -> None:
    result = await run_arm(scenario_of(SEEDS[happening], population), tmp_path)
    assert (result.happening, result.population) == (happening.value, population)
    assert result.writes > 0 or population != "factory"
    assert result.states
    assert not result.violations, result


def test_the_seed_draws_the_servos_and_nothing_else_depends_on_them() -> None:
    drawn = [scenario_of(seed) for seed in range(200)]
    assert {scenario.population for scenario in drawn} == set(POPULATIONS)
    assert replace(drawn[7], population="kit") == scenario_of(7, "kit")
