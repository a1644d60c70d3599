"""Configuration of an arm's hardware, one class for each kind."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple, Self, TypeAlias

from robot.calibration import Calibration
from robot.description.model import RobotModel
from robot.description.servo_table import ServoKind
from robot.hardware.feetech.profiles import ServoProfile


class ClockReading(NamedTuple):
    """Reading of a simulated arm's clock."""

    now_s: float  # time [s]
    stamp_s: float  # stamp of that time [s since the epoch]


@dataclass(frozen=True)
class _ServosConfig:
    calibration: Calibration  # servos of the joints, in the order of every array

    def joint_names(self, _robot: RobotModel) -> tuple[str, ...]:
        return tuple(joint.joint for joint in self.calibration.joints)


@dataclass(frozen=True)
class SerialConfig(_ServosConfig):
    """Servos on a serial port."""

    simulated: ClassVar[bool] = False
    stays_at_rest: ClassVar[bool] = False
    physics: ClassVar[bool] = False
    rate: ClassVar[float] = 1.0

    port: str  # serial device, ``socket://host:port``, USB id or ``auto``
    kind: ServoKind = "feetech"
    baud: int = 1_000_000  # bits per second
    profile: ServoProfile | None = None  # settings that Feetech's should have; None for the nearest known profile

    def resumed(self, _position_rad: Mapping[str, float], _clock: ClockReading | None = None, *, driven: bool) -> Self:
        """Return the same: servos stay where they are when the arm process ends."""
        return self


@dataclass(frozen=True, kw_only=True)
class _SimulatedConfig:
    simulated: ClassVar[bool] = True

    # Joint -> position at the start [rad]; joints not named start at 0, or at the limit nearest to it.
    start_rad: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False  # True if the joints start with torque on, as an arm process leaves them
    physics: bool = False  # True if MuJoCo moves the joints (:mod:`robot.physics`)
    rate: float = 1.0  # arm's time per machine's time
    clock: ClockReading | None = None  # its clock at the start; None for the machine's

    def resumed(self, position_rad: Mapping[str, float], clock: ClockReading | None = None, *, driven: bool) -> Self:
        """Return the joints at the positions that an arm process reported last [rad]: real ones would have stayed.

        A clock that is not the machine's goes on from its last reading.
        """
        clock = None if self.rate == 1.0 else clock
        return replace(self, start_rad={**self.start_rad, **position_rad}, driven=driven, clock=clock)


@dataclass(frozen=True)
class EmulatedConfig(_SimulatedConfig, _ServosConfig):
    """Servos emulated inside the arm process; the calibration's ranges are the joints' mechanical stops."""

    port: ClassVar[str] = "simulated"  # name in place of a port

    kind: ServoKind = "feetech"
    drop: float = 0.0  # probability that a reply is lost
    corrupt: float = 0.0  # probability that a reply has a wrong byte
    seed: int = 0  # seed of these faults
    resumes: bool = False  # True if the servos existed before, in an arm process that has ended
    # Of Feetech's alone: settings that they should have, None for the nearest known profile.
    profile: ServoProfile | None = None
    population: str = "factory"  # state in which they are found (:mod:`robot.emulator.populations`)
    write_log: Path | None = None  # log file with a line of JSON for every write to a servo; None for no log
    control: Path | None = None  # Unix socket for the emulator's live commands (:mod:`robot.emulator.control`)

    @property
    def stays_at_rest(self) -> bool:
        """True for servos that at rest have nothing to see: no lost replies, no commands to them, and no contact."""
        lossless = self.kind == "feetech" and not self.drop and not self.corrupt
        return lossless and self.control is None and not self.physics

    def resumed(self, position_rad: Mapping[str, float], clock: ClockReading | None = None, *, driven: bool) -> Self:
        """Return the servos as an arm process that has ended left them."""
        return replace(super().resumed(position_rad, clock, driven=driven), resumes=True)


@dataclass(frozen=True)
class IdealConfig(_SimulatedConfig):
    """Joints without actuators, which follow their goals."""

    port: ClassVar[str] = "ideal"  # name in place of a port
    lag_s: float = 0.03  # time constant with which they follow [s]; 0 follows within one tick

    @property
    def stays_at_rest(self) -> bool:
        """True for joints that nothing touches."""
        return not self.physics

    def joint_names(self, robot: RobotModel) -> tuple[str, ...]:
        return tuple(joint.name for joint in robot.movable_joints)


HardwareConfig: TypeAlias = SerialConfig | EmulatedConfig | IdealConfig
SIMULATED_PORTS = frozenset({EmulatedConfig.port, IdealConfig.port})  # names of their ports
