"""Simulated world of one arm: its links, in MuJoCo's time steps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from robot.description.model import RobotModel
from robot.emulator.plant import MAX_STEP_S
from robot.errors import PortLost
from robot.hardware.config import EmulatedConfig
from robot.physics.arm_model import TIMESTEP_S, arm_model, compiled
from robot.trajectory import Vector

log = logging.getLogger("armbridge.physics")


class World:
    """World in which the torques of an arm's joints move its links.

    Arrays have shape (joints,), in the order of ``joint_names``: positions [rad or m], torques [Nm or N].
    """

    def __init__(self, robot: RobotModel, joint_names: Sequence[str], position_rad: Vector) -> None:
        # MuJoCo writes a log file into the working directory otherwise.
        mujoco.set_mju_user_warning(lambda text: log.debug("MuJoCo: %s", text))
        self._spec = arm_model(robot)
        self.model = compiled(self._spec)
        self.data = mujoco.MjData(self.model)
        # A joint of one degree of freedom has one index in positions and in velocities; the arm comes first in both.
        self._joints = np.array([self.model.joint(name).id for name in joint_names])
        # Largest torques by the URDF; an effort of 0 stands for none given.
        effort_nm = self.model.jnt_actfrcrange[self._joints, 1]
        self.effort_nm = np.where(effort_nm > 0.0, effort_nm, np.inf)
        self._due_s = 0.0
        self.place(position_rad)

    @property
    def position_rad(self) -> Vector:
        """Positions of the joints."""
        return self._of_joints(self.data.qpos)

    @property
    def velocity_rad_s(self) -> Vector:
        """Velocities of the joints [rad/s or m/s]."""
        return self._of_joints(self.data.qvel)

    @property
    def load_nm(self) -> Vector:
        """Torques that gravity and motion ask of the joints at their positions."""
        return self._of_joints(self.data.qfrc_bias)

    def torque_for(self, acceleration: Vector) -> Vector:
        """Compute the torques that accelerate the joints [rad/s^2 or m/s^2], without the load."""
        full = np.zeros(self.model.nv)
        full[self._joints] = acceleration
        torque_nm = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, torque_nm, full)
        return self._of_joints(torque_nm)

    def _of_joints(self, values: Vector) -> Vector:
        selected: Vector = values[self._joints]
        return selected

    def place(self, position_rad: Vector) -> None:
        """Move the joints to positions at once, at rest."""
        self.data.qpos[self._joints] = position_rad
        self.data.qvel[self._joints] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def limit(self, lower_rad: Vector, upper_rad: Vector) -> None:
        """Set the mechanical stops of the joints."""
        self.model.jnt_range[self._joints] = np.column_stack((lower_rad, upper_rad))
        self.model.jnt_limited[self._joints] = True

    def push(self, torque_nm: Vector, damping_nm_s: Vector) -> None:
        """Set the torques of the joints, and their viscous damping [Nm s/rad], for the steps to come."""
        self.data.qfrc_applied[self._joints] = torque_nm
        self.model.dof_damping[self._joints] = damping_nm_s

    def drag(self, joint: int, velocity_rad_s: float) -> None:
        """Give the joint at an index a velocity, as a hand does that is stronger than its motor."""
        self.data.qvel[self._joints[joint]] = velocity_rad_s

    def advance(self, duration_s: float, drive: Callable[[], None]) -> None:
        """Advance by a time [s] in steps of :data:`TIMESTEP_S`; ``drive`` sets the torques before each step.

        Raises PortLost for a world that has become unstable; it is at its last finite positions then, at rest.
        """
        self._due_s += min(duration_s, MAX_STEP_S)
        before = self.data.qpos.copy()
        # Half a step less: rounding must not leave one of five for the next tick.
        while self._due_s > 0.5 * TIMESTEP_S:
            self._due_s -= TIMESTEP_S
            drive()
            mujoco.mj_step(self.model, self.data)
            if not (np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all()):
                mujoco.mj_resetData(self.model, self.data)
                self.data.qpos[:] = before
                mujoco.mj_forward(self.model, self.data)
                raise PortLost(EmulatedConfig.port, "the physics had no finite positions, and was reset")
