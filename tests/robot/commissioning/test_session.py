import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import MAX_TICK, TICKS_PER_TURN
from robot.commissioning.session import (
    AGAIN,
    AS_IT_IS,
    DONE,
    LEAST_MOTION_TICKS,
    LEAST_SWEEP_TICKS,
    MIDDLE_TICK,
    RELAX,
    SKIP,
    SKIP_ALL,
    WIDEST_SWEEP_TICKS,
    WRITE_NOW,
    Act,
    AskedMotion,
    CalibrationSession,
    Sweep,
    asked_motions,
    expected_width,
    met_both_stops,
    place,
    place_free,
    turned_the_other_way,
)
from robot.commissioning.verify import LIMIT_MARGIN_RAD, Droop, poses, seen_findings
from robot.description import robot_folder
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.servo_table import MAX_HOMING_OFFSET
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


def at_direction_of(joint):
    session, hand = begun()
    to_directions(session, hand)
    while session.step.name != f"direction of {joint}":
        session.answer(SKIP)
    return session, hand


def test_nothing_but_relaxing_is_asked_before_the_arm_is_relaxed_and_progress_never_falls_on_the_way():
    session = CalibrationSession(SO101_SERVOS, MOTIONS, recentre=True)
    assert (session.ranges(), session.progress) == ((), 0.0)
    with pytest.raises(CalibrationError, match="relax the arm"):
        session.answer(DONE)
    assert session.step.answers == (RELAX,)
    session, hand = begun()
    seen = [session.progress]
    hand.sweep()
    for answer in (DONE, DONE, *[SKIP] * 6):
        seen.append(session.progress)
        session.answer(answer)
    assert seen == sorted(seen)
    assert session.step.name == "write"


@pytest.mark.parametrize(("shift", "offset"), [(0, 0), (1500, 0), (2600, 100)])
def test_a_whole_session_gives_the_true_stops_wherever_the_encoders_stand(shift, offset):
    session, hand = begun(shift=shift, offset=offset)
    to_directions(session, hand)
    session.answer(SKIP_ALL)
    assert session.step.name == "write"
    for joint in session.calibration.joints:
        low, high = STOPS[joint.servo_id]
        if joint.servo_id != ROLL:
            assert joint.range_max - joint.range_min == high - low
            assert (joint.range_min + joint.homing_offset - low - shift - offset) % TICKS_PER_TURN == 0
    assert session.answer(WRITE_NOW) is Act.WRITE
    session.finish()
    assert session.step is None
    assert session.progress == 1.0


def test_a_joint_that_met_one_stop_only_is_named_and_taken_on_the_persons_word_and_none_that_was_not_touched():
    session, hand = begun(motions={})
    hand.sweep((1, 2, 4, 6))
    for answer, words in ((DONE, "elbow_flex"), (AS_IT_IS, "elbow_flex: was moved by 0 ticks")):
        with pytest.raises(CalibrationError, match=words):
            session.answer(answer)
    hand.move(3, STOPS[3][0])
    with pytest.raises(CalibrationError, match=r"elbow_flex has \d+% of the expected range"):
        session.answer(DONE)
    assert session.step.name == "sweep"
    session.answer(AS_IT_IS)
    assert "elbow_flex covered 4" in session.findings[0]
    assert "its zero is wrong by half of the missing part" in session.findings[0]


SHORT_OF_STOP = STOPS[3][1] - round(0.19 * (STOPS[3][1] - STOPS[3][0]))


@pytest.mark.parametrize(
    ("second", "accepted"),
    [((SHORT_OF_STOP,), True), ((SHORT_OF_STOP - 60,), False), ((SHORT_OF_STOP, MIDDLE, SHORT_OF_STOP + 60), False)],
)
def test_a_short_range_is_taken_where_both_of_its_ends_were_met_twice_and_nothing_lies_behind(second, accepted):
    session, hand = begun(motions={})
    hand.sweep((1, 2, 4, 6))
    for ticks in (STOPS[3][0], SHORT_OF_STOP, MIDDLE, STOPS[3][0], *second, MIDDLE):
        hand.move(3, ticks)
    assert {each.joint: each.done for each in session.ranges()}["elbow_flex"] is accepted


@pytest.mark.parametrize(("by_ticks", "mirrored"), [(-300, True), (300, False)])
def test_a_gripper_is_mirrored_if_it_opens_towards_lower_ticks(by_ticks, mirrored):
    session, hand = at_direction_of("gripper")
    hand.move(GRIPPER, MIDDLE + by_ticks)
    session.answer(DONE)
    assert session.calibration.joints[-1].drive_mode == int(mirrored)
    assert any("gripper is mirrored" in finding for finding in session.findings) is mirrored


def test_a_free_joint_that_met_its_stops_is_calibrated_by_them_and_its_middle_is_not_asked_for():
    session, hand = begun(motions={})
    hand.sweep()
    for ticks in (3981, 113, MIDDLE):
        hand.move(ROLL, ticks)
    session.answer(DONE)
    roll = session.calibration.joints[4]
    assert (roll.homing_offset, roll.range_min, roll.range_max) == (0, 113, 3981)


def test_a_mirrored_joint_of_the_arm_is_named_with_its_sign_and_nothing_is_written():
    session, hand = at_direction_of("elbow_flex")
    # Motion before the question does not count.
    with pytest.raises(CalibrationError, match="elbow_flex: was moved by 0 ticks"):
        session.answer(DONE)
    assert session.step.name == "direction of elbow_flex"
    # The model's elbow falls when the forearm goes up.
    hand.move(3, MIDDLE + 300)
    session.answer(DONE)
    assert any("elbow_flex turned the other way" in each and "sign = -1" in each for each in session.findings)
    session.answer(SKIP_ALL)
    assert session.step.answers == (AGAIN,)
    assert "mend elbow_flex first" in session.step.instruction
    assert {joint.drive_mode for joint in session.calibration.joints} == {0}


def test_the_result_of_a_sweep_changes_no_more_until_it_is_done_again_and_forgets_the_first():
    session, hand = begun(motions={})
    hand.move(1, STOPS[1][1] - 600)
    to_directions(session, hand)
    before = session.calibration
    hand.move(1, STOPS[1][1])
    assert session.calibration == before
    assert session.ranges()[0].present == MIDDLE
    assert session.answer(AGAIN) is None
    assert session.step.name == "sweep"
    assert session.calibration is None
    assert all(each.lowest == each.highest for each in session.ranges())


ELBOW = next(servo for servo in SO101_SERVOS if servo.joint == "elbow_flex")
SWEPT_ROLL = next(servo for servo in SO101_SERVOS if servo.turns_freely)

LARGEST_OFFSET = MAX_HOMING_OFFSET["feetech"]


def swept(encoder_stops, offset, start_share=0.5, servo=ELBOW):
    """A hand's sweep of one joint between two stops of its encoder, as a servo with an offset tells it: in one turn."""
    low, high = encoder_stops
    start = round(low + start_share * (high - low))

    def reading(encoder):
        return (encoder - offset) % TICKS_PER_TURN

    sweep = Sweep({servo.servo_id: reading(start)})
    way = [*range(start, low, -300), low, *range(low, high, 300), high, *range(high, start, -300), start]
    for encoder in way:
        sweep.add({servo.servo_id: reading(encoder)})
    return sweep


@given(
    st.integers(-5000, 5000),
    st.integers(LEAST_SWEEP_TICKS, WIDEST_SWEEP_TICKS),
    st.integers(-LARGEST_OFFSET, LARGEST_OFFSET),
    st.floats(0.0, 1.0),
)
def test_wherever_the_stops_are_the_placed_range_never_crosses_the_seam(lower_stop, width, offset, start_share):
    sweep = swept((lower_stop, lower_stop + width), offset, start_share)
    placed = place(ELBOW, sweep, offset, recentre=True)
    assert abs(placed.homing_offset) <= LARGEST_OFFSET
    assert 0 <= placed.range_min < placed.range_max <= MAX_TICK
    # The same stops: an encoder's position less the offset, within the turn.
    assert placed.range_max - placed.range_min == width
    assert (lower_stop - placed.homing_offset - placed.range_min) % TICKS_PER_TURN == 0
    assert abs((placed.range_min + placed.range_max) / 2 - MIDDLE_TICK) <= 1
    # A joint that hardly moved or turned round is refused.
    for refused, reason in (
        (0, "was moved by 0 ticks"),
        (LEAST_SWEEP_TICKS - 1, "was moved by"),
        (WIDEST_SWEEP_TICKS + 1, "no stops within a turn"),
        (MAX_TICK + 800, "no stops within a turn"),
    ):
        with pytest.raises(CalibrationError, match=reason):
            place(ELBOW, swept((lower_stop, lower_stop + refused), offset, start_share), offset, recentre=True)


@given(st.integers(0, MAX_TICK), st.integers(-LARGEST_OFFSET, LARGEST_OFFSET))
def test_wherever_a_free_joint_shows_its_middle_the_offset_puts_it_in_the_middle(encoder, offset):
    middle = (encoder - offset) % TICKS_PER_TURN
    placed = place_free(SWEPT_ROLL, middle, offset, recentre=True)
    assert abs((encoder - placed.homing_offset) % TICKS_PER_TURN - MIDDLE_TICK) <= 1
    assert abs(placed.homing_offset) <= LARGEST_OFFSET
    assert (placed.range_min, placed.range_max) == (0, MAX_TICK)


def test_without_a_new_offset_the_range_is_what_the_servo_reports_and_must_be_one_of_the_format():
    placed = place(ELBOW, swept((937, 3137), offset=37), 37, recentre=False)
    assert (placed.homing_offset, placed.range_min, placed.range_max) == (37, 900, 3100)
    with pytest.raises(CalibrationError, match=r"crosses the seam .*--write-servos"):
        place(ELBOW, swept((-700, 1300), offset=0), 0, recentre=False)
    assert place_free(SWEPT_ROLL, 2100, 5, recentre=False).homing_offset == 5
    with pytest.raises(CalibrationError, match="its middle is tick 2500"):
        place_free(SWEPT_ROLL, 2500, 0, recentre=False)


def test_a_joint_met_both_stops_when_it_covered_most_of_what_the_model_has_unless_it_turned_round():
    width = expected_width(ELBOW)
    assert met_both_stops(ELBOW, round(0.85 * width))
    assert not met_both_stops(ELBOW, round(0.75 * width))
    # The stops of the SO-101's wrist.
    assert met_both_stops(SWEPT_ROLL, 3981 - 113)
    assert not met_both_stops(SWEPT_ROLL, MAX_TICK)
    assert met_both_stops(replace(SWEPT_ROLL, turns_freely=False), MAX_TICK)


NONE, A, G = (frozenset(joints) for joints in ("", "a", "g"))


@pytest.mark.parametrize("name", ["so100", "so101", "koch_v1_1", "fetch"])
def test_every_built_in_arm_has_a_motion_for_every_joint_and_candidates_away_from_its_limits(name):
    robot = robot_folder.resolve(name).model
    assert set(asked_motions(robot)) == {joint.name for joint in robot.movable_joints}
    candidates = [candidate for pose in poses(robot) for candidate in pose.candidates]
    for joint, position in (each for candidate in candidates for each in candidate.items()):
        low, high = robot.joints[joint].lower, robot.joints[joint].upper
        margin = min(LIMIT_MARGIN_RAD, (high - low) / 2.0)
        assert low + margin - 1e-9 <= position <= high - margin + 1e-9 or joint in robot.gripper.joints


def test_the_poses_beside_zero_show_the_direction_of_every_joint():
    zero, first, second, gripper = (pose.candidates[0] for pose in poses(so101()))
    for joint in zero:
        ways = [pose[joint] - zero[joint] for pose in (first, second)]
        assert ways[0] * ways[1] < 0.0
        # A hand's breadth, not a swing.
        assert max(map(abs, ways)) < 0.5
    assert set(gripper) == {"gripper"}


def test_a_droop_without_gain_and_load_or_a_joint_that_looks_otherwise_is_a_finding_with_its_cause():
    for droop, words in (
        (Droop("elbow_flex", 0.03, load=0.2, p_gain=32), ""),
        (Droop("elbow_flex", 0.09, load=0.4, p_gain=16), "its position gain of 16 lets it"),
        (Droop("elbow_flex", -0.12, load=0.05, p_gain=32), f"stands {math.degrees(0.12):.1f} deg from its goal"),
        (Droop("elbow_flex", -0.12, load=0.05, p_gain=32), "supply is weak"),
    ):
        assert words in droop.finding()
        assert bool(words) is bool(droop.finding())
    for seen, words in (
        ([("zero", A), ("first", A), ("second", NONE)], "in 2 of 3 poses: its zero is off"),
        ([("zero", NONE), ("first", A), ("second", A)], "turns the other way"),
        ([("zero", NONE), ("open gripper", G)], "drive_mode"),
    ):
        (found,) = seen_findings(seen, G)
        assert words in found


def moved(robot, joint, link, rises):
    """Motion of a link when a joint moves a little from the model's zero, shape (3,) [m]."""
    forward, zero = ForwardPlacements(robot), {each.name: 0.0 for each in robot.movable_joints}
    places = [forward.transforms({**zero, joint: at})[link][:3, 3] for at in (0.0, 0.01 if rises else -0.01)]
    return places[1] - places[0]


def test_the_links_go_where_the_requests_say_and_the_gripper_opens_whichever_way_its_joint_turns():
    robot, motions = so101(), asked_motions(so101())
    assert motions["elbow_flex"].request == "move elbow flex so that the far end of lower arm goes up"
    way = moved(robot, "elbow_flex", "wrist_link", motions["elbow_flex"].rises)
    assert way[2] > 0.9 * np.linalg.norm(way)
    # An upright axis turns the arm to the left of who stands behind it.
    assert "to the left" in motions["shoulder_pan"].request
    assert moved(robot, "shoulder_pan", robot.tip_link, motions["shoulder_pan"].rises)[1] > 0.0
    # A joint whose axis runs along its link is turned.
    assert "clockwise, as seen along the arm" in motions["wrist_roll"].request
    for opened, rises in ((1.0, True), (-1.0, False)):
        turning = replace(robot, gripper=replace(robot.gripper, open=opened, closed=0.0))
        assert asked_motions(turning)["gripper"] == AskedMotion("open the gripper", rises=rises)


def test_the_sign_of_the_folder_is_compared_with_what_the_hand_did_and_a_twitch_shows_no_direction():
    other_way = {(1, False, 300), (-1, True, 300), (1, True, -300)}
    for sign, rises, ticks in (*other_way, (1, True, 300), (-1, False, 300)):
        found = turned_the_other_way(replace(ELBOW, sign=sign), AskedMotion("bend it", rises=rises), ticks)
        assert found is ((sign, rises, ticks) in other_way), (sign, rises, ticks)
    with pytest.raises(CalibrationError, match=r"elbow_flex: was moved by 99 ticks only.*bend it, further"):
        turned_the_other_way(ELBOW, AskedMotion("bend it", rises=True), 1 - LEAST_MOTION_TICKS)
