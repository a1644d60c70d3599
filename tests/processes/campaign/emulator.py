"""The emulated bus of one run: a process with live commands, and its log of every write."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from harness.emulator import RunningEmulator
from harness.write_log import Entry, read_entries
from robot.hardware.interface import StatusFlag
from tests.processes.campaign.scenario import NAMES, START_RAD, Scenario, calm


@dataclass
class CampaignBus:
    """A running emulator.

    Attributes:
        port: name under which the adapter is found again after it was unplugged.
    """

    emulator: RunningEmulator
    log: Path
    port: str

    def tell(self, command: Mapping[str, object]) -> None:
        """Send one live command."""
        answer = self.emulator.command(**command)
        if "error" in answer:
            raise ValueError(str(answer["error"]))

    def strike(self, scenario: Scenario) -> None:
        """Start the scenario's faults on the wire."""
        if scenario.wire:
            self.tell(scenario.wire)

    def calm(self, scenario: Scenario) -> None:
        """End every fault; an overload that stays latched otherwise needs the supply off and on."""
        for command in calm(scenario.servos):
            self.tell(command)
        overloaded = any(status & StatusFlag.OVERLOAD for status in self.entries()[-1].status.values())
        if scenario.servos.overload_latches and overloaded:
            self.tell({"power_cycle": NAMES})

    def entries(self) -> list[Entry]:
        """Return the log up to now; its last entry has the present state of the servos."""
        self.tell({})
        return read_entries(self.log)


@contextmanager
def campaign_bus(scenario: Scenario, folder: Path) -> Iterator[CampaignBus]:
    """Start an emulator for a run; its log stays in the folder."""
    # The link bears the process's id: one seed run twice at a time in one folder must not meet on one bus.
    log, link = folder / f"seed-{scenario.seed}.jsonl", folder / f"bus-{scenario.seed}-{os.getpid()}"
    start = ",".join(str(position) for position in START_RAD)
    files = "--write-log", str(log), "--link", str(link)
    emulator = RunningEmulator(
        *files, f"--start={start}", "--seed", str(scenario.seed), "--population", scenario.population
    )
    try:
        yield CampaignBus(emulator, log, str(link))
    finally:
        emulator.end()
