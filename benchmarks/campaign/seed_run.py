"""Run of one seed, from the scenario to its result."""

from __future__ import annotations

import asyncio
from pathlib import Path

from benchmarks.campaign.arm_run import run_arm
from benchmarks.campaign.result import Result
from benchmarks.campaign.scenario import OF_SERVER, scenario_of
from benchmarks.campaign.server_run import run_server


def run_seed(seed: int, folder: Path) -> Result:
    """Run one seed; an error of the run itself counts as a violation."""
    scenario = scenario_of(seed)
    run = run_server if scenario.happening in OF_SERVER else run_arm
    try:
        return asyncio.run(run(scenario, folder))
    except Exception as error:  # noqa: BLE001 - whatever it was, the other seeds go on and this one is named
        return Result(seed, scenario.happening.value, violations=[f"the run broke off: {error!r}"])
