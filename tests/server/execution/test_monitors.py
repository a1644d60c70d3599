from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.arm import Arm
from robot.arm_group import ArmGroup
from robot.faults import Fault, FaultCode
from robot.messages import ArmState, Mode
from server.execution.monitors import CurrentState, check_ready
from tests.helpers.moveit import rejection


@dataclass
class Read:
    """An arm as it was read last."""

    state: ArmState
    state_age_s: float = 0.1
    state_max_age_s: float = 1.0
    name: str = ""


def test_positions_are_those_that_the_arm_holds_and_not_those_it_droops_to() -> None:
    goal_rad, position_rad = np.array([0.3, 0.4]), np.array([0.1, 0.2])
    state = ArmState(0.0, Mode.HOLDING, ("shoulder_pan", "gripper"), position_rad=position_rad, goal_rad=goal_rad)
    assert CurrentState(Read(state)).positions_rad() == {"shoulder_pan": 0.3, "gripper": 0.4}


LOST, UNFIT = MoveItErrorCode.COMMUNICATION_FAILURE, MoveItErrorCode.CONTROL_FAILED
GOAL = np.zeros(6)
HOLDING = ArmState(0.0, Mode.HOLDING, (), goal_rad=GOAL)
RELAXED = ArmState(0.0, Mode.RELAXED, (), goal_rad=GOAL)
STALLED = Fault(FaultCode.STALLED, "joint elbow_flex is stalled", "elbow_flex")
FAULTY = ArmState(0.0, Mode.FAULT, (), goal_rad=GOAL, fault=STALLED)
CLEAR = "joint elbow_flex is stalled. Clear what blocks the joint, then reset the fault. "
UNUSABLE = [
    (ArmState(0.0, Mode.DISCONNECTED, (), reason="unplugged"), LOST, "the arm is not connected: unplugged"),
    (ArmState(0.0, Mode.CONNECTED, (), reason="servo 3 is missing"), LOST, "the arm is not ready: servo 3 is missing"),
    (RELAXED, UNFIT, "the arm is relaxed: enable it by the service /arm/enable first"),
    (FAULTY, UNFIT, f"the arm has a fault: {CLEAR}The service that resets it is /arm/reset_fault."),
]


@pytest.mark.parametrize(("state", "code", "sentence"), UNUSABLE)
def test_an_arm_that_is_not_ready_names_reason_and_remedy(
    state: ArmState, code: MoveItErrorCode, sentence: str
) -> None:
    refused = rejection(check_ready, Read(state))
    assert (refused.code, refused.message) == (code, sentence)


def test_a_refusal_names_the_one_of_several_arms_that_is_not_ready() -> None:
    states = {"leader": RELAXED, "left": HOLDING, "right": RELAXED}
    arms = {name: (cast("Arm", Read(state, name=name)), ()) for name, state in states.items()}
    refused = rejection(check_ready, ArmGroup(arms, ("leader",)))
    sentence = "the arm right is relaxed: enable it by the service /right/arm/enable first"
    assert (refused.code, refused.message) == (UNFIT, sentence)
    faulty = rejection(check_ready, Read(FAULTY, name="right")).message
    assert faulty == f"the arm right has a fault: {CLEAR}The service that resets it is /right/arm/reset_fault."


@pytest.mark.parametrize(("age_s", "max_age_s"), [(1.5, 1.0), (5.5, 5.0)])
def test_an_old_state_refuses_motions(age_s: float, max_age_s: float) -> None:
    refused = rejection(check_ready, Read(HOLDING, age_s, max_age_s))
    assert refused.code is MoveItErrorCode.ROBOT_STATE_STALE
    assert refused.message == f"the last state of the arm is {age_s:.1f} s old (limit {max_age_s:g} s)"
