"""Run of one seed, from the scenario to its result."""

from __future__ import annotations

import asyncio
from pathlib import Path

from tests.processes.campaign.arm_run import run_arm, run_refused
from tests.processes.campaign.result import Result
from tests.processes.campaign.scenario import OF_SERVER, REFUSED, scenario_of
from tests.processes.campaign.server_run import run_server


def run_seed(seed: int, folder: Path, population: str | None = None) -> Result:
    """Run one seed; an error of the run itself counts as a violation.

    Args:
        seed: number of the run.
        folder: takes the log of the servos.
        population: state in which the servos are found; None for the one that the seed draws.
    """
    scenario = scenario_of(seed, population)
    run = run_server if scenario.happening in OF_SERVER else run_arm
    if scenario.population in REFUSED:
        run = run_refused
    try:
        return asyncio.run(run(scenario, folder))
    except Exception as error:  # noqa: BLE001 - whatever it was, the other seeds go on and this one is named
        violations = [f"the run broke off: {error!r}"]
        return Result(seed, scenario.happening.value, scenario.population, violations=violations)
