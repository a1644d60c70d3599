from typing import Any

import numpy as np
import pytest

from robot.control.controller import ArmController
from robot.faults import FaultCode
from robot.messages import EmergencyPolicy, Mode, Order, Outcome
from robot.trajectory import PERIOD_S
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, ArmRig
from tests.helpers.motions import smooth_move

PAN, WRIST = 0, 3
PAN_END_RAD, WRIST_END_RAD, DURATION_S = 1.8, -1.2, 2.0
OBSTACLE_RAD = 0.3

# Over the limit by rounding in ticks of the loop.
TOLERANCE = 1.05


class Moving:
    """An arm on emulated servos that moves pan and wrist, and the goals of all its ticks."""

    def __init__(self, **settings: Any) -> None:
        self.rig = ArmRig(**settings).started()
        held = self.controller.goal_rad
        moves = {"shoulder_pan": (float(held[PAN]), PAN_END_RAD), "wrist_flex": (float(held[WRIST]), WRIST_END_RAD)}
        self.rig.execute(smooth_move(moves, DURATION_S))
        self.goals: list[np.ndarray] = []

    @property
    def controller(self) -> ArmController:
        return self.rig.supervisor.arm.controller

    def run(self, seconds: float) -> None:
        """Tick for some time; servos that are being relaxed keep their last goals."""
        for _ in range(round(seconds / PERIOD_S)):
            self.rig.tick()
            self.goals.append(self.controller.goal_rad if self.controller.torque_enabled else self.goals[-1])

    def until_fault(self, code: FaultCode) -> None:
        """Tick until the fault is latched."""
        for _ in range(200):
            self.run(PERIOD_S)
            if self.rig.mode is Mode.FAULT:
                break
        assert self.rig.fault_code == code.value

    def block(self, joint: int, at_rad: float) -> None:
        """Put an obstacle in a joint's way."""
        self.rig.emulator.command(obstacle={str(joint + 1): CALIBRATION.joints[joint].ticks_from_rad(at_rad)})

    def accelerations(self) -> np.ndarray:
        """Accelerations of the goals as shares of the limits, shape (ticks, joints)."""
        return np.abs(np.diff(np.array(self.goals), n=2, axis=0)) / PERIOD_S**2 / BOUNDS.max_acceleration


def moving_into_fault(code: FaultCode, command: dict[str, object], **settings: Any) -> Moving:
    """Let a fault come while both joints are fast."""
    moving = Moving(**settings)
    moving.run(0.9)
    moving.rig.emulator.command(**command)
    moving.until_fault(code)
    return moving


LOW_SUPPLY: dict[str, object] = {"voltage": {"3": 4.0}}


def test_a_hot_arm_is_relaxed_after_it_has_braked() -> None:
    moving = moving_into_fault(FaultCode.OVERHEATED, {"temperature": {"3": 67}})
    moving.run(0.05)
    assert moving.rig.torque() == [1] * 6
    moving.run(0.95)
    assert moving.accelerations().max() <= TOLERANCE
    moving.run(2.05)
    assert moving.rig.torque() == [0] * 6


def test_a_fault_is_latched_and_reported_at_once_while_the_joints_brake() -> None:
    moving = moving_into_fault(FaultCode.VOLTAGE_LOW, LOW_SUPPLY)
    at_fault_rad = moving.controller.goal_rad[PAN]
    moving.rig.execute(smooth_move({"gripper": (0.0, 0.5)}, 1.0), motion_id=2)
    assert moving.rig.outcomes == [Outcome.FAULT, Outcome.REFUSED]
    assert "has a fault" in moving.rig.ended[-1].message
    assert moving.controller.moving
    moving.run(0.05)
    assert moving.controller.goal_rad[PAN] > at_fault_rad
    assert moving.rig.state.fault is not None
    assert moving.rig.state.motions == ()


def test_a_stalled_joint_yields_while_the_others_brake_and_moves_again_after_the_reset() -> None:
    moving = Moving()
    moving.block(PAN, OBSTACLE_RAD)
    moving.until_fault(FaultCode.STALLED)
    moving.run(1.0)
    assert moving.accelerations()[:, WRIST].max() <= TOLERANCE
    for at_rad in (moving.controller.goal_rad, moving.rig.supervisor.arm.measured.position_rad):
        assert at_rad[PAN] == pytest.approx(OBSTACLE_RAD, abs=0.02)
    assert not moving.controller.moving
    moving.rig.emulator.command(obstacle={"1": None})
    assert moving.rig.order(Order.RESET_FAULT).done
    held = float(moving.controller.goal_rad[PAN])
    moving.rig.execute(smooth_move({"shoulder_pan": (held, 0.6)}, 1.0), motion_id=2)
    moving.rig.until(lambda: len(moving.rig.ended) == 2)
    assert moving.rig.outcomes[-1] is Outcome.REACHED
    assert moving.controller.goal_rad[PAN] == pytest.approx(0.6)


def test_a_second_joint_that_stalls_in_the_braking_yields_as_well() -> None:
    moving = Moving()
    for joint, at_rad in ((PAN, OBSTACLE_RAD), (WRIST, -0.2)):
        moving.block(joint, at_rad)
    moving.until_fault(FaultCode.STALLED)
    moving.run(1.5)
    assert moving.controller.goal_rad[[PAN, WRIST]] == pytest.approx([OBSTACLE_RAD, -0.2], abs=0.02)


def test_an_emergency_stop_that_holds_stops_the_goals_within_one_tick_also_in_the_braking_of_a_fault() -> None:
    moving = moving_into_fault(FaultCode.VOLTAGE_LOW, LOW_SUPPLY, on_emergency_stop=EmergencyPolicy.HOLD)
    at_stop_rad = moving.controller.goal_rad
    moving.rig.begin(Order.EMERGENCY_STOP)
    moving.run(0.5)
    assert moving.controller.goal_rad == pytest.approx(at_stop_rad)
    assert moving.rig.torque() == [1] * 6


def test_a_reset_in_the_braking_of_a_fault_waits_for_its_end() -> None:
    moving = moving_into_fault(FaultCode.TORQUE_LOST, {"torque_off": [3]})
    answer = moving.rig.begin(Order.RESET_FAULT)
    moving.run(2.0)
    assert moving.rig.answer(answer) is not None
    assert moving.rig.mode is Mode.HOLDING
    assert moving.accelerations()[:, [PAN, WRIST]].max() <= TOLERANCE
