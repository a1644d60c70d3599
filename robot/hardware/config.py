"""Descriptions of an arm's hardware, as the server gives them to the arm process."""

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
        calibration: servos of the joints, whose order is that of every array.
        port: serial device, ``socket://host:port``, USB id or ``auto``.
    """

    simulated: ClassVar[bool] = False

    calibration: Calibration
    port: str

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        """Joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, _position_rad: Mapping[str, float], *, driven: bool) -> FeetechConfig:  # noqa: ARG002 - see below
        """The same: servos stay where they are when the process that drives them ends."""
        return self


@dataclass(frozen=True)
class EmulatedConfig:
    """Feetech servos emulated inside the arm process.

    Attributes:
        calibration: as of :class:`FeetechConfig`; its ranges are the joints' mechanical stops.
        drop: probability that a reply is lost.
        corrupt: probability that a reply has a wrong byte.
        seed: of these faults.
        write_log: file that gets a line of JSON for every write to a servo.
        control: path of a Unix socket that takes the emulator's live commands (:mod:`robot.emulator.control`).
        start_rad: joint -> position at the start [rad]; joints not named start at 0.
        driven: whether the servos start with torque on, as an arm process leaves them.
        resumes: whether the servos were there before, in an arm process that has ended.
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
        """Joints that have a servo."""
        return tuple(joint.joint for joint in self.calibration.joints)

    def resumed(self, position_rad: Mapping[str, float], *, driven: bool) -> EmulatedConfig:
        """Servos as an arm process that has ended left them: real ones would have stayed.

        Args:
            position_rad: joint -> position that the process told last [rad]; those it did not tell stay.
            driven: whether their torque was on.
        """
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven, resumes=True)


@dataclass(frozen=True)
class IdealConfig:
    """Joints without actuators: they follow their goals.

    Attributes:
        lag_s: time constant with which they do [s]; 0 follows within one tick.
        start_rad: as of :class:`EmulatedConfig`; a joint whose range excludes 0 starts at its nearer limit.
        driven: as of :class:`EmulatedConfig`.
    """

    simulated: ClassVar[bool] = True
    port: ClassVar[str] = "ideal"

    lag_s: float = 0.03
    start_rad: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False

    def joint_names(self, robot: RobotModel) -> tuple[str, ...]:
        """Every movable joint of the robot."""
        return tuple(joint.name for joint in robot.movable_joints)

    def resumed(self, position_rad: Mapping[str, float], *, driven: bool) -> IdealConfig:
        """Joints as an arm process that has ended left them; see :meth:`EmulatedConfig.resumed`."""
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven)


HardwareConfig: TypeAlias = FeetechConfig | EmulatedConfig | IdealConfig
