"""An arm process with its servos, their log and their control socket, for the tests of the server's handle on it."""

import os
import signal
from dataclasses import replace
from pathlib import Path

from harness.server import EmulatorControl, read_write_log
from harness.waiting import TIMEOUT_S, until
from robot.arm import Arm
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmHealth, ArmState, EndState, Mode
from robot.processes import RestartDelay
from robot.trajectory import Trajectory
from tests.helpers.arm_rig import CALIBRATION, CONFIG
from tests.helpers.motions import smooth_move


class ArmOnServos:
    """An arm process with its servos, their log and their control socket."""

    def __init__(
        self,
        folder: Path,
        restart_delay: RestartDelay | None = None,
        on_exit: EndState = EndState.HOLD,
        rate: float = 1.0,
    ) -> None:
        self.log = folder / "writes.jsonl"
        servos = EmulatedConfig(CALIBRATION, write_log=self.log, control=folder / "control", rate=rate)
        self.emulator = EmulatorControl(folder / "control")
        self.states: list[ArmState] = []
        self.health: list[ArmHealth] = []
        config = replace(CONFIG, hardware=servos, on_exit=on_exit)
        self.arm = Arm(config, self.states.append, self.health.append, restart_delay=restart_delay)

    async def start(self) -> None:
        """Start the process and wait until the arm holds."""
        await self.arm.start(TIMEOUT_S)
        await until(lambda: self.arm.state.mode is Mode.HOLDING)

    def kill(self, number: signal.Signals = signal.SIGKILL) -> None:
        """Send a signal to the arm process."""
        assert self.arm.pid is not None
        os.kill(self.arm.pid, number)

    @property
    def pan_rad(self) -> float:
        assert self.arm.state.position_rad is not None
        return float(self.arm.state.position_rad[0])

    def arm_clock_s(self) -> float:
        """Read the time at which the servos last took a write; the event loop need not run."""
        return float(read_write_log(self.log)[-1]["t"])

    def goal_writes(self) -> list[dict[str, list[int]]]:
        return [entry["data"] for entry in read_write_log(self.log) if entry["address"] == 41]


def to(position_rad: float, duration_s: float = 1.0, start_rad: float = 0.0) -> Trajectory:
    return smooth_move({"shoulder_pan": (start_rad, position_rad)}, duration_s)
