"""The arm as the settings describe it: its files, its hardware, and its process's configuration."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from robot.calibration import Calibration, find_calibration
from robot.description import model, robot_folder
from robot.description.camera import Camera
from robot.description.limits import within_calibration
from robot.description.model import RobotModel
from robot.description.servo_table import HardwareTable
from robot.errors import RobotError
from robot.hardware.config import EmulatedConfig, HardwareConfig, IdealConfig, SerialConfig
from robot.hardware.feetech.profiles import ServoProfile, profile_of
from robot.messages import ArmConfig, GuardLimits
from server.config import ArmSettings, EmulatorSettings, Settings
from server.errors import ConfigurationError
from server.moveit.parameters import MoveItParameters

# Longest path of a Unix socket (sun_path in unix(7)), less its final zero.
MAX_SOCKET_PATH_BYTES = 107

# Calibration of servos that need none.
NOMINAL = "nominal"

# Arm of settings that name none.
DEFAULT_ROBOT = "so101"


@dataclass(frozen=True)
class Description:
    """The arm by its files; an ideal arm has no calibration, and a nominal calibration has no file."""

    title: str
    robot: RobotModel
    hardware: HardwareTable
    calibration: Calibration | None
    calibration_file: Path | None = None
    cameras: Mapping[str, Camera] = field(default_factory=dict)

    @classmethod
    def read(cls, settings: ArmSettings) -> Description:
        """Read the files named in the settings, or the built-in arm's files.

        A URDF alone means an ideal arm: only a robot's folder, a serial port or a calibration say that it has servos.
        Raises ConfigurationError for a file that cannot be used, or that the arm has no use for.
        """
        try:
            alone = settings.robot is None and settings.serial is None and settings.calibration is None
            if alone and settings.urdf is not None and settings.srdf is not None:
                robot = model.load(settings.urdf, settings.srdf, settings.package_path)
                _refuse_servo_settings(settings, robot.name)
                return cls(robot.name, robot, HardwareTable(), None)
            return cls._of_folder(settings)
        except RobotError as error:
            raise ConfigurationError(str(error)) from error

    @classmethod
    def _of_folder(cls, settings: ArmSettings) -> Description:
        found = robot_folder.resolve(
            settings.robot or DEFAULT_ROBOT,
            urdf=settings.urdf,
            srdf=settings.srdf,
            package_directories=settings.package_path,
        )
        hardware = found.hardware
        if hardware.kind == "ideal":
            _refuse_servo_settings(settings, found.title)
            return cls(found.title, found.model, hardware, None, cameras=found.cameras)
        named, file = settings.calibration, None
        if named is not None and str(named) != NOMINAL:
            file = find_calibration(str(named), hardware.calibrations, os.environ)
        read = Calibration.nominal(hardware.servos) if file is None else Calibration.load(file, hardware.servos)
        calibration = replace(read, measured=named is not None).with_zero_offsets(settings.zero_offset_rad)
        return cls(
            found.title, within_calibration(found.model, calibration), hardware, calibration, file, found.cameras
        )


def arm_config(settings: Settings, description: Description) -> ArmConfig:
    """Make the arm process's configuration; raises ConfigurationError for a setting that this arm cannot use."""
    arm = settings.arm
    return ArmConfig(
        robot=description.robot,
        hardware=_hardware(settings, description),
        state_rate_hz=arm.joint_state_rate_hz,
        start_enabled=arm.start_enabled,
        watchdog_s=arm.watchdog_s,
        on_server_lost=arm.on_server_lost,
        on_exit=arm.on_exit,
        on_emergency_stop=arm.on_emergency_stop,
        guard_limits=GuardLimits(
            warn_temperature_c=arm.warn_temperature_c,
            slow_temperature_c=arm.slow_temperature_c,
            stop_temperature_c=arm.stop_temperature_c,
            **arm.guards.model_dump(),
        ),
        speed_limit=arm.speed_limit,
    )


def _hardware(settings: Settings, description: Description) -> HardwareConfig:
    emulator, physics, rate = settings.emulator, settings.simulation.kind == "physics", settings.simulation.rate
    if physics and settings.arm.serial is None and importlib.util.find_spec("mujoco") is None:
        raise ConfigurationError("simulation.kind: physics needs MuJoCo: pip install 'armbridge[physics]'")
    kind = description.hardware.kind
    if description.calibration is None or kind == "ideal":
        no_bus = "the ideal arm (by its robot.toml, or by arm.urdf alone) has no servo bus that"
        _refuse_options(emulator, EmulatorSettings.model_fields, no_bus)
        driven = settings.arm.start_enabled
        return IdealConfig(settings.arm.ideal_lag_s, driven=driven, physics=physics, rate=rate)
    profile = _profile(description) if kind == "feetech" else None
    if settings.arm.serial is not None:
        baud = description.hardware.baud
        return SerialConfig(description.calibration, settings.arm.serial, kind, baud, profile=profile)
    if kind != "feetech":
        nothing = f"emulated {kind.capitalize()} servos have nothing that"
        _refuse_options(emulator, ("write_log", "control", "population"), nothing)
    if emulator.write_log is not None:
        _check_place("emulator.write_log", emulator.write_log)
    if emulator.control is not None:
        _check_socket(emulator.control)
    return EmulatedConfig(
        description.calibration,
        kind=kind,
        profile=profile,
        # Nothing can jump or fall when it is switched on: the half second that this takes is for real arms.
        driven=settings.arm.start_enabled,
        physics=physics,
        rate=rate,
        **emulator.model_dump(),
    )


def _profile(description: Description) -> ServoProfile | None:
    try:
        return profile_of(description.hardware.profile)
    except RobotError as error:
        raise ConfigurationError(str(error)) from error


def _refuse_servo_settings(settings: ArmSettings, title: str) -> None:
    if settings.zero_offset_rad:
        joint = next(iter(settings.zero_offset_rad))
        raise ConfigurationError(
            f"arm.zero_offset_rad.{joint}: the ideal arm has no servos whose zero could be trimmed; name the arm's "
            "robot (arm.robot), port (arm.serial) or calibration (arm.calibration)"
        )
    for key, value in (("serial", settings.serial), ("calibration", settings.calibration)):
        if value is not None:
            raise ConfigurationError(
                f"arm.{key}: {title} is an ideal arm: its robot.toml names no servos that {str(value)!r} could apply to"
            )


def _refuse_options(emulator: EmulatorSettings, names: Iterable[str], reason: str) -> None:
    default = EmulatorSettings()
    for name in names:
        if (value := getattr(emulator, name)) != getattr(default, name):
            value = str(value) if isinstance(value, Path) else value
            raise ConfigurationError(f"emulator.{name}: {reason} {value!r} could apply to")


def _check_place(setting: str, path: Path) -> None:
    if path.is_dir():
        raise ConfigurationError(f"{setting}: {path} is a directory")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"{setting}: {path.parent} is no directory that this user may write to")


def _check_socket(path: Path) -> None:
    _check_place("emulator.control", path)
    length = len(os.fsencode(path))
    if length > MAX_SOCKET_PATH_BYTES:
        raise ConfigurationError(
            f"emulator.control: the path of a Unix socket has at most {MAX_SOCKET_PATH_BYTES} bytes, not {length}"
        )
    if path.exists() and not path.is_socket():
        raise ConfigurationError(f"emulator.control: {path} exists, and is no socket")


def check_parameters(parameters: MoveItParameters, robot: RobotModel) -> None:
    """Raise ConfigurationError for a group, link or frame that the robot does not have."""
    group, link = parameters.group_name, parameters.end_effector_link
    frame = parameters.planning_frame.lstrip("/")
    if group and group not in robot.groups:
        raise ConfigurationError(
            f"moveit.group_name: there is no group {group!r}; the SRDF has {', '.join(robot.groups)}"
        )
    if link and link not in robot.links:
        raise ConfigurationError(
            f"moveit.end_effector_link: there is no link {link!r}; the URDF has {', '.join(robot.links)}"
        )
    if frame and frame != robot.root_link:
        raise ConfigurationError(f"moveit.planning_frame: must be the root link {robot.root_link!r}, not {frame!r}")
