"""The recorder: positions it takes, and ends it comes to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robot.messages import ArmState, Mode
from server.errors import ServiceError
from server.teaching.services import TeachingRecorder, joints_to_teach
from server.teaching.taught_motion import MAX_DURATION_S
from tests.helpers.fake_arm import JOINTS
from tests.helpers.moveit import ROBOT, SEVEN

RELAXED = ArmState(1.0, Mode.RELAXED, JOINTS, position_rad=np.arange(6.0), goal_rad=np.arange(6.0) + 9.0)


def test_a_relaxed_arm_is_recorded_where_it_is_measured() -> None:
    recorder = TeachingRecorder("wave", ("elbow_flex", "gripper"))
    for clock_s in (5.0, 5.02, 5.04):
        assert recorder.take_state(replace(RELAXED, clock_s=clock_s)) == ""
    time_s, positions_rad = recorder.samples
    assert time_s.tolist() == [5.0, 5.02, 5.04]
    assert positions_rad.tolist() == [[2.0, 5.0]] * 3
    assert recorder.duration_s == pytest.approx(0.04)


def test_a_driven_arm_is_recorded_where_it_is_commanded() -> None:
    recorder = TeachingRecorder("wave", ("elbow_flex",))
    recorder.take_state(replace(RELAXED, goal_rad=np.arange(6.0) + 0.5, torque_enabled=True))
    assert recorder.samples[1].tolist() == [[2.5]]


def test_states_that_come_twice_count_once() -> None:
    recorder = TeachingRecorder("wave", JOINTS)
    for clock_s in (1.0, 1.0, 1.001, 1.02):
        recorder.take_state(replace(RELAXED, clock_s=clock_s))
    assert recorder.points == 2


@pytest.mark.parametrize(
    ("state", "says"),
    [
        (replace(RELAXED, clock_s=1.0 + MAX_DURATION_S + 0.1), "600 s at most"),
        (replace(RELAXED, clock_s=0.5), "started again"),
        (replace(RELAXED, clock_s=2.0, mode=Mode.DISCONNECTED, reason="unplugged"), "not connected: unplugged"),
        (replace(RELAXED, clock_s=2.0, position_rad=None), "not connected"),
    ],
)
def test_a_recording_that_cannot_go_on_ends_with_the_reason(state: ArmState, says: str) -> None:
    recorder = TeachingRecorder("wave", JOINTS)
    recorder.take_state(replace(RELAXED, clock_s=1.0))
    assert says in recorder.take_state(state)
    assert recorder.points == 1


def test_the_arm_and_its_gripper_are_recorded_unless_a_group_is_named() -> None:
    assert joints_to_teach(ROBOT, "") == JOINTS
    assert joints_to_teach(ROBOT, "gripper") == ("gripper",)
    assert joints_to_teach(SEVEN, "") == SEVEN.groups[SEVEN.default_group].joints
    with pytest.raises(ServiceError, match="must be one of arm, gripper, not 'leg'"):
        joints_to_teach(ROBOT, "leg")
