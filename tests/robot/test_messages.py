from __future__ import annotations

import pickle

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robot.messages import ArmState, Mode

NUMBERS = st.lists(st.floats(), max_size=8).map(lambda numbers: np.array(numbers, dtype=float))


@given(NUMBERS, NUMBERS)
def test_arrays_of_frequent_messages_arrive_as_they_were_sent(position_rad: np.ndarray, goal_rad: np.ndarray) -> None:
    sent = ArmState(1.0, Mode.MOVING, ("gripper",), position_rad=position_rad, goal_rad=goal_rad, lateness_s=(0.1,))
    got = pickle.loads(pickle.dumps(sent))
    for given_rad, got_rad in ((position_rad, got.position_rad), (goal_rad, got.goal_rad)):
        assert (got_rad.dtype, got_rad.shape) == (given_rad.dtype, given_rad.shape)
        np.testing.assert_array_equal(got_rad, given_rad)
    assert (got.mode, got.joint_names, got.lateness_s, got.velocity_rad_s) == (Mode.MOVING, ("gripper",), (0.1,), None)
