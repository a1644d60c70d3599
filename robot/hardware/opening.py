"""Hardware sources: from an arm's configuration to its open hardware."""

from __future__ import annotations

from typing import Protocol

from robot.description.limits import JointBounds
from robot.hardware.clock import LoopClock
from robot.hardware.config import EmulatedConfig, FeetechConfig, IdealConfig
from robot.hardware.interface import HardwareInterface
from robot.messages import ArmConfig


class HardwareSource(Protocol):
    """Source of hardware, which can be opened again when it was lost."""

    def open(self) -> HardwareInterface:
        """Open the hardware.

        Raises:
            RobotError: it is missing or cannot be used.
        """


def hardware_source(config: ArmConfig, clock: LoopClock) -> HardwareSource:
    """Build the source of an arm's hardware; a back end's libraries are imported only where it is used.

    Args:
        config: configuration of the arm.
        clock: time of the control loop.

    Raises:
        OSError: the log or the control socket of emulated servos cannot be created.
    """
    joint_names = config.hardware.joint_names(config.robot)
    bounds = JointBounds.of(config.robot, joint_names)
    match config.hardware:
        case FeetechConfig():
            from robot.hardware.feetech.hardware import SerialServos

            return SerialServos(config.hardware, bounds, config.guard_limits, clock)
        case EmulatedConfig():
            from robot.emulator.in_process import EmulatedServos

            return EmulatedServos(config.hardware, bounds, config.guard_limits, clock)
        case IdealConfig():
            from robot.hardware.ideal import IdealArm

            return IdealArm(config.hardware, joint_names, bounds, clock)
