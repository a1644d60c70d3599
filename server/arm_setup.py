"""The arm as the settings describe it: its files, its calibration, and what its process has to know."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from robot import model
from robot.calibration import Calibration
from robot.calibration_files import find_calibration
from robot.errors import RobotError
from robot.limits import within_calibration
from robot.messages import ArmConfig
from robot.model import RobotModel
from server.config import ArmSettings
from server.errors import ConfigurationError
from server.moveit.parameters import MoveItParameters


@dataclass(frozen=True)
class Description:
    """The arm by its files: the robot within its calibration.

    Attributes:
        calibration_file: where the calibration was read; None for that of an ideal arm.
    """

    robot: RobotModel
    calibration: Calibration
    calibration_file: Path | None

    @classmethod
    def read(cls, settings: ArmSettings) -> Description:
        """Read the files named in the settings, or the built-in ones.

        Raises:
            ConfigurationError: a file that cannot be used.
        """
        try:
            if settings.urdf is not None and settings.srdf is not None:
                robot = model.load(settings.urdf, settings.srdf)
            else:
                robot = model.builtin()
            file = find_calibration(str(settings.calibration), os.environ) if settings.calibration else None
            read = Calibration.load(file) if file else Calibration.nominal()
            calibration = read.with_zero_offsets(settings.zero_offset_rad)
            return cls(within_calibration(robot, calibration), calibration, file)
        except RobotError as error:
            raise ConfigurationError(str(error)) from error


def arm_config(settings: ArmSettings, description: Description, port: str) -> ArmConfig:
    """What the arm process needs to know.

    Args:
        settings: the section ``arm``.
        description: the arm by its files.
        port: its serial port.
    """
    return ArmConfig(
        robot=description.robot,
        calibration=description.calibration,
        port=port,
        state_rate_hz=settings.joint_state_rate_hz,
        start_enabled=settings.start_enabled,
        watchdog_s=settings.watchdog_s,
        on_server_lost=settings.on_server_lost,
        on_exit=settings.on_exit,
        on_emergency_stop=settings.on_emergency_stop,
        warn_temperature_c=settings.warn_temperature_c,
        slow_temperature_c=settings.slow_temperature_c,
        stop_temperature_c=settings.stop_temperature_c,
        guard_limits=settings.guards.limits(),
    )


def check_parameters(parameters: MoveItParameters, robot: RobotModel) -> None:
    """Hold the parameters against the robot.

    Raises:
        ConfigurationError: a group, link or frame that the robot does not have.
    """
    group, link, frame = (
        parameters.group_name,
        parameters.end_effector_link,
        parameters.planning_frame.lstrip("/"),
    )
    if group not in robot.groups:
        raise ConfigurationError(
            f"moveit.group_name: there is no group {group!r}; the SRDF has {', '.join(robot.groups)}"
        )
    if link and link not in robot.links:
        raise ConfigurationError(
            f"moveit.end_effector_link: there is no link {link!r}; the URDF has {', '.join(robot.links)}"
        )
    if frame and frame != robot.root_link:
        raise ConfigurationError(f"moveit.planning_frame: must be the root link {robot.root_link!r}, not {frame!r}")
