"""Parameters of the servo loop, under MoveIt Servo's names where it has them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from planners.servo.question import ServoLimits
from server.config_keys import SettingsSection

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
    """time after which a command expires [s]; a client may choose a shorter one for its own commands."""
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
    """type of the status topic, ``moveit_msgs/ServoStatus`` or, as in humble and in its numbers, ``std_msgs/Int8``."""

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
        """The limits as planners take them."""
        return ServoLimits(
            linear_m_s=self.linear_scale,
            angular_rad_s=self.rotational_scale,
            velocity_scaling=self.velocity_scaling,
            singularity_slow=self.lower_singularity_threshold,
            singularity_stop=self.hard_stop_singularity_threshold,
            self_distance_m=self.self_distance if self.check_collisions else None,
            scene_distance_m=self.scene_distance if self.check_collisions else None,
        )
