"""One servo that may be driven a little: the safe surroundings of an experiment."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, Telemetry, goal_block
from robot.hardware.feetech.transactions import write_verified
from robot.hardware.interface import StatusFlag
from robot.hardware.steps import run_to_end
from robot.service.scan import read_telemetry

# Register TORQUE_LIMIT during experiments [0.1 %]: a finger stops the gripper.
GENTLE_TORQUE = 200

# A step that can be seen in the readings and harms nothing; torque comes on no further than this from the goal.
STEP_TICKS = 25
STEP_TICKS_S = 300
STEP_S = 0.4

# How long a person has to cut the power, and to bring it back.
POWER_TIMEOUT_S = 60.0
POWER_POLL_S = 0.1


@dataclass(frozen=True)
class Bench:
    """What experiments work with.

    Every method raises NoReply, StartupError or PortLost when the servo does not do as it is told.

    Attributes:
        bus: an open bus.
        servo_id: the servo whose torque may be switched.
        present_ids: all servos that answer.
        clock: monotonic time [s].
        wait: waits for so long [s].
    """

    bus: Bus
    servo_id: int
    present_ids: tuple[int, ...]
    clock: Callable[[], float] = time.monotonic
    wait: Callable[[float], None] = time.sleep

    def read(self, register: Register) -> int:
        """Read a register of the servo."""
        return self.bus.read(self.servo_id, register)

    def telemetry(self) -> Telemetry:
        """Read what the servo measures."""
        return read_telemetry(self.bus, self.servo_id)

    def set(self, register: Register, value: int) -> None:
        """Write a register of the servo, and see that it has it."""
        run_to_end(write_verified(self.bus, self.servo_id, register, value), self.wait)

    def set_goal(self, goal_ticks: int) -> None:
        """Set the servo's goal, to be approached slowly, and see that it has it."""
        self.bus.sync_write(GOAL_ADDRESS, {self.servo_id: goal_block(goal_ticks, STEP_TICKS_S)})
        self.set(Register.GOAL_POSITION, goal_ticks)

    def require_relaxed(self) -> None:
        """Refuse a servo that holds something; an overloaded one is relaxed."""
        if self.read(Register.STATUS) & StatusFlag.OVERLOAD:
            self.set(Register.TORQUE_ENABLE, 0)
        elif self.read(Register.TORQUE_ENABLE):
            raise StartupError(f"servo {self.servo_id} holds: relax the arm first (armbridge relax)")

    @contextlib.contextmanager
    def holding(self, goal_ticks: int | None = None) -> Iterator[int]:
        """Torque on, gently, for the length of the block, and off whatever happens in it.

        Args:
            goal_ticks: goal at torque on, at most STEP_TICKS away; None for the present position.

        Yields:
            The goal [ticks].
        """
        self.require_relaxed()
        torque_limit = self.read(Register.TORQUE_LIMIT)
        start = self._start()
        goal = start if goal_ticks is None else goal_ticks
        if abs(goal - start) > STEP_TICKS:
            raise StartupError(f"servo {self.servo_id} was moved from {goal} to {start} ticks meanwhile")
        try:
            self.set(Register.TORQUE_LIMIT, GENTLE_TORQUE)
            self.set_goal(goal)
            self.set(Register.TORQUE_ENABLE, 1)
            yield goal
        finally:
            self.set(Register.TORQUE_ENABLE, 0)
            self.set(Register.TORQUE_LIMIT, torque_limit)

    def one_step_from(self, ticks: int) -> int:
        """A goal that is STEP_TICKS away, towards the middle of the servo's range."""
        middle = (self.read(Register.MIN_ANGLE_LIMIT) + self.read(Register.MAX_ANGLE_LIMIT)) // 2
        return ticks + (STEP_TICKS if ticks < middle else -STEP_TICKS)

    def go(self, goal_ticks: int) -> list[tuple[float, Telemetry]]:
        """Go to a goal; returns what was measured on the way, with the time since the goal was set [s]."""
        self.set_goal(goal_ticks)
        start_s = self.clock()
        samples: list[tuple[float, Telemetry]] = []
        while (at_s := self.clock() - start_s) < STEP_S or not samples:
            samples.append((at_s, self.telemetry()))
        return samples

    def await_answers(self, *, answering: bool) -> bool:
        """Wait until the servo answers, or until it does not; False if that does not come in time."""
        until_s = self.clock() + POWER_TIMEOUT_S
        while self.clock() < until_s:
            if self._answers() is answering:
                return True
            self.wait(POWER_POLL_S)
        return False

    def _start(self) -> int:
        start = self.telemetry().position_ticks
        lowest, highest = self.read(Register.MIN_ANGLE_LIMIT), self.read(Register.MAX_ANGLE_LIMIT)
        if not lowest <= start <= highest:
            raise StartupError(
                f"servo {self.servo_id} stands at {start} ticks, outside its angle limits {lowest} to {highest}"
            )
        return start

    def _answers(self) -> bool:
        with contextlib.suppress(NoReply):
            self.read(Register.TORQUE_ENABLE)
            return True
        return False
