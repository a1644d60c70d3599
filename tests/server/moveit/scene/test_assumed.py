import gc
import math

import pytest

from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.scene.scene_state import AssumedStates
from server.node import Node
from tests.helpers.planning_scene import BENT, ROBOT, message


def state(is_diff=True, **positions):
    joint_state = {"name": list(positions), "position": list(positions.values())}
    return message("RobotState", joint_state=joint_state, is_diff=is_diff)


def said(*states, told=None):
    assumed, node = AssumedStates(ROBOT), Node("client")
    if told is not None:
        assumed.tell(node, told)
    for each in states:
        assumed.assume(node, assumed.stated(node, each))
    return assumed.of(node)


def test_nobody_has_assumed_anything_at_first():
    assert said() is None
    assert said(state()) is None


def test_what_is_stated_is_assumed_by_that_client_alone():
    assumed, one, other = AssumedStates(ROBOT), Node("one"), Node("other")
    assumed.assume(one, assumed.stated(one, state(gripper=0.5)))
    assert (assumed.of(one), assumed.of(other)) == ({"gripper": 0.5}, None)


def test_a_difference_leaves_the_other_joints_and_a_whole_state_does_not():
    assert said(state(gripper=0.5), state(wrist_roll=0.1)) == {"gripper": 0.5, "wrist_roll": 0.1}
    assert said(state(gripper=0.5), state(is_diff=False, wrist_roll=0.1)) == {"wrist_roll": 0.1}


def test_what_was_told_says_nothing_when_it_is_sent_back():
    assert said(state(**BENT), told=BENT) is None
    assert said(state(gripper=0.5), state(gripper=0.5), told=BENT) == {"gripper": 0.5}


def test_back_to_what_was_told_before_is_stated_after_something_else():
    assert said(state(gripper=0.5), state(gripper=BENT["gripper"]), told=BENT) == {"gripper": BENT["gripper"]}


def test_what_is_not_assumed_is_as_measured():
    assumed = AssumedStates(ROBOT)
    assert assumed.completed({"gripper": 0.5}, BENT) == {**BENT, "gripper": 0.5}
    assert assumed.completed(None, BENT) == BENT
    assert assumed.completed({"gripper": 0.5}, None) is None
    assert assumed.completed(BENT, None) == BENT


def test_a_client_that_has_left_is_forgotten():
    assumed, node = AssumedStates(ROBOT), Node("client")
    assumed.assume(node, {"gripper": 0.5})
    assert len(assumed._assumed) == 1
    del node
    gc.collect()
    assert len(assumed._assumed) == 0


@pytest.mark.parametrize(
    ("joint_state", "words"),
    [
        ({"name": ["gripper"], "position": []}, "name has 1 entries and position 0"),
        ({"name": ["knee"], "position": [0.0]}, "there is no joint 'knee'"),
        ({"name": ["gripper"], "position": [math.nan]}, "joint 'gripper' must be a finite number, not nan"),
    ],
)
def test_a_state_that_is_none_is_refused(joint_state, words):
    with pytest.raises(RefusedError, match=words) as refusal:
        AssumedStates(ROBOT).stated(Node("client"), message("RobotState", joint_state=joint_state))
    assert refusal.value.failure.code is MoveItErrorCode.INVALID_ROBOT_STATE
