"""Ideal arm: any number of joints, revolute or prismatic, that follow their goals, without servos, bus or weight.

Not modelled: inertia, load, gravity, contact, heat, supply. They are NaN or zero in its readings, so that the guards on
them never trip. The emulated servos (:mod:`robot.emulator`) model load, gravity, heat and supply of the SO-101.
"""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from robot.description.limits import JointBounds
from robot.faults import Fault
from robot.hardware.config import IdealConfig
from robot.hardware.interface import Actuation, Flags, HardwareInterface, Measured, Steps, Survey
from robot.messages import JointHealth
from robot.trajectory import Vector

RELAX_S = 0.5  # duration of relaxing, so that a client sees the same sequence of states as with servos [s]


class IdealArm(HardwareInterface):
    """Joints that follow their goals with a first-order lag.

    In a time dt each joint covers the share 1 - exp(-dt / lag) of the way to its goal, and no more than its velocity
    limit allows.
    """

    def __init__(
        self, config: IdealConfig, joint_names: tuple[str, ...], bounds: JointBounds, clock: Callable[[], float]
    ) -> None:
        joints = len(joint_names)
        super().__init__(joint_names, np.ones(joints))
        self._bounds = bounds
        self._clock = clock
        self._lag_s = config.lag_s
        start_rad = np.array([config.start_rad.get(name, 0.0) for name in joint_names])
        self._position_rad = np.clip(start_rad, bounds.lower_rad, bounds.upper_rad)
        self._velocity_rad_s = np.zeros(joints)
        self._goal_rad = self._position_rad.copy()
        self._on = np.full(joints, config.driven)
        self._at_s = clock()
        self._zeros = np.zeros(joints)
        self._unmeasured = np.full(joints, np.nan)
        self._no_limit = np.full(joints, np.inf)
        self._no_status = np.zeros(joints, dtype=int)

    def survey(self) -> Steps[Survey]:
        yield 0.0
        goal_rad = np.where(self._on, self._goal_rad, np.nan)
        return Survey(
            self._bounds,
            self._on.copy(),
            goal_rad,
            self._no_limit,
            Actuation.unprotected(self._no_limit, self._no_limit),
            reply_latency_s=0.0,
        )

    def read(self) -> Measured | None:
        self._advance(self._clock())
        return Measured(
            position_rad=self._position_rad,
            velocity_rad_s=self._velocity_rad_s,
            load=self._zeros,
            current_a=self._unmeasured,
            voltage_v=self._unmeasured,
            temperature_c=self._unmeasured,
            status=self._no_status,
            age_s=self._zeros,
            stamp_s=time.time(),
        )

    def write_goals(self, goal_rad: Vector) -> None:
        self._goal_rad = goal_rad

    def write_torque_shares(self, torque_share: Vector) -> None:
        """Do nothing: an ideal joint needs no torque."""

    def check(self, stamp_s: float) -> Fault | None:
        return None

    def driven(self) -> Steps[Flags]:
        yield 0.0
        return self._on.copy()

    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        yield 0.0
        for joint in joints:
            if not self._on[joint]:
                self._on[joint] = True
                self._goal_rad = self._goal_rad.copy()
                self._goal_rad[joint] = self._position_rad[joint]
        return np.where(self._on, self._goal_rad, self._position_rad)

    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Switch torque off after :data:`RELAX_S`; the joints have no weight, so they stay."""
        yield RELAX_S
        return (yield from self.switch_off())

    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        yield 0.0
        self._on[slice(None) if joints is None else list(joints)] = False
        return []

    def cut_torque(self) -> Steps[list[str]]:
        self._on[:] = False
        yield 0.0
        return []

    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        yield 0.0
        return self._goal_rad if hold else None

    def health(self, joint: int) -> JointHealth:
        return JointHealth(self.joint_names[joint], "ideal joint", torque_enabled=bool(self._on[joint]), age_s=0.0)

    def label(self, joint: int) -> str:
        return self.joint_names[joint]

    def close(self) -> None:
        """Do nothing: the joints stay as they are."""

    def _advance(self, now_s: float) -> None:
        elapsed_s, self._at_s = now_s - self._at_s, now_s
        if elapsed_s <= 0.0:
            return
        share = 1.0 if self._lag_s == 0.0 else -math.expm1(-elapsed_s / self._lag_s)
        most_rad = self._bounds.max_velocity * elapsed_s
        way_rad = np.clip((self._goal_rad - self._position_rad) * share, -most_rad, most_rad)
        way_rad[~self._on] = 0.0
        self._velocity_rad_s = way_rad / elapsed_s
        self._position_rad = self._position_rad + way_rad
