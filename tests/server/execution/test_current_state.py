from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from robot.description import model
from robot.faults import Fault, FaultCode
from robot.messages import ArmState, Mode
from server.errors import RefusedError
from server.execution.current_state import CurrentState, check_ready, state_message

ROBOT = model.builtin()
NAMES = ("shoulder_pan", "gripper")

GOAL = np.zeros(6)
METAL_MAX_AGE_S, SIMULATED_MAX_AGE_S = 1.0, 5.0
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


def current(**parts):
    return CurrentState(SimpleNamespace(state=ArmState(0.0, Mode.HOLDING, NAMES, **parts)), ROBOT)


def test_positions_are_those_that_the_arm_holds_and_not_those_it_droops_to():
    state = current(position_rad=np.array([0.1, 0.2]), goal_rad=np.array([0.3, 0.4]))
    assert state.positions_rad() == {"shoulder_pan": 0.3, "gripper": 0.4}


def test_positions_of_a_relaxed_arm_are_measured():
    assert current(position_rad=np.array([0.1, 0.2])).positions_rad() == {"shoulder_pan": 0.1, "gripper": 0.2}


def test_a_disconnected_arm_has_no_positions_and_a_message_without_joints():
    assert current().positions_rad() is None
    assert current().message()["joint_state"]["name"] == []


@pytest.mark.parametrize("positions_rad", [{}, {"shoulder_pan": 0.3}])
def test_the_message_is_complete_as_it_is(positions_rad):
    message = state_message(positions_rad, ROBOT.root_link, 12.5)
    assert complete(Registry.load(), "moveit_msgs/RobotState", message, Stamp(0, 0)) == message
    assert message["joint_state"]["header"] == {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "base_link"}


@dataclass
class Read:
    """An arm as it was read last."""

    state: ArmState
    state_age_s: float = 0.1
    state_max_age_s: float = METAL_MAX_AGE_S


@pytest.mark.parametrize(("state", "code", "words"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_an_arm_that_is_not_ready_names_reason_and_remedy(state: ArmState, code: MoveItErrorCode, words: str) -> None:
    with pytest.raises(RefusedError, match=words) as refused:
        check_ready(Read(state))
    assert refused.value.failure.code is code


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.MOVING])
def test_an_arm_that_holds_or_moves_takes_motions(mode: Mode) -> None:
    check_ready(Read(ArmState(0.0, mode, (), goal_rad=GOAL)))


HOLDING = ArmState(0.0, Mode.HOLDING, (), goal_rad=GOAL)


@pytest.mark.parametrize(("age_s", "max_age_s"), [(1.5, METAL_MAX_AGE_S), (5.5, SIMULATED_MAX_AGE_S)])
def test_an_old_state_refuses_motions(age_s: float, max_age_s: float) -> None:
    with pytest.raises(RefusedError) as refused:
        check_ready(Read(HOLDING, age_s, max_age_s))
    assert refused.value.failure.code is MoveItErrorCode.ROBOT_STATE_STALE
    assert str(refused.value) == f"the last state of the arm is {age_s:.1f} s old (limit {max_age_s:g} s)"


def test_a_starved_simulated_arm_takes_motions() -> None:
    check_ready(Read(HOLDING, 4.5, SIMULATED_MAX_AGE_S))
