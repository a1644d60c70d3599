from __future__ import annotations

import re

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.faults import Fault, FaultCode
from robot.messages import ArmState, Mode
from server.moveit.readiness import unusable

GOAL = np.zeros(6)
STALLED = Fault(FaultCode.STALLED, "joint elbow_flex pushes in vain", "elbow_flex")

UNUSABLE = {
    "disconnected": (
        ArmState(0.0, Mode.DISCONNECTED, (), reason="unplugged"),
        MoveItErrorCode.COMMUNICATION_FAILURE,
        "the arm is not connected: unplugged",
    ),
    "refused by its checks": (
        ArmState(0.0, Mode.CONNECTED, (), reason="servo 3 is missing"),
        MoveItErrorCode.COMMUNICATION_FAILURE,
        "the arm is not ready: servo 3 is missing",
    ),
    "relaxed": (ArmState(0.0, Mode.RELAXED, (), goal_rad=GOAL), MoveItErrorCode.CONTROL_FAILED, "/arm/enable"),
    "fault": (
        ArmState(0.0, Mode.FAULT, (), goal_rad=GOAL, fault=STALLED),
        MoveItErrorCode.CONTROL_FAILED,
        "joint elbow_flex pushes in vain. Clear what blocks the joint, then reset the fault. .*/arm/reset_fault",
    ),
}


@pytest.mark.parametrize(("state", "code", "words"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_an_arm_that_cannot_move_says_why_and_what_to_do(state: ArmState, code: MoveItErrorCode, words: str) -> None:
    failure = unusable(state, 0.0)
    assert failure is not None
    assert failure.code is code
    assert re.search(words, failure.message)


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.MOVING])
def test_an_arm_that_holds_or_moves_takes_motions(mode: Mode) -> None:
    assert unusable(ArmState(0.0, mode, (), goal_rad=GOAL), 0.1) is None


def test_a_state_that_is_old_is_not_relied_on() -> None:
    failure = unusable(ArmState(0.0, Mode.HOLDING, (), goal_rad=GOAL), 1.5)
    assert failure is not None
    assert failure.code is MoveItErrorCode.ROBOT_STATE_STALE
