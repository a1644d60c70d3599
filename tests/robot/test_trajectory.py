"""Trajectories and faults as the arm's messages carry them."""

import itertools
import math
import pickle
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.faults import ADVICE, REMEDIES, SIMULATED_REMEDIES, Fault, FaultCode, ServoAlert, advise
from robot.hardware.interface import StatusFlag
from robot.messages import ArmState, Mode
from robot.trajectory import MotionLimits, Trajectory, bridge, rest_to_rest
from tests.helpers.motions import smooth_move


@given(st.floats(min_value=-1.0, max_value=5.0))
def test_velocity_is_the_derivative_of_position(time_s: float) -> None:
    trajectory = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.4, -0.3)}, duration_s=2.0)
    step_s = 1e-5
    before, after = trajectory.sample(time_s - step_s)[0], trajectory.sample(time_s + step_s)[0]
    slope = (after - before) / (2.0 * step_s)
    if step_s < time_s < 2.0 - step_s:
        assert trajectory.sample(time_s)[1] == pytest.approx(slope, abs=1e-3)
    else:
        assert slope == pytest.approx(np.zeros(2), abs=1e-3)


def test_a_single_sample_lasts_no_time() -> None:
    zero = np.zeros((1, 1))
    trajectory = Trajectory(("shoulder_pan",), np.zeros(1), zero + 0.3, zero, zero)
    assert trajectory.duration_s == 0.0
    assert trajectory.sample(0.5)[0] == pytest.approx([0.3])


POSITION = st.floats(-3.0, 3.0)
LIMIT = st.floats(0.05, 20.0)


@given(POSITION, POSITION, LIMIT, LIMIT)
def test_a_motion_from_rest_to_rest_is_as_short_as_can_be(start: float, end: float, speed: float, push: float) -> None:
    motion = rest_to_rest("jaw", start, end, speed, push)
    assert motion.positions_rad[-1, 0] == pytest.approx(end)
    assert motion.velocities_rad_s[0, 0] == motion.velocities_rad_s[-1, 0] == 0.0
    assert motion.time_s[0] == 0.0
    assert (np.diff(motion.time_s) > 0.0).all()
    assert np.abs(motion.velocities_rad_s).max() <= speed * (1 + 1e-9)
    assert np.abs(motion.accelerations_rad_s2).max() <= push
    way = abs(end - start)
    fastest_s = 2.0 * math.sqrt(way / push) if way * push <= speed**2 else way / speed + speed / push
    assert motion.duration_s == pytest.approx(fastest_s, abs=1e-2, rel=1e-6)
    assert rest_to_rest("jaw", start, start, speed, push).duration_s == 0.0
    # Extreme limits have a motion, too.
    for limits in ((5e-324, 10.0), (2.0, 5e-324), (1e6, 1e6)):
        assert rest_to_rest("jaw", 0.0, 1.0, *limits).positions_rad[-1, 0] == pytest.approx(1.0)


def test_between_the_corners_the_speed_is_the_slope_of_the_way() -> None:
    motion = rest_to_rest("jaw", 1.5, -0.1, 2.5, 10.0)
    for time_s in np.linspace(0.001, motion.duration_s - 0.001, 200):
        slope = (motion.sample(time_s + 1e-5)[0] - motion.sample(time_s - 1e-5)[0]) / 2e-5
        assert slope == pytest.approx(motion.sample(time_s)[1], abs=1e-3)


@pytest.mark.parametrize("speed", [1e-17, 1e-15, 1e-12, 1e-9, 1e-6])
def test_joints_that_rest_but_for_rounding_have_a_bridge(speed: float) -> None:
    rng, joints = np.random.default_rng(7), tuple("abcdef")
    limits = MotionLimits(np.full(6, 2.0), np.full(6, 6.0), np.full(6, 300.0))
    for _ in range(200):
        position = rng.uniform(-1.0, 1.0, 6)
        start = position, speed * rng.normal(size=6), np.zeros(6)
        end = bridge(joints, start, (position, np.zeros(6)), limits, 0.0).positions_rad[-1]
        assert end == pytest.approx(position, abs=1e-9)


NUMBERS = st.lists(st.floats(), max_size=8).map(lambda numbers: np.array(numbers, dtype=float))


@given(NUMBERS, NUMBERS)
def test_arrays_of_frequent_messages_arrive_as_they_were_sent(position_rad: np.ndarray, goal_rad: np.ndarray) -> None:
    sent = ArmState(1.0, Mode.MOVING, ("gripper",), position_rad=position_rad, goal_rad=goal_rad, lateness_s=(0.1,))
    got = pickle.loads(pickle.dumps(sent))
    for given_rad, got_rad in ((position_rad, got.position_rad), (goal_rad, got.goal_rad)):
        assert (got_rad.dtype, got_rad.shape) == (given_rad.dtype, given_rad.shape)
        np.testing.assert_array_equal(got_rad, given_rad)
    assert (got.mode, got.joint_names, got.lateness_s, got.velocity_rad_s) == (Mode.MOVING, ("gripper",), (0.1,), None)


# Things that only an arm of metal has, or that only a person at one can do.
OF_METAL = re.compile("cable|usb|plug |plugs|power supply|servos' supply|gear|screw|machine|replace|cut ")


def test_every_fault_has_a_remedy_of_whole_sentences_and_for_a_simulated_arm_of_nothing_that_only_metal_has() -> None:
    assert set(REMEDIES) == set(FaultCode)
    for code, simulated in itertools.product(FaultCode, (False, True)):
        remedy = Fault(code, "", simulated=simulated).remedy
        assert remedy[0].isupper(), code
        assert remedy.endswith("."), code
        assert not simulated or not OF_METAL.findall(remedy.lower()), code
    for code, simulated_remedy in SIMULATED_REMEDIES.items():
        assert Fault(code, "").remedy == REMEDIES[code] != simulated_remedy
    fault = Fault(FaultCode.STALLED, "joint elbow_flex stands still at 0.52 rad with 80 % of its torque", "elbow_flex")
    assert str(fault).startswith("joint elbow_flex stands still at 0.52 rad with 80 % of its torque. Clear what")


# Their sentences say what to do.
SELF_EXPLAINING = {ServoAlert[name] for name in ("POSITION_LIMITS", "RETURN_DELAY", "EPROM_UNLOCKED", "NO_WATCHDOG")}


def test_every_other_alert_has_its_meaning_and_a_remedy_in_the_words_of_the_fault() -> None:
    assert set(ADVICE) == set(ServoAlert) - SELF_EXPLAINING
    assert all(advice.means and advice.remedy().endswith(".") for advice in ADVICE.values())
    assert advise(SELF_EXPLAINING) == []
    # Every status flag is an alert.
    assert {ServoAlert(str(flag.name).lower()) for flag in StatusFlag} <= set(ADVICE)
    (said,) = advise([ServoAlert.OVERLOAD, ServoAlert.OVERLOAD])
    assert said.startswith("overload: the load was too high for too long")
    assert said.endswith(REMEDIES[FaultCode.OVERLOAD])
    (simulated,) = advise([ServoAlert.OVERLOAD], simulated=True)
    assert simulated.endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])
