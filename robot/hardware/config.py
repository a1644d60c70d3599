"""Configuration of an arm's hardware, one class for each kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, TypeAlias

from robot.calibration import Calibration
from robot.description.model import RobotModel


@dataclass(frozen=True)
class FeetechConfig:
    """Feetech servos on a serial port.

    Attributes:
        simulated: False.
        calibration: servos of the joints, whose order is that of every array.
        port: serial device, ``socket://host:port``, USB id or ``auto``.
    """

    simulated: ClassVar[bool] = False

    calibration: Calibration
    port: str

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        """Return the joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, _position_rad: Mapping[str, float], *, driven: bool) -> FeetechConfig:  # noqa: ARG002 - see below
        """Return the same: servos stay where they are when the arm process ends."""
        return self


@dataclass(frozen=True)
class EmulatedConfig:
    """Feetech servos emulated inside the arm process.

    Attributes:
        simulated: True.
        port: name in place of a port.
        calibration: as of :class:`FeetechConfig`; its ranges are the joints' mechanical stops.
        drop: probability that a reply is lost.
        corrupt: probability that a reply has a wrong byte.
        seed: seed of these faults.
        write_log: log file with a line of JSON for every write to a servo; None for no log.
        control: path of a Unix socket for the emulator's live commands (:mod:`robot.emulator.control`).
        start_rad: joint -> position at the start [rad]; joints not named start at 0.
        driven: True if the servos start with torque on, as an arm process leaves them.
        resumes: True if the servos existed before, in an arm process that has ended.
    """

    simulated: ClassVar[bool] = True
    port: ClassVar[str] = "simulated"

    calibration: Calibration
    drop: float = 0.0
    corrupt: float = 0.0
    seed: int = 0
    write_log: Path | None = None
    control: Path | None = None
    start_rad: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False
    resumes: bool = False

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        """Return the joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, position_rad: Mapping[str, float], *, driven: bool) -> EmulatedConfig:
        """Return the servos as an arm process that has ended left them: real ones would have stayed.

        Args:
            position_rad: joint -> position that the process reported last [rad]; other joints keep their start.
            driven: True if their torque was on.
        """
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven, resumes=True)


@dataclass(frozen=True)
class DynamixelConfig:
    """Dynamixel servos of the X series on a serial port.

    Attributes:
        simulated: False.
        calibration: servos of the joints, whose order is that of every array.
        port: serial device, ``socket://host:port``, or USB id.
        baud: bits per second.
    """

    simulated: ClassVar[bool] = False

    calibration: Calibration
    port: str
    baud: int = 1_000_000

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        """Return the joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, _position_rad: Mapping[str, float], *, driven: bool) -> DynamixelConfig:  # noqa: ARG002 - likewise
        """Return the same: servos stay where they are when the arm process ends."""
        return self


@dataclass(frozen=True)
class EmulatedDynamixelConfig:
    """Dynamixel servos emulated inside the arm process.

    Attributes:
        simulated: True.
        port: name in place of a port.
        calibration: as of :class:`DynamixelConfig`; its ranges are the joints' mechanical stops.
        drop: probability that a reply is lost.
        corrupt: probability that a reply has a wrong byte.
        seed: seed of these faults.
        start_rad: joint -> position at the start [rad]; joints not named start at 0.
        driven: True if the servos start with torque on, as an arm process leaves them.
    """

    simulated: ClassVar[bool] = True
    port: ClassVar[str] = "simulated"

    calibration: Calibration
    drop: float = 0.0
    corrupt: float = 0.0
    seed: int = 0
    start_rad: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        """Return the joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, position_rad: Mapping[str, float], *, driven: bool) -> EmulatedDynamixelConfig:
        """Return the servos as an arm process that has ended left them; see :meth:`EmulatedConfig.resumed`."""
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven)


@dataclass(frozen=True)
class IdealConfig:
    """Joints without actuators, which follow their goals.

    Attributes:
        simulated: True.
        port: name in place of a port.
        lag_s: time constant with which they follow [s]; 0 follows within one tick.
        start_rad: as of :class:`EmulatedConfig`; a joint whose range excludes 0 starts at its nearer limit.
        driven: as of :class:`EmulatedConfig`.
    """

    simulated: ClassVar[bool] = True
    port: ClassVar[str] = "ideal"

    lag_s: float = 0.03
    start_rad: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False

    def joint_names(self, robot: RobotModel) -> tuple[str, ...]:
        """Return every movable joint of the robot."""
        return tuple(joint.name for joint in robot.movable_joints)

    def resumed(self, position_rad: Mapping[str, float], *, driven: bool) -> IdealConfig:
        """Return the joints as an arm process that has ended left them; see :meth:`EmulatedConfig.resumed`."""
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven)


HardwareConfig: TypeAlias = FeetechConfig | EmulatedConfig | DynamixelConfig | EmulatedDynamixelConfig | IdealConfig
"""Hardware interface of an arm: servos of Feetech or Dynamixel, on a serial port or emulated, and the ideal arm."""
