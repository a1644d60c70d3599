from __future__ import annotations

from dataclasses import replace

import numpy as np

from robot.messages import ArmState, Mode
from server.moveit.recorder import MAX_SAMPLES, Recorder

STATE = ArmState(5.0, Mode.MOVING, ("a", "b"), position_rad=np.array([0.1, 0.2]), velocity_rad_s=np.array([1.0, 2.0]))


def test_what_was_read_since_the_start_is_a_trajectory_from_time_0() -> None:
    recorder = Recorder()
    recorder.take_state(STATE)
    recorder.start()
    for stamp_s in (6.0, 6.5):
        recorder.take_state(replace(STATE, stamp_s=stamp_s))
    way = recorder.finish(("b",))
    assert way is not None
    assert way.time_s.tolist() == [0.0, 0.5]
    assert way.positions_rad.tolist() == [[0.2], [0.2]]
    assert way.velocities_rad_s.tolist() == [[2.0], [2.0]]


def test_an_arm_that_was_not_read_has_no_way() -> None:
    recorder = Recorder()
    recorder.start()
    recorder.take_state(replace(STATE, position_rad=None))
    assert recorder.finish(("a",)) is None
    assert recorder.finish(("a",)) is None


def test_times_increase_though_a_clock_was_set_back() -> None:
    recorder = Recorder()
    recorder.start()
    for stamp_s in (6.0, 5.0, 6.0, 7.0):
        recorder.take_state(replace(STATE, stamp_s=stamp_s))
    way = recorder.finish(("a",))
    assert way is not None
    assert way.time_s.tolist() == [0.0, 1.0]


def test_a_recording_is_bounded() -> None:
    recorder = Recorder()
    recorder.start()
    for number in range(MAX_SAMPLES + 10):
        recorder.take_state(replace(STATE, stamp_s=float(number)))
    way = recorder.finish(("a",))
    assert way is not None
    assert way.duration_s == MAX_SAMPLES - 1
