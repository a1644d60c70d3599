from types import SimpleNamespace

import numpy as np
import pytest

from protocol.messages import Stamp, complete
from protocol.registry import Registry
from robot.description import model
from robot.messages import ArmState, Mode
from server.moveit.current_state import CurrentState, state_message

ROBOT = model.builtin()
NAMES = ("shoulder_pan", "gripper")


def current(**parts):
    return CurrentState(SimpleNamespace(state=ArmState(0.0, Mode.HOLDING, NAMES, **parts)), ROBOT)


def test_what_the_arm_holds_is_told_and_not_where_it_droops_to():
    state = current(position_rad=np.array([0.1, 0.2]), goal_rad=np.array([0.3, 0.4]))
    assert state.positions_rad() == {"shoulder_pan": 0.3, "gripper": 0.4}


def test_a_relaxed_arm_is_where_it_is_measured():
    assert current(position_rad=np.array([0.1, 0.2])).positions_rad() == {"shoulder_pan": 0.1, "gripper": 0.2}


def test_a_disconnected_arm_has_no_positions_and_a_message_without_joints():
    assert current().positions_rad() is None
    assert current().message()["joint_state"]["name"] == []


@pytest.mark.parametrize("positions_rad", [{}, {"shoulder_pan": 0.3}])
def test_the_message_is_complete_as_it_is(positions_rad):
    message = state_message(positions_rad, ROBOT.root_link, 12.5)
    assert complete(Registry.load(), "moveit_msgs/RobotState", message, Stamp(0, 0)) == message
    assert message["joint_state"]["header"] == {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "base_link"}
