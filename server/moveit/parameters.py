"""Parameters of MoveIt's nodes and of Servo under their usual names, and those set by ``/set_planner_params``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from planners.problem import PLANNER_IDS, planner_name
from planners.servo.question import ServoLimits
from server.config_keys import SettingsSection
from server.errors import ServiceError, sentence_of

# A planner process is occupied for as long.
MAX_ALLOWED_PLANNING_TIME_S = 60.0
MAX_PLANNING_ATTEMPTS = 100

# No client waits longer for an inverse kinematics.
MAX_KINEMATICS_TIMEOUT_S = 10.0

# Far more than MoveIt's own planners have.
MAX_KEYS = 200
MAX_CONFIGURATIONS = 100

# Parameters of planning that clients may set while the server runs.
KNOWN_KEYS = (
    "allowed_planning_time",
    "joint_tolerance",
    "num_planning_attempts",
    "optimization",
    "optimization_time",
    "orientation_tolerance",
    "planner_id",
    "position_tolerance",
)

# Least time after which a command expires [s]: one period of the loop.
LEAST_TIMEOUT_S = 0.02


class ServoParameters(SettingsSection):
    """Parameters of the servo loop."""

    command_in_type: Literal["unitless", "speed_units"] = "unitless"
    """``unitless`` commands are shares of the scales, -1 to 1; ``speed_units`` are SI units."""
    linear_scale: float = Field(default=0.2, gt=0.0, le=2.0)
    """speed of the tip for a command of 1, and its greatest speed towards a pose target [m/s]."""
    rotational_scale: float = Field(default=0.8, gt=0.0, le=10.0)
    """the same for its rotation [rad/s]."""
    joint_scale: float = Field(default=0.5, gt=0.0, le=10.0)
    """speed of a joint for a command of 1 [rad/s]."""
    # A browser that sends 60 commands a second pauses for up to a quarter of a second to collect garbage.
    incoming_command_timeout: float = Field(default=0.25, ge=LEAST_TIMEOUT_S, le=5.0)
    """time after which a command expires; a client may choose a shorter one [s]."""
    rate_hz: float = Field(default=50.0, ge=20.0, le=100.0)
    """rate of new joint velocities [Hz]."""
    velocity_scaling: float = Field(default=1.0, gt=0.0, le=1.0)
    """share of the joints' velocity limits to use."""
    lower_singularity_threshold: float = Field(default=17.0, gt=1.0, le=1e4)
    """condition number above which motion towards a singularity slows down."""
    hard_stop_singularity_threshold: float = Field(default=30.0, gt=1.0, le=1e4)
    """condition number at which such motion stops."""
    check_collisions: bool = True
    """true to keep the arm from colliding with itself and the scene."""
    self_distance: float = Field(default=0.003, ge=0.0, le=0.05)
    """least distance between links [m]."""
    scene_distance: float = Field(default=0.005, ge=0.0, le=0.05)
    """least distance between links and objects [m]."""
    status_type: Literal["moveit_msgs/ServoStatus", "std_msgs/Int8"] = "moveit_msgs/ServoStatus"
    """type of the status topic; ``std_msgs/Int8`` has humble's numbers."""

    @model_validator(mode="after")
    def _slows_before_it_stops(self) -> ServoParameters:
        slow, stop = self.lower_singularity_threshold, self.hard_stop_singularity_threshold
        if slow >= stop:
            raise ValueError(
                f"lower_singularity_threshold must be below hard_stop_singularity_threshold, not {slow:g} and {stop:g}"
            )
        return self

    @property
    def limits(self) -> ServoLimits:
        return ServoLimits(
            linear_m_s=self.linear_scale,
            angular_rad_s=self.rotational_scale,
            velocity_scaling=self.velocity_scaling,
            singularity_slow=self.lower_singularity_threshold,
            singularity_stop=self.hard_stop_singularity_threshold,
            self_distance_m=self.self_distance if self.check_collisions else None,
            scene_distance_m=self.scene_distance if self.check_collisions else None,
        )


class MoveItParameters(SettingsSection):
    """Parameters of goals that do not name their own."""

    group_name: str = ""
    """planning group of goals that name none; empty for the robot's default."""
    end_effector_link: str = ""
    """link that pose goals of this group move; empty for the tip of the group."""
    planning_frame: str = ""
    """frame of poses with an empty frame_id; empty for the robot's root link."""
    planner_id: str = ""
    """a search algorithm of docs/planning.md; empty for RRTConnect."""
    num_planning_attempts: int = Field(default=MAX_PLANNING_ATTEMPTS, ge=1, le=MAX_PLANNING_ATTEMPTS)
    """searches for each goal; the shortest result is kept."""
    optimization: Literal["first", "short", "best"] = "short"
    """shorten a motion that was found: not, for ``optimization_time``, or until ``allowed_planning_time`` is over."""
    optimization_time: float = Field(default=0.012, ge=0.0, le=10.0)
    """planning time spent on shortening a motion [s]."""
    allowed_planning_time: float = Field(default=5.0, gt=0.0, le=MAX_ALLOWED_PLANNING_TIME_S)
    """planning time after which a goal is answered TIMED_OUT [s]."""
    allowed_execution_duration_scaling: float = Field(default=2.2, ge=1.0, le=100.0)
    """a motion that takes longer than this times its planned duration is given up; below 2 also if a hot servo slows
    it down."""
    allowed_goal_duration_margin: float = Field(default=2.0, ge=0.5, le=60.0)
    """time on top of that [s]."""
    max_velocity_scaling: float = Field(default=0.3, gt=0.0, le=1.0)
    """share of the velocity limits."""
    max_acceleration_scaling: float = Field(default=0.3, gt=0.0, le=1.0)
    """share of the acceleration limits."""
    faster_trajectories: Literal["slow", "refuse"] = "slow"
    """play a trajectory that is faster than ``arm.speed_limit`` slower, or refuse it."""
    position_tolerance: float = Field(default=0.01, gt=0.0, le=0.1)
    """radius within which a position goal is reached [m]."""
    orientation_tolerance: float = Field(default=0.01, gt=0.0, le=0.5)
    """angle about each axis within which a pose goal of six joints or more is reached [rad]."""
    joint_tolerance: float = Field(default=0.01, gt=0.0, le=0.5)
    """a joint goal beyond a limit by no more than this goes to the limit [rad]."""
    # MoveIt's 0.05 s are all used up when there is no solution; here the answer comes at once, and a
    # loaded machine may take longer.
    kinematics_solver_timeout: float = Field(default=0.5, ge=0.001, le=MAX_KINEMATICS_TIMEOUT_S)
    """time for inverse kinematics if the request names none [s]."""
    publish_planning_scene_hz: float = Field(default=4.0, ge=0.1, le=50.0)
    """rate of ``/monitored_planning_scene``; changes that come faster are published together [Hz]."""
    geometry_directory: Path | None = None
    """folder of /save_geometry_to_file and /load_geometry_from_file; None for no such services."""
    servo: ServoParameters = ServoParameters()
    """steering of the arm."""

    @field_validator("planner_id")
    @classmethod
    def _is_known(cls, value: str) -> str:
        if planner_name(value) is None:
            raise ValueError(f"must be empty or one of {', '.join(PLANNER_IDS)}")
        return value

    def shortening_time_s(self, allowed_time_s: float) -> float:
        """Return the planning time to spend on shortening a motion, of the allowed time [s]."""
        return {"first": 0.0, "short": self.optimization_time, "best": allowed_time_s}[self.optimization]

    def changed(self, values: Mapping[str, Any]) -> MoveItParameters:
        """Return the parameters with other values of some; ValueError names a parameter, its limit and the value."""
        try:
            return MoveItParameters.model_validate({**self.model_dump(), **values})
        except ValidationError as error:
            flaw = error.errors()[0]
            raise ValueError(f"{flaw['loc'][0]}: {sentence_of(flaw)}, not {flaw['input']!r}") from error


class PlannerParameters:
    """Parameters of planners, kept in memory by planning group and planner.

    Keys other than `KNOWN_KEYS`, such as the keys of OMPL's planners, are kept and returned, and have no effect.
    """

    def __init__(self, configured: MoveItParameters) -> None:
        self.configured = configured
        self._set: dict[tuple[str, str], dict[str, str]] = {}

    def of(self, group: str, planner: str = "") -> MoveItParameters:
        """Return the parameters of a planner in a group; empty names mean the configured ones.

        Parameters that are set for all groups, or all planners, apply where no others are set.
        """
        texts = self.texts(group or self.configured.group_name, planner or self.configured.planner_id)
        known = {key: value for key, value in texts.items() if key in KNOWN_KEYS}
        return self.configured.changed(known)

    def texts(self, group: str, planner: str) -> Mapping[str, str]:
        texts = {key: str(getattr(self.configured, key)) for key in KNOWN_KEYS}
        for scope in (("", ""), (group, ""), (group, planner)):
            texts |= self._set.get(scope, {})
        return texts

    def set(self, group: str, planner: str, values: Mapping[str, str], *, replace: bool) -> None:
        """Set parameters of a group and a planner by their names; empty for all."""
        scope = (group, planner)
        kept = {} if replace else self._set.get(scope, {})
        wanted = {**kept, **values}
        if len(wanted) > MAX_KEYS or len({*self._set, scope}) > MAX_CONFIGURATIONS:
            raise ServiceError(f"at most {MAX_KEYS} parameters of {MAX_CONFIGURATIONS} planners can be kept")
        try:
            self.configured.changed({key: value for key, value in wanted.items() if key in KNOWN_KEYS})
        except ValueError as error:
            raise ServiceError(str(error)) from error
        self._set[scope] = wanted
