import numpy as np
import pinocchio as pin
import pytest

from planners.scene import Pose
from planners.servo.question import Anchor, ServoLimits, TipTarget, TipTwist
from planners.servo.wish import GAIN_PER_S, HELD_DRIFT_M, MAX_DRIFT_M, MAX_DRIFT_RAD, aimed, loosened, steered

ORIGIN = Anchor(Pose())


def tip(position_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.exp3(np.array(turn_rad)), np.array(position_m))


def test_what_lies_along_the_motion_is_left_and_what_lies_across_is_brought_back():
    wish = steered(TipTwist((0.1, 0.0, 0.0)), tip((0.005, 0.004, 0.0)), ORIGIN)
    assert wish.linear_m_s == pytest.approx([0.1, -0.004 * GAIN_PER_S, 0.0])
    assert wish.anchor.pose.position_m == pytest.approx((0.005, 0.0, 0.0))


def test_turns_are_treated_alike():
    wish = steered(TipTwist(angular_rad_s=(0.0, 0.0, 0.5)), tip(turn_rad=(0.02, 0.0, 0.1)), ORIGIN)
    assert wish.angular_rad_s[2] == pytest.approx(0.5, abs=0.01)
    assert wish.angular_rad_s[0] == pytest.approx(-0.02 * GAIN_PER_S, abs=0.01)
    assert wish.linear_m_s == pytest.approx([0.0, 0.0, 0.0])


def test_a_tip_that_is_let_go_of_is_not_called_back_along_its_motion():
    moved = steered(TipTwist((0.1, 0.0, 0.0)), tip(), None).anchor
    wish = steered(TipTwist(), tip((0.02, 0.003, 0.0)), moved)
    assert wish.linear_m_s == pytest.approx([0.0, -0.003 * GAIN_PER_S, 0.0])


def test_a_tip_that_is_let_go_of_is_not_turned_any_more():
    wish = steered(TipTwist(), tip(turn_rad=(0.1, 0.0, 0.0)), ORIGIN)
    assert wish.angular_rad_s == pytest.approx([0.0, 0.0, 0.0])
    assert wish.drift_rad == pytest.approx(0.1)


def test_an_anchor_that_cannot_be_kept_comes_along():
    wish = steered(TipTwist((0.1, 0.0, 0.0)), tip((0.0, 0.5, 0.0), (1.0, 0.0, 0.0)), ORIGIN)
    assert 0.5 - wish.anchor.pose.position_m[1] == pytest.approx(MAX_DRIFT_M)
    assert wish.drift_rad == pytest.approx(MAX_DRIFT_RAD)


def test_a_target_far_away_is_approached_at_the_greatest_speed_and_one_near_slower():
    limits = ServoLimits(linear_m_s=0.2, angular_rad_s=0.8)
    far = aimed(TipTarget(Pose((1.0, 0.0, 0.0))), tip(turn_rad=(2.0, 0.0, 0.0)), limits)
    assert far.linear_m_s == pytest.approx([0.2, 0.0, 0.0])
    assert np.linalg.norm(far.angular_rad_s) == pytest.approx(0.8)
    near = aimed(TipTarget(Pose((0.01, 0.0, 0.0))), tip(), limits)
    assert near.linear_m_s == pytest.approx([0.01 * GAIN_PER_S, 0.0, 0.0])


def test_a_tip_that_is_held_back_is_hardly_pulled_and_not_turned():
    anchor = Anchor(Pose((0.1, 0.0, 0.0)), along=(0.0, 0.0, 1.0))
    found = loosened(anchor, tip(turn_rad=(0.3, 0.0, 0.0)))
    assert found.pose.position_m == pytest.approx((HELD_DRIFT_M, 0.0, 0.0))
    assert found.along == anchor.along
    assert steered(TipTwist(), tip(turn_rad=(0.3, 0.0, 0.0)), found).drift_rad == pytest.approx(0.0, abs=1e-9)
