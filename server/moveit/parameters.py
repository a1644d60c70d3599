"""The parameters that MoveIt goal nodes take, under their usual names."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, field_validator

from planners.problem import PLANNER_IDS, planner_name
from server.moveit.servo.parameters import ServoParameters

# A planner process is taken for as long; whoever asks for more has not understood what takes so long.
MAX_ALLOWED_PLANNING_TIME_S = 60.0
MAX_PLANNING_ATTEMPTS = 100

# Nobody waits longer for an inverse kinematics.
MAX_KINEMATICS_TIMEOUT_S = 10.0


class MoveItParameters(BaseModel):
    """How goals are planned when they do not say it themselves.

    Attributes:
        group_name: planning group of the SRDF.
        end_effector_link: link that position goals move; empty for the tip of the group.
        planning_frame: frame of poses with an empty frame_id; empty for the robot's root link.
        planner_id: which search to use, one of those of docs/planning.md; empty for the default.
        num_planning_attempts: searches of which the shortest result is kept.
        optimization_time: planning time spent on shortening a motion once there is one [s].
        allowed_planning_time: after this a goal is answered TIMED_OUT [s].
        allowed_execution_duration_scaling: a motion that takes longer than this times what it takes as planned is
            given up; below 2 also one that a hot servo slows down.
        allowed_goal_duration_margin: time on top of that [s].
        max_velocity_scaling: share of the velocity limits.
        max_acceleration_scaling: share of the acceleration limits.
        position_tolerance: radius within which a position goal is reached [m].
        joint_tolerance: a joint goal that lies beyond a limit by no more than this goes to the limit [rad].
        kinematics_solver_timeout: time for an inverse kinematics whose caller names none [s].
        publish_planning_scene_hz: rate of ``/monitored_planning_scene``; changes that come faster are told together
            [Hz].
        geometry_directory: where the services that save and load the scene's geometry have their files; None for
            nowhere.
        servo: how the arm is steered.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    group_name: str = "arm"
    end_effector_link: str = ""
    planning_frame: str = ""
    planner_id: str = ""
    num_planning_attempts: int = Field(default=5, ge=1, le=MAX_PLANNING_ATTEMPTS)
    optimization_time: float = Field(default=0.006, ge=0.0, le=10.0)
    allowed_planning_time: float = Field(default=5.0, gt=0.0, le=MAX_ALLOWED_PLANNING_TIME_S)
    allowed_execution_duration_scaling: float = Field(default=2.2, ge=1.0, le=100.0)
    allowed_goal_duration_margin: float = Field(default=2.0, ge=0.5, le=60.0)
    max_velocity_scaling: float = Field(default=0.3, gt=0.0, le=1.0)
    max_acceleration_scaling: float = Field(default=0.3, gt=0.0, le=1.0)
    position_tolerance: float = Field(default=0.01, gt=0.0, le=0.1)
    joint_tolerance: float = Field(default=0.01, gt=0.0, le=0.5)
    # MoveIt's 0.05 s are all used up when there is no solution; here the answer comes as soon as it is known, and a
    # loaded machine may take longer.
    kinematics_solver_timeout: float = Field(default=0.5, ge=0.001, le=MAX_KINEMATICS_TIMEOUT_S)
    publish_planning_scene_hz: float = Field(default=4.0, ge=0.1, le=50.0)
    geometry_directory: Path | None = None
    servo: ServoParameters = ServoParameters()

    @field_validator("planner_id")
    @classmethod
    def _is_known(cls, value: str) -> str:
        if planner_name(value) is None:
            raise ValueError(f"must be empty or one of {', '.join(PLANNER_IDS)}")
        return value
