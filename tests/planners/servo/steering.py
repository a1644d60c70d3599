"""Steers an arm that exists in numbers only: a real planner, and the arm's own tracking of velocities."""

from collections.abc import Callable, Mapping

import numpy as np

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.pipeline import Planner
from planners.servo.question import Anchor, ServoAnswer, ServoCommand, ServoLimits, ServoQuestion
from robot.control.motion import VelocityTracking
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from server.moveit.servo.servo_loop import LEAD_S

TIP = "gripper_frame_link"
PERIOD_S = 0.02
TICK_S = 0.01
CLOSE_M = 0.06
READY = {"shoulder_lift": -0.5, "elbow_flex": 0.5}


class SteeredArm:
    """An arm that stands somewhere until it is steered."""

    def __init__(
        self,
        planner: Planner,
        robot: RobotModel,
        start_rad: Mapping[str, float] = READY,
        limits: ServoLimits | None = None,
        period_s: float = PERIOD_S,
        tip: str = TIP,
    ) -> None:
        self._tip = tip
        self._planner = planner
        self._limits = limits or ServoLimits()
        self._period_s = period_s
        self._names = robot.groups["arm"].joints
        self._others = {joint.name: 0.0 for joint in robot.movable_joints} | dict(start_rad)
        self._forward = ForwardKinematics(robot, list(self._others))
        start = np.array([self._others[name] for name in self._names])
        self.tracking = VelocityTracking(JointBounds.of(robot, self._names), start)
        self._velocity: Mapping[str, float] = {}
        self._anchor: Anchor | None = None
        self.tips_m = [self.tip_m]
        self.joints_rad = [self.tracking.position_rad]
        self.answers: list[ServoAnswer] = []

    @property
    def positions_rad(self) -> dict[str, float]:
        return self._others | dict(zip(self._names, self.tracking.position_rad.tolist(), strict=True))

    @property
    def tip_m(self) -> np.ndarray:
        self._forward.place(np.array(list(self.positions_rad.values())))
        return self._forward.placement(self._tip).translation.copy()

    @property
    def tip_axes(self) -> np.ndarray:
        self._forward.place(np.array(list(self.positions_rad.values())))
        return self._forward.placement(self._tip).rotation.copy()

    def steer(self, command: ServoCommand | Callable[[float], ServoCommand], seconds: float) -> ServoAnswer:
        """Steer for a while; returns the last answer."""
        for step in range(round(seconds / self._period_s)):
            wanted = command(step * self._period_s) if callable(command) else command
            ahead = self.tracking.position_rad + LEAD_S * self.tracking.velocity_rad_s
            positions_rad = self._others | dict(zip(self._names, ahead.tolist(), strict=True))
            question = ServoQuestion(
                "arm", self._tip, positions_rad, self._velocity, self._period_s, wanted, self._anchor, self._limits
            )
            answer = self._planner.answer(question)
            assert isinstance(answer, ServoAnswer), answer
            self._velocity, self._anchor = answer.velocity_rad_s, answer.anchor
            self.answers.append(answer)
            # The answer reaches the arm a tick later.
            self.tracking.advance(TICK_S)
            self.tracking.set_target(np.array([answer.velocity_rad_s[name] for name in self._names]))
            for _ in range(round(self._period_s / TICK_S) - 1):
                self.tracking.advance(TICK_S)
                self.tips_m.append(self.tip_m)
                self.joints_rad.append(self.tracking.position_rad)
        return self.answers[-1]


def least_distance_m(arm: SteeredArm, collision: CollisionModel) -> float:
    """The least distance of the arm from what is around it, on the way of its goals, at most :data:`CLOSE_M` [m]."""
    least_m = CLOSE_M
    for joints_rad in arm.joints_rad:
        positions = arm.positions_rad | dict(zip(arm._names, joints_rad.tolist(), strict=True))
        near = collision.near_pairs(np.array([positions[name] for name in collision.joint_names]), CLOSE_M)
        least_m = min([least_m, *(pair.distance_m for pair in near if pair.by_object)])
    return least_m
