"""Ideal arm in a physical world: joints that follow their goals by computed torque, and carry their own weight."""

from collections.abc import Callable

import numpy as np

from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import Measured
from robot.physics.world import World

# Poles of the following error: 40 rad/s, twice, which is slow beside a time step and fast beside a motion.
POLE_RAD_S = 40.0

RELAXED_DAMPING = 10.0  # a gear that is turned from outside: a push of 1 Nm turns it by 6 deg/s [Nm s/rad]


class PhysicalArm(IdealArm):
    """Ideal arm whose joints have the ideal arm's positions for targets, and touch other bodies.

    The torque is M (w^2 e + 2 w de/dt) + h with the mass matrix M, the following error e, the pole w and the torques h
    of gravity and motion (computed torque, Siciliano et al., Robotics, section 8.5.2).
    """

    def __init__(
        self,
        robot: RobotModel,
        config: IdealConfig,
        joint_names: tuple[str, ...],
        bounds: JointBounds,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(config, joint_names, bounds, clock)
        self.world = self._world = World(robot, joint_names, self._position_rad)

    def read(self) -> Measured | None:
        before_s, measured = self._at_s, super().read()
        self._world.advance(self._at_s - before_s, self._drive)
        position_rad = self._world.position_rad
        # A relaxed joint stays where something pushes it.
        self._position_rad = np.where(self._on, self._position_rad, position_rad)
        if measured is None:
            return None
        return measured._replace(position_rad=position_rad, velocity_rad_s=self._world.velocity_rad_s)

    def _drive(self) -> None:
        world = self._world
        error_rad = self._position_rad - world.position_rad
        wanted = POLE_RAD_S * (POLE_RAD_S * error_rad - 2.0 * world.velocity_rad_s)
        torque_nm = np.where(self._on, world.torque_for(wanted), 0.0) + world.load_nm
        world.push(np.clip(torque_nm, -world.effort_nm, world.effort_nm), np.where(self._on, 0.0, RELAXED_DAMPING))
