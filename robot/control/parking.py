"""End of an arm that is parked: back along the path of its motion, then to the rest pose, before it is relaxed.

The arm process cannot plan. It keeps the parking trajectory that the server planned from where the arm held last
(:class:`robot.messages.KeepParking`), and plays it only from there. A motion that the server's loss interrupts is first
played backwards to where it began. Whatever cannot be parked is relaxed where it is. Pure: time is passed in.
"""

import logging
from enum import Enum

import numpy as np

from robot.control.controller import ArmController
from robot.control.motion import Motion
from robot.messages import PARKING_TIMEOUT_S, ChangePace, Execute, MotionEnded, Outcome, ParkingPlan, PlaybackDirection
from robot.trajectory import Vector

log = logging.getLogger("armbridge.arm")

# Distance from the planned start up to which the trajectory is played [rad]: goals are compared with goals, which
# differ by rounding alone.
START_TOLERANCE_RAD = 0.01

PARKING_MOTION = 0  # number of the parking motion; the server numbers its motions from 1


class Stage(Enum):
    """Stage of parking."""

    NOT_BEGUN = "not begun"
    BRAKING = "braking"
    GOING_BACK = "going back"
    PARKING = "parking"
    OVER = "over"  # relax the arm: it is parked, or cannot be


class Parking:
    """Parking of one arm."""

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        self._names = joint_names
        self._plan: ParkingPlan | None = None
        self.stage = Stage.NOT_BEGUN
        self._until_s = 0.0
        self._refusal = ""
        self._ended: MotionEnded | None = None

    def keep(self, plan: ParkingPlan | None) -> None:
        """Keep a trajectory in place of the former; None when the former became invalid."""
        self._plan = plan

    def reset(self, controller: ArmController) -> None:
        """Give parking up, because the server is back: the arm brakes and holds, unless it is being relaxed."""
        if self.stage is not Stage.OVER:
            log.warning("parking: the server is back, so that the arm stops and holds")
            controller.stop()
        self.stage = Stage.NOT_BEGUN

    def give_up(self, controller: ArmController, reason: str) -> None:
        """Brake, and have the arm relaxed; do nothing when parking is over."""
        if self.stage is not Stage.OVER:
            log.warning("parking: %s; the arm is relaxed where it is", reason)
            controller.stop()
            self.stage = Stage.OVER

    def advance(self, controller: ArmController, now_s: float, *, may_move: bool) -> None:
        """Take the next step, once a tick; only brake while ``may_move`` is False, because the server may come back."""
        if self.stage is Stage.NOT_BEGUN:
            self._brake(controller)
        if self.stage is Stage.BRAKING and may_move:
            self._until_s = now_s + PARKING_TIMEOUT_S
            self._begin(controller)
        elif self.stage in (Stage.GOING_BACK, Stage.PARKING):
            self._continue(controller, now_s)

    def _continue(self, controller: ArmController, now_s: float) -> None:
        if self._plan is None:
            self.give_up(controller, "the scene has changed since the way to the rest pose was planned")
        elif controller.fault is not None:
            self.give_up(controller, f"the arm has a fault: {controller.fault}")
        elif now_s > self._until_s:
            self.give_up(controller, f"the arm is not at its rest pose after {PARKING_TIMEOUT_S:g} s")
        elif not controller.moving:
            if self.stage is Stage.GOING_BACK:
                self._park(controller)
            else:
                self._finish()
        elif self.stage is Stage.GOING_BACK and all(
            isinstance(motion, Motion) and motion.fraction == 0.0 for motion in controller.motions
        ):
            controller.stop()

    def take(self, ended: list[MotionEnded]) -> None:
        """Note the end of the parking motion, if it is among some ends."""
        self._ended = next((each for each in ended if each.motion_id == PARKING_MOTION), self._ended)

    def _brake(self, controller: ArmController) -> None:
        """Bring motions to rest: on their paths, where they can be played back from there."""
        self.stage = Stage.BRAKING
        self._refusal = self._no_way_back(controller) if controller.moving else ""
        if controller.moving and not self._refusal:
            controller.change_pace(ChangePace(direction=PlaybackDirection.PAUSED))
        else:
            controller.stop()

    def _begin(self, controller: ArmController) -> None:
        if not controller.torque_enabled:
            self.stage = Stage.OVER
        elif self._refusal:
            self.give_up(controller, self._refusal)
        elif controller.moving:
            log.warning("parking: the arm goes back along its path to where the motion began")
            controller.change_pace(ChangePace(direction=PlaybackDirection.BACK))
            self.stage = Stage.GOING_BACK
        else:
            self._park(controller)

    def _no_way_back(self, controller: ArmController) -> str:
        if controller.pace.direction is PlaybackDirection.PAUSED or controller.pace.speed_factor == 0.0:
            return "the motion is paused"
        start_rad = controller.goal_rad.copy()
        for motion in controller.motions:
            if not isinstance(motion, Motion) or motion.gripping or motion.ending:
                return "the motion in progress has no way back"
            start_rad[motion.columns] = motion.trajectory.sample(0.0)[0]
        return self._mismatch(start_rad)

    def _park(self, controller: ArmController) -> None:
        reason = self._mismatch(controller.goal_rad)
        if controller.pace.speed_factor == 0.0:
            reason = "the speed factor is 0"
        if reason or self._plan is None:
            self.give_up(controller, reason)
            return
        self._ended = None
        refused = controller.execute(Execute(PARKING_MOTION, self._plan.trajectory))
        if refused is not None:
            self.give_up(controller, refused.message)
            return
        log.info("parking: the arm moves to its rest pose, in %.1f s", self._plan.trajectory.duration_s)
        self.stage = Stage.PARKING

    def _finish(self) -> None:
        ended = self._ended
        if ended is not None and ended.outcome is Outcome.REACHED:
            log.info("parking: the arm is at its rest pose, and is relaxed")
        else:
            reason = "the motion was ended" if ended is None else ended.message
            log.warning("parking: %s; the arm is relaxed where it is", reason)
        self.stage = Stage.OVER

    def _mismatch(self, goal_rad: Vector) -> str:
        plan = self._plan
        if plan is None:
            return "no way to the rest pose is known in the present scene"
        if plan.trajectory.duration_s > PARKING_TIMEOUT_S:
            took = f"{plan.trajectory.duration_s:.1f} s"
            return f"the way to the rest pose would take {took}, above the limit of {PARKING_TIMEOUT_S:g} s"
        planned_rad = np.array([plan.held_rad.get(name, np.inf) for name in self._names])
        away_rad = np.abs(goal_rad - planned_rad)
        worst = int(np.argmax(away_rad))
        if away_rad[worst] <= START_TOLERANCE_RAD:
            return ""
        return (
            f"the way to the rest pose was planned with joint {self._names[worst]} at {planned_rad[worst]:.3f} rad, "
            f"which is at {goal_rad[worst]:.3f} rad (tolerance {START_TOLERANCE_RAD} rad)"
        )
