from __future__ import annotations

import pytest

from robot.calibration import TICKS_PER_TURN
from robot.commissioning.directions import asked_motions
from robot.commissioning.session import (
    AGAIN,
    AS_IT_IS,
    DONE,
    RELAX,
    SKIP,
    SKIP_ALL,
    WRITE_NOW,
    Act,
    CalibrationSession,
)
from robot.errors import CalibrationError
from tests.helpers.robots import SO101_SERVOS, nominal_calibration, so101

IDS = tuple(servo.servo_id for servo in SO101_SERVOS)
MOTIONS = asked_motions(so101())
STOPS = {joint.servo_id: (joint.range_min, joint.range_max) for joint in nominal_calibration().joints}
ROLL, GRIPPER = 5, 6
MIDDLE = 2000


class Hand:
    """A hand on a relaxed arm whose servos stand so many ticks off: it moves joints, and the session is told."""

    def __init__(self, session, shift=0):
        self.session = session
        self.shift = shift
        self.at = dict.fromkeys(IDS, MIDDLE)

    def ticks(self):
        return {servo: (ticks + self.shift) % TICKS_PER_TURN for servo, ticks in self.at.items()}

    def move(self, servo, ticks):
        while self.at[servo] != ticks:
            self.at[servo] += max(-400, min(400, ticks - self.at[servo]))
            self.session.take(self.ticks())

    def sweep(self, servos=(1, 2, 3, 4, 6)):
        for servo in servos:
            for stop in (*STOPS[servo], MIDDLE):
                self.move(servo, stop)


def begun(*, recentre=True, motions=MOTIONS, shift=0, offset=0):
    session = CalibrationSession(SO101_SERVOS, motions, recentre=recentre)
    hand = Hand(session, shift)
    assert session.answer(RELAX) is Act.RELAX
    session.begin(hand.ticks(), dict.fromkeys(IDS, offset))
    return session, hand


def to_directions(session, hand):
    hand.sweep()
    session.answer(DONE)
    assert session.step.name == "middle of wrist_roll"
    session.answer(DONE)


def to_direction_of(session, joint):
    while session.step.name != f"direction of {joint}":
        session.answer(SKIP)


def test_nothing_but_relaxing_is_asked_before_the_arm_is_relaxed():
    session = CalibrationSession(SO101_SERVOS, MOTIONS, recentre=True)
    assert session.ranges() == ()
    with pytest.raises(CalibrationError, match="relax the arm"):
        session.answer(DONE)
    assert session.step.answers == (RELAX,)


@pytest.mark.parametrize("shift", [0, 1500, 2600])
def test_a_whole_session_gives_the_true_stops_wherever_the_encoders_stand(shift):
    session, hand = begun(shift=shift)
    to_directions(session, hand)
    session.answer(SKIP_ALL)
    assert session.step.name == "write"
    for joint in session.calibration.joints:
        low, high = STOPS[joint.servo_id]
        if joint.servo_id != ROLL:
            assert joint.range_max - joint.range_min == high - low
            assert (joint.range_min + joint.homing_offset - low - shift) % TICKS_PER_TURN == 0
    assert session.answer(WRITE_NOW) is Act.WRITE
    session.finish()
    assert session.step is None
    assert session.progress == 1.0


def test_a_joint_that_met_one_stop_only_is_named_and_taken_on_the_persons_word():
    session, hand = begun(motions={})
    hand.sweep((1, 2, 4, 6))
    hand.move(3, STOPS[3][0])
    with pytest.raises(CalibrationError, match=r"elbow_flex has \d+% of the expected range"):
        session.answer(DONE)
    assert session.step.name == "sweep"
    session.answer(AS_IT_IS)
    assert "elbow_flex covered 4" in session.findings[0]
    assert "its zero is wrong by half of the missing part" in session.findings[0]


SHORT_OF_STOP = STOPS[3][1] - round(0.19 * (STOPS[3][1] - STOPS[3][0]))


def swept_but_short():
    session, hand = begun(motions={})
    hand.sweep((1, 2, 4, 6))
    for ticks in (STOPS[3][0], SHORT_OF_STOP, MIDDLE):
        hand.move(3, ticks)
    return session, hand


def test_a_sweep_that_turned_round_before_a_stop_is_noticed():
    session, _ = swept_but_short()
    with pytest.raises(CalibrationError, match=r"elbow_flex has \d+% of the .*: move it to both stops once more"):
        session.answer(DONE)


@pytest.mark.parametrize(("upper", "accepted"), [(SHORT_OF_STOP, True), (SHORT_OF_STOP - 60, False)])
def test_a_short_range_is_taken_where_both_of_its_ends_were_met_twice(upper, accepted):
    session, hand = swept_but_short()
    for ticks in (STOPS[3][0], upper, MIDDLE):
        hand.move(3, ticks)
    assert {each.joint: each.done for each in session.ranges()}["elbow_flex"] is accepted


def test_a_stop_behind_an_end_that_was_met_twice_counts_from_the_first_visit_on():
    session, hand = swept_but_short()
    for ticks in (STOPS[3][0], SHORT_OF_STOP, MIDDLE, SHORT_OF_STOP + 60, MIDDLE):
        hand.move(3, ticks)
    assert not {each.joint: each.done for each in session.ranges()}["elbow_flex"]


def test_a_free_joint_that_met_its_stops_is_calibrated_by_them_and_its_middle_is_not_asked_for():
    session, hand = begun(motions={})
    hand.sweep()
    for ticks in (3981, 113, MIDDLE):
        hand.move(ROLL, ticks)
    session.answer(DONE)
    roll = session.calibration.joints[4]
    assert (roll.homing_offset, roll.range_min, roll.range_max) == (0, 113, 3981)


def test_a_joint_that_was_not_touched_is_refused_all_the_same():
    session, hand = begun()
    hand.sweep((1, 2, 4, 6))
    with pytest.raises(CalibrationError, match="elbow_flex"):
        session.answer(DONE)
    with pytest.raises(CalibrationError, match="elbow_flex: was moved by 0 ticks"):
        session.answer(AS_IT_IS)


@pytest.mark.parametrize(("by_ticks", "mirrored"), [(-300, True), (300, False)])
def test_a_gripper_is_mirrored_if_it_opens_towards_lower_ticks(by_ticks, mirrored):
    session, hand = begun()
    to_directions(session, hand)
    to_direction_of(session, "gripper")
    hand.move(GRIPPER, MIDDLE + by_ticks)
    session.answer(DONE)
    assert session.calibration.joints[-1].drive_mode == int(mirrored)
    assert any("gripper is mirrored" in finding for finding in session.findings) is mirrored


def test_a_mirrored_joint_of_the_arm_is_named_with_its_sign_and_nothing_is_written():
    session, hand = begun()
    to_directions(session, hand)
    to_direction_of(session, "elbow_flex")
    # The model's elbow falls when the forearm goes up.
    hand.move(3, MIDDLE + 300)
    session.answer(DONE)
    assert any("elbow_flex turned the other way" in each and "sign = -1" in each for each in session.findings)
    session.answer(SKIP_ALL)
    assert session.step.answers == (AGAIN,)
    assert "mend elbow_flex first" in session.step.instruction
    assert {joint.drive_mode for joint in session.calibration.joints} == {0}


def test_a_direction_counts_from_the_question_on():
    session, hand = begun()
    to_directions(session, hand)
    to_direction_of(session, "elbow_flex")
    with pytest.raises(CalibrationError, match="elbow_flex: was moved by 0 ticks"):
        session.answer(DONE)
    assert session.step.name == "direction of elbow_flex"


def test_a_sweep_can_be_done_again_and_forgets_the_first():
    session, hand = begun(motions={})
    hand.move(1, STOPS[1][1] - 600)
    to_directions(session, hand)
    assert session.answer(AGAIN) is None
    assert session.step.name == "sweep"
    assert session.calibration is None
    assert all(each.lowest == each.highest for each in session.ranges())


def test_what_the_servos_tell_after_the_sweep_changes_the_result_no_more():
    session, hand = begun(motions={})
    to_directions(session, hand)
    before = session.calibration
    hand.move(1, STOPS[1][1])
    assert session.calibration == before
    assert session.ranges()[0].present == MIDDLE


def test_the_offsets_of_the_servos_count_into_the_new_ones():
    offsets = []
    for offset in (0, 100):
        session, hand = begun(motions={}, offset=offset)
        to_directions(session, hand)
        offsets.append([joint.homing_offset for joint in session.calibration.joints])
    assert [b - a for a, b in zip(*offsets, strict=True)] == [100] * 6


def test_progress_never_falls_on_the_way():
    session, hand = begun()
    seen = [session.progress]
    hand.sweep()
    for answer in (DONE, DONE, *[SKIP] * 6):
        seen.append(session.progress)
        session.answer(answer)
    assert seen == sorted(seen)
    assert session.step.name == "write"
