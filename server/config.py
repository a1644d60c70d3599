"""Every setting of the server, typed: names, units, ranges and defaults."""

from __future__ import annotations

import itertools
import os
import re
from dataclasses import fields
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, FiniteFloat, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from robot.messages import MIN_SPEED_LIMIT, EmergencyPolicy, EndState, GuardLimits
from server.access.settings import AccessSettings
from server.config_keys import SettingsSection
from server.execution.goal import GoalPolicy
from server.gateway.settings import ServerSettings
from server.moveit.parameters import MoveItParameters
from server.zenoh.settings import ZenohSettings


class PlanningSettings(SettingsSection):
    """Planner processes."""

    workers: int = Field(default=1, ge=1, le=16)
    """goals planned at the same time; one more process helps with hard motions."""
    memory_limit_mb: int = Field(default=1024, ge=256, le=65536)
    """memory of each planner process, which is restarted when it needs more [MB]."""

    @property
    def memory_limit_bytes(self) -> int:
        return self.memory_limit_mb * 1_000_000


def _guard(name: str) -> Any:
    """Make the field of one of the arm process's guard limits: its default and its range."""
    limit = next(each for each in fields(GuardLimits) if each.name == name)
    lowest, highest = limit.metadata["range"]
    return Field(default=limit.default, ge=lowest, le=highest)


class GuardSettings(SettingsSection):
    """Torque limits of the servos, and the tolerances within which a motion succeeds."""

    torque_limit: float = _guard("torque_limit")
    """share of full motor duty that each servo may use."""
    gripper_torque_limit: float = _guard("gripper_torque_limit")
    """share of full motor duty that the gripper's servo may use."""
    tracking_error_rad: float = _guard("tracking_error_rad")
    """tracking error above which a joint has a fault [rad]."""
    tracking_time_s: float = _guard("tracking_time_s")
    """time for which the tracking error may be larger [s]."""
    stall_current_a: float = _guard("stall_current_a")
    """current above which a servo that hardly moves is stalled: a fault, or a grip [A]."""
    stall_time_s: float = _guard("stall_time_s")
    """time for which a servo may be stalled; its own protection latches after 2 s [s]."""
    silent_after_s: float = _guard("silent_after_s")
    """silence of a servo that is a fault; at least 0.5 s over a network, 3 s on a pseudo terminal. The arm moves
    blindly meanwhile [s]."""
    min_voltage_v: float = _guard("min_voltage_v")
    """a supply below is a fault; 9 V are right for servos of 12 V [V]."""
    goal_tolerance_rad: float = _guard("goal_tolerance_rad")
    """how near each joint must come to the end of its motion [rad]."""
    settle_timeout_s: float = _guard("settle_timeout_s")
    """time to come that near; less than moveit.allowed_goal_duration_margin [s]."""


# Of the environment variables.
PREFIX = "ARMBRIDGE_"


class ArmSettings(SettingsSection):
    """Arm and its bus; see docs/arm.md."""

    serial: str | None = None
    """port of the servos: path, USB id, socket://host:port, auto (docs/hardware.md); None for the simulated arm."""
    robot: str | None = None
    """the arm: a built-in one, or a folder with a robot.toml (docs/robots.md); None for the SO-101."""
    calibration: Path | None = None
    """a calibration file or its lerobot id; nominal for emulated servos. Without one a real arm is not enabled."""
    zero_offset_rad: dict[str, float] = Field(default_factory=dict)
    """trim of joints' zeros by name, at most 0.5 rad: { elbow = 0.02 } [rad]."""
    urdf: Path | None = None
    """a URDF in place of the robot's; without robot, serial and calibration its arm is ideal (docs/simulation.md)."""
    srdf: Path | None = None
    """the SRDF of this URDF."""
    package_path: list[Path] = Field(default_factory=list)
    """folders with the packages of package://, searched ahead of ROS_PACKAGE_PATH."""
    ideal_lag_s: float = Field(default=0.03, ge=0.0, le=1.0)
    """time constant with which the joints of an ideal arm follow their goals [s]."""
    joint_state_rate_hz: float = Field(default=50.0, ge=10.0, le=100.0)
    """rate of ``/joint_states`` and ``/tf`` [Hz]."""
    speed_limit: float = Field(default=1.0, ge=MIN_SPEED_LIMIT, le=1.0)
    """share of the joints' velocity limits that no motion exceeds; ``/arm/set_speed_limit`` changes it."""
    unverified_speed_limit: float = Field(default=0.25, ge=MIN_SPEED_LIMIT, le=1.0)
    """such a share until the calibration of an arm on servos is verified; 1 for no such limit."""
    start_enabled: bool = True
    """hold the arm when it is connected; else it is relaxed until /arm/enable."""
    # Heartbeats come every 0.1 s; less than three of them missed would be taken for the server's death.
    watchdog_s: float = Field(default=0.5, ge=0.3, le=10.0)
    """silence of the server after which the arm stops; a simulated arm waits at least 5 s [s]."""
    on_server_lost: EndState = EndState.HOLD
    """state of the arm after that stop (docs/arm.md)."""
    on_exit: EndState = EndState.HOLD
    """state of the arm after an orderly shutdown."""
    on_last_client: Literal["nothing", "park", "relax"] = "nothing"
    """action when no client that may drive is connected any more."""
    last_client_delay_s: float = Field(default=10.0, ge=0.0, le=86_400.0)
    """time without such a client before that action [s]."""
    park_state: str | None = None
    """named state of the SRDF in which the arm is parked; None for the robot's own."""
    on_emergency_stop: EmergencyPolicy = EmergencyPolicy.TORQUE_OFF
    """action on an emergency stop: with torque_off the arm falls, with hold it stops."""
    # The servos protect themselves at 70 degC.
    warn_temperature_c: float = Field(default=55.0, ge=30.0, le=70.0)
    """temperature of a servo at which /diagnostics has a warning [degC]."""
    slow_temperature_c: float = Field(default=60.0, ge=30.0, le=70.0)
    """temperature of a servo at which motions run at half speed [degC]."""
    stop_temperature_c: float = Field(default=65.0, ge=30.0, le=70.0)
    """temperature of a servo that is a fault and relaxes the arm [degC]."""
    guards: GuardSettings = GuardSettings()
    """torque limits, and the tolerances before a motion has failed."""

    @model_validator(mode="after")
    def _descriptions_come_in_pairs(self) -> ArmSettings:
        if (self.urdf is None) != (self.srdf is None):
            raise ValueError("urdf and srdf must be given together")
        return self

    @model_validator(mode="after")
    def _temperatures_rise(self) -> ArmSettings:
        steps = (self.warn_temperature_c, self.slow_temperature_c, self.stop_temperature_c)
        if sorted(steps) != list(steps):
            raise ValueError(f"warn_, slow_ and stop_temperature_c must rise in this order, not {steps}")
        return self


class SimulationSettings(SettingsSection):
    """Simulation of every arm without serial; see docs/simulation.md."""

    kind: Literal["light", "physics"] = "light"
    """physics has mass and contact by MuJoCo."""
    rate: float = Field(default=1.0, ge=1.0, le=20.0)
    """speed of an only arm's clock in multiples of real time, where the machine is fast enough."""
    world: str | None = None
    """world of the physics: cubes, table, peg or a file."""
    world_seed: int = Field(default=0, ge=0)
    """seed that moves the world's movable objects; 0 for none."""

    @model_validator(mode="after")
    def _a_world_needs_physics(self) -> SimulationSettings:
        if self.world is not None and self.kind != "physics":
            raise ValueError(f"world: {self.world} needs physics: set simulation.kind to physics")
        return self


class EmulatorSettings(SettingsSection):
    """Emulated servos of a simulated arm; an ideal arm has none and refuses these settings."""

    drop: float = Field(default=0.0, ge=0.0, le=1.0)
    """probability that a reply is lost."""
    corrupt: float = Field(default=0.0, ge=0.0, le=1.0)
    """probability that a reply has a wrong byte."""
    seed: int = 0
    """seed of the random faults."""
    population: Literal["factory", "lerobot", "ros2_driver", "clone", "kit"] = "factory"
    """state in which the servos are found (docs/simulation.md)."""
    write_log: Path | None = None
    """file with a line of JSON for every write to a servo."""
    control: Path | None = None
    """Unix socket that takes live commands to the servos (docs/simulation.md)."""


# Far more than one machine has ports for.
MAX_ARMS = 32

# Names of arms are the beginnings of joints, groups, topics and services.
ARM_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")

# First parts of names that the server itself or its clients have.
RESERVED_NAMES = frozenset(
    (
        "arm",
        "armbridge",
        "arms",
        "client",
        "dataset",
        "file_server",
        "moveit",
        "rosapi",
        "servo_node",
        "simulation",
        "teach",
        "teleop",
        "world",
    )
)


class ArmRole(StrEnum):
    """Use of one of several arms."""

    FOLLOWER = "follower"
    LEADER = "leader"


class NamedArmSettings(ArmSettings):
    """One of several arms: what the section ``arm`` has, its role, and its place."""

    role: ArmRole = ArmRole.FOLLOWER
    """a leader is relaxed, and moved by hand; it is enabled by its own service alone."""
    base_xyz_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    """place of its foot in the common frame [m]."""
    base_rpy_rad: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    """fixed-axis roll, pitch and yaw of its foot there [rad]."""
    emulator: EmulatorSettings = EmulatorSettings()
    """its emulated servos."""


class GoalSettings(SettingsSection):
    """The queue before the arm."""

    policy: GoalPolicy = GoalPolicy.QUEUE
    """action on a goal that comes while another goal is active."""
    capacity: int = Field(default=16, ge=1, le=1000)
    """goals that may wait."""
    on_disconnect: Literal["finish", "stop"] = "finish"
    """goals on actions of a client that leaves; its URL may choose, as in ``?on_disconnect=stop``."""
    confirm: bool = False
    """plan, show, and wait for the goal's id on /moveit_goal_approve before the motion."""
    # The goals behind it wait as long.
    confirm_timeout_s: float = Field(default=120.0, ge=1.0, le=3600.0)
    """a goal that is not confirmed within this time is answered TIMED_OUT [s]."""
    # A person who pauses a motion to look at something is back by then.
    max_paused_s: float = Field(default=600.0, ge=1.0, le=86_400.0)
    """a goal that was paused or going back for longer, in total, is given up [s]."""
    # The arm process plays half an hour of points at 100 Hz; an action's goal is over after an hour.
    max_trajectory_duration_s: float = Field(default=600.0, ge=1.0, le=1800.0)
    """a goal whose planned motions take longer is refused [s]."""
    named_states_file: Path | None = None
    """file of saved states; None for armbridge/ of the user's data directory."""


class SceneSettings(SettingsSection):
    """Planning scene from one start of the server to the next; see docs/moveit.md."""

    keep: bool = True
    """restore clients' objects of the planning scene at the next start."""
    file: Path | None = None
    """its file, another one for each server; None for armbridge/ of the user's data directory."""


class RecordingSettings(SettingsSection):
    """Recording of every message that is published."""

    file: Path | None = None
    """MCAP file to record every message to; if it exists, a number is added to the name."""
    limit_mb: int | None = Field(default=None, ge=1, le=1_000_000)
    """size at which the recording ends [MB]."""


class DiagnosticsSettings(SettingsSection):
    """Files about faults; see docs/operations.md."""

    fault_files: int = Field(default=20, ge=0, le=10_000)
    """newest files about faults to keep, each of at most 1 MB; 0 for none."""
    fault_directory: Path | None = None
    """their folder; None for armbridge/faults/ in the user's data directory."""

    def directory(self, data: Path) -> Path:
        return self.fault_directory or data / "faults"


class Settings(BaseSettings):
    """All settings. The command line overrides the environment, and that the file."""

    # Inputs may be tokens; who has a refusal to tell decides what it shows.
    model_config = SettingsConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        env_prefix=PREFIX,
        env_nested_delimiter="__",
        hide_input_in_errors=True,
    )

    server: ServerSettings = ServerSettings()
    access: AccessSettings = AccessSettings()
    arm: ArmSettings = ArmSettings()
    arms: dict[str, NamedArmSettings] = Field(default_factory=dict)
    """several arms in place of arm, by name: [arms.left] has the settings of [arm], role, base_xyz_m, base_rpy_rad
    and a section emulator (docs/several_arms.md).
    """
    moveit: MoveItParameters = MoveItParameters()
    goals: GoalSettings = GoalSettings()
    scene: SceneSettings = SceneSettings()
    planning: PlanningSettings = PlanningSettings()
    recording: RecordingSettings = RecordingSettings()
    diagnostics: DiagnosticsSettings = DiagnosticsSettings()
    zenoh: ZenohSettings = ZenohSettings()
    simulation: SimulationSettings = SimulationSettings()
    emulator: EmulatorSettings = EmulatorSettings()

    @field_validator("arms", mode="before")
    @classmethod
    def _arms_have_names(cls, arms: object) -> object:
        for name in arms if isinstance(arms, dict) else ():
            if not ARM_NAME.fullmatch(name):
                raise ValueError(f"the name of an arm must be a to z, 0 to 9 and _, from a letter on, not {name!r}")
            if name in RESERVED_NAMES:
                raise ValueError(f"an arm cannot have the name {name!r}, which begins names of the server's own")
        if isinstance(arms, dict) and len(arms) > MAX_ARMS:
            raise ValueError(f"there are {len(arms)} arms, the limit is {MAX_ARMS}")
        return arms

    @model_validator(mode="after")
    def _arms_have_their_own(self) -> Settings:
        if self.arms and self.arm != ArmSettings():
            raise ValueError("arm: with several arms each has its settings in its own section, as [arms.left]")
        for name, other in itertools.permutations(self.arms, 2):
            if other.startswith(f"{name}_"):
                raise ValueError(f"arms.{other}: begins as names of arms.{name} do: rename one")
        having: dict[str, str] = {}
        for name, arm in self.arms.items():
            if arm.serial is None:
                continue
            # One port may have several names, as those below /dev/serial/by-id.
            port = arm.serial if "://" in arm.serial else os.path.realpath(arm.serial)
            if port in having:
                raise ValueError(f"arms.{name}.serial: {arm.serial} is the port of arms.{having[port]} already")
            having[port] = name
        if len(self.arms) > 1 and any(arm.serial == "auto" for arm in self.arms.values()):
            raise ValueError("arms: a port cannot be found by itself (auto) where there are several arms: name each")
        return self

    @model_validator(mode="after")
    def _some_arm_is_simulated(self) -> Settings:
        serials = [arm.serial for arm in self.arms.values() or [self.arm]]
        if None not in serials and self.simulation != SimulationSettings():
            raise ValueError(f"simulation: there is no simulated arm beside the arm at {serials[0]}; leave it out")
        if self.arms and self.simulation.rate != 1.0:
            raise ValueError(f"simulation.rate: must be 1 with several arms, not {self.simulation.rate:g}")
        return self

    @model_validator(mode="after")
    def _the_arm_settles_within_the_margin(self) -> Settings:
        margin_s = self.moveit.allowed_goal_duration_margin
        for section, arm in {"arm": self.arm, **{f"arms.{name}": arm for name, arm in self.arms.items()}}.items():
            if (settle_s := arm.guards.settle_timeout_s) >= margin_s:
                raise ValueError(
                    f"{section}.guards.settle_timeout_s must be below moveit.allowed_goal_duration_margin, "
                    f"{settle_s:g} s is not below {margin_s:g} s"
                )
        return self
