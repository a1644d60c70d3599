"""Main loop of the arm process: opens the hardware, ticks 100 times a second, and passes on the server's messages."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from robot.channel import Channel, channel_of_child, leave_signals_to_server, send_log
from robot.control.pacing import MAX_TICK_S, LoopClock, Pacer, Scheduling, SimulationClock, enter_realtime
from robot.control.supervisor import FIRST_RETRY_S, LONGEST_RETRY_S, Supervisor
from robot.description.limits import JointBounds
from robot.errors import RobotError, StartupError
from robot.hardware.config import EmulatedConfig, IdealConfig, SerialConfig
from robot.hardware.interface import HardwareInterface
from robot.messages import ArmConfig, Command, Execute, Order, Stop, checked
from robot.trajectory import PERIOD_S


def hardware_opener(config: ArmConfig, clock: LoopClock) -> Callable[[], HardwareInterface]:
    """Build the function that opens an arm's hardware, again when it was lost, and import no other back end.

    Raises OSError for the log or socket of emulated servos; the function raises a RobotError for hardware that is
    missing or cannot be used.
    """
    joint_names = config.hardware.joint_names(config.robot)
    bounds = JointBounds.of(config.robot, joint_names)
    limits = config.guard_limits
    match config.hardware:
        case SerialConfig():
            from robot.hardware.servos.hardware import family_of, open_servos

            family = family_of(config.hardware.kind, config.hardware.profile)
            return partial(open_servos, family, config.hardware, bounds, limits, clock)
        case EmulatedConfig(kind="feetech"):
            from robot.emulator.feetech import emulated_feetech_arm

            return emulated_feetech_arm(config.robot, config.hardware, bounds, limits, clock).open
        case EmulatedConfig():
            from robot.emulator.dynamixel import emulated_dynamixel_arm

            return emulated_dynamixel_arm(config.robot, config.hardware, bounds, limits, clock).open
        case IdealConfig(physics=True):
            from robot.physics.ideal_arm import PhysicalArm

            physical = PhysicalArm(config.robot, config.hardware, joint_names, bounds, clock)
            return lambda: physical
        case IdealConfig():
            from robot.hardware.ideal import IdealArm

            ideal = IdealArm(config.hardware, joint_names, bounds, clock)
            return lambda: ideal


# A step of a sequence is a transaction of 1 to 2 ms; when less time is left until the tick, only the first is taken.
STEP_ROOM_S = 0.002

# Messages that change the goals of an arm: a tick comes sooner.
_PROMPT = (Execute, Stop, Command)

# Goals on a path differ from goals on the path that it leaves so long after, at the jerk of a policy's motions [s].
PARTED_S = 0.0025


def _prompt_from_s(message: Execute | Stop | Command) -> float:
    """Return the monotonic time from which a tick changes goals by a message [s]; 0 for at once."""
    continues = message.continues if isinstance(message, Execute) else None
    return 0.0 if continues is None else continues.leaves_s + PARTED_S


class ArmLoop:
    """Control loop of one arm."""

    def __init__(self, channel: Channel, config: ArmConfig, scheduling: Scheduling) -> None:
        self._channel = channel
        self._config = config
        self._simulated = config.hardware.simulated
        hardware, now_s = config.hardware, time.monotonic()
        self._clock = (
            LoopClock() if isinstance(hardware, SerialConfig) else SimulationClock(now_s, hardware.rate, hardware.clock)
        )
        self._opener: Callable[[], HardwareInterface] | None = None
        self._supervisor = Supervisor(config, channel.send, self._clock, scheduling)

    def run(self) -> None:
        """Run until the end; hardware that cannot be opened is retried."""
        retry_s = FIRST_RETRY_S
        while not self._supervisor.finished():
            try:
                with contextlib.closing(self._open()) as hardware:
                    self._supervisor.connect(hardware)
                    retry_s = FIRST_RETRY_S
                    self._drive()
            except RobotError as error:
                self._supervisor.disconnect(str(error))
                self._wait(retry_s)
                retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)

    def _open(self) -> HardwareInterface:
        if self._opener is None:
            try:
                self._opener = hardware_opener(self._config, self._clock)
            except OSError as error:
                raise StartupError(f"the emulated servos cannot be made: {error}") from error
        return self._opener()

    def _drive(self) -> None:
        pacer = Pacer(time.monotonic())
        while not self._supervisor.finished():
            skipped = self._between_ticks(pacer)
            now_s = time.monotonic()
            pacer.start_tick(now_s, self._clock.rate)
            self._clock.start_tick(now_s, MAX_TICK_S + skipped * PERIOD_S)
            self._supervisor.tick(pacer, ticks=1 + skipped, server_gone=self._channel.closed)

    def _between_ticks(self, pacer: Pacer) -> int:
        """Handle the server's messages, and do steps of orders, until the tick is due; return the skipped ticks."""
        skipped = self._supervisor.spare_ticks
        pacer.skip(skipped)
        if pacer.deadline_s - time.monotonic() <= STEP_ROOM_S:
            self._handle(self._channel.receive(0.0))
            # A starved arm must relax all the same: its sequences get a step a tick, though that makes the tick later.
            self._supervisor.work()
        while (remaining_s := pacer.deadline_s - time.monotonic()) > 0.0:
            idle_s = remaining_s
            if remaining_s > STEP_ROOM_S and (wait_s := self._supervisor.work()) < remaining_s:
                # The clock of a simulated arm stands still until the tick, and so does a wait on it.
                idle_s = remaining_s if self._simulated and wait_s > 0.0 else wait_s
            messages: list[Any] = []
            if self._channel.closed:
                time.sleep(max(0.0, idle_s))
            else:
                messages = self._channel.receive(idle_s)
                self._handle(messages)
            if (spare := self._supervisor.spare_ticks) < skipped:
                pacer.cancel_skip(skipped - spare, time.monotonic())
                skipped = spare
            if prompt_s := [_prompt_from_s(message) for message in messages if isinstance(message, _PROMPT)]:
                pacer.bring_forward(max(time.monotonic(), min(prompt_s)))
        return skipped

    def _handle(self, messages: list[Any]) -> None:
        urgent = [each for each in messages if isinstance(each, Command) and each.order is Order.EMERGENCY_STOP]
        for message in sorted(messages, key=lambda each: each not in urgent):
            self._supervisor.handle(message)

    def _wait(self, wait_s: float) -> None:
        until_s = time.monotonic() + wait_s
        while not self._supervisor.finished() and (remaining_s := until_s - time.monotonic()) > 0.0:
            if self._channel.closed:
                self._supervisor.lose_server()
            else:
                self._handle(self._channel.receive(remaining_s))


def main() -> None:
    """Be the arm process of the server that has started this one."""
    run_arm(channel_of_child())


def run_forked(sock: socket.socket) -> None:
    """Be the arm process of the server that has forked this one."""
    leave_signals_to_server()
    channel = Channel(sock)
    send_log(channel, __name__)
    run_arm(channel)


def run_arm(channel: Channel) -> None:
    """Run an arm until its server ends it."""
    config = channel.receive_first()
    if config is not None:
        ArmLoop(channel, checked(config), enter_realtime(config.hardware.rate)).run()


if __name__ == "__main__":
    main()
