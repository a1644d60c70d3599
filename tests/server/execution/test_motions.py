import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planners.goals import JointGoal
from planners.problem import Deviation, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE, Scene
from robot.description.limits import JointBounds
from robot.trajectory import PERIOD_S, refusal
from server.errors import RefusedError
from server.execution import motions
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import assert_refused, rejection
from tests.helpers.robots import so101

START = {"a": 0.0, "b": 0.5}
WALL = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is a wall", {"pairs": []})


def to(position_rad: float) -> motions.MotionStep:
    return lambda start_rad: PlanningProblem("arm", dict(start_rad), JointGoal({"a": position_rad}))


class Planning:
    """Goes straight; to a position beyond 1 there is no way."""

    def __init__(self) -> None:
        self.starts: list[motions.Positions] = []

    async def ask(self, request: Any, _scene: Scene) -> Plan | PlanningFailure:
        self.starts.append(request.start_rad)
        end_rad = request.goal.positions_rad["a"]
        motion = smooth_move({"a": (request.start_rad["a"], end_rad)}, 1.0)
        return WALL if end_rad > 1.0 else Plan(motion, "straight line", 0.25)


async def test_each_step_is_planned_from_where_the_one_before_ends() -> None:
    planning: Any = Planning()
    planned = await motions.plan_sequence([to(0.3), to(0.7)], START, EMPTY_SCENE, planning)
    assert planning.starts == [START, {"a": 0.3, "b": 0.5}]
    assert planned.failure is None
    assert len(planned.planned) == 2
    assert (planned.duration_s, planned.planning_time_s) == (2.0, 0.5)
    assert planned.summary == "a motion of 2.0 s (straight line, straight line; planned in 500 ms)"


async def test_the_motions_before_a_failure_are_kept_and_the_item_is_named() -> None:
    planning: Any = Planning()
    planned = await motions.plan_sequence([to(0.3), to(2.0), to(0.1)], START, EMPTY_SCENE, planning)
    assert len(planned.planned) == 1
    assert planned.failure == replace(WALL, message="items[1]: there is a wall", details={"pairs": [], "item": 1})
    assert planned.problem is not None


async def test_a_step_without_a_problem_is_not_planned() -> None:
    planning: Any = Planning()

    def refusing(_start_rad: motions.Positions) -> PlanningProblem:
        raise RefusedError(WALL)

    planned = await motions.plan_sequence([refusing], START, EMPTY_SCENE, planning)
    assert (planned.failure, planned.problem, planning.starts) == (WALL, None, [])


UNDER_WAY = smooth_move({"a": (0.0, 1.0), "b": (0.5, -0.5)}, 2.0)

ROBOT = so101()
JOINTS = ROBOT.groups["arm"].joints
HOME = dict.fromkeys(JOINTS, 0.0)
BOUNDS = JointBounds.of(ROBOT, JOINTS)
GIVEN = smooth_move(dict.fromkeys(JOINTS, (0.0, 0.4)), 2.0)

NEAR = st.floats(-motions.START_TOLERANCE_RAD, motions.START_TOLERANCE_RAD)


@given(st.floats(0.0, 0.9), st.floats(0.0, 1.0), st.floats(0.1, 1.0))
# The lead begins by rounding alone before a point of the motion.
@example(0.06, 1e-279, 1.0)
def test_the_lead_is_the_motion_s_curve_up_to_the_splice_point(fraction: float, share: float, speed: float) -> None:
    path_time = motions.PathTime(5.0, fraction * UNDER_WAY.duration_s, speed)
    splice_point: Any = motions.splice_point_of(UNDER_WAY, path_time, 5.0, motions.HORIZON_S)
    assert (np.diff(splice_point.lead.time_s) > 0.0).all()
    time_s = share * splice_point.lead.duration_s
    # Each derivative of a short piece has more of the rounding.
    for order, (ours, theirs) in enumerate(
        zip(splice_point.lead.sample(time_s), UNDER_WAY.sample(splice_point.from_s + time_s), strict=True)
    ):
        np.testing.assert_allclose(ours, theirs, atol=(1e-9, 1e-6, 1e-3)[order])
    # There is the whole horizon to plan in, at whatever speed the motion is played.
    left_s = splice_point.from_s + splice_point.lead.duration_s - fraction * UNDER_WAY.duration_s
    assert left_s == pytest.approx(motions.HORIZON_S * speed)


def test_the_lead_begins_before_the_state_of_a_faster_clock_and_ends_with_the_motion_at_the_latest() -> None:
    early: Any = motions.splice_point_of(UNDER_WAY, motions.PathTime(0.0, 1.5, 10.0), 0.0, motions.HORIZON_S)
    assert early.from_s == pytest.approx(1.5 - 10.0 * motions.STATE_AGE_S)
    late: Any = motions.splice_point_of(UNDER_WAY, motions.PathTime(0.0, 1.9, 1.0), 0.05, motions.HORIZON_S)
    assert late.positions_rad == {"a": 1.0, "b": -0.5}
    for waits_or_has_ended in (motions.PathTime(0.0, 1.0, 0.0), motions.PathTime(0.0, 2.01, 1.0)):
        assert motions.splice_point_of(UNDER_WAY, waits_or_has_ended, 0.0, motions.HORIZON_S) is None


@given(st.lists(NEAR, min_size=len(JOINTS), max_size=len(JOINTS)))
@example([motions.START_TOLERANCE_RAD] * len(JOINTS))
def test_a_motion_from_nearby_is_led_in_within_the_limits(held: list[float]) -> None:
    whole = motions.with_lead_in(GIVEN, dict(zip(JOINTS, held, strict=True)), ROBOT)
    assert not refusal(whole, JOINTS, BOUNDS, np.array(held))
    lead_s = whole.duration_s - GIVEN.duration_s
    samples = [whole.sample(time_s) for time_s in np.linspace(0.0, max(lead_s - 1e-6, 0.0), 20)]
    speeds, accelerations = np.abs([sample[1:] for sample in samples]).swapaxes(0, 1)
    assert (speeds <= motions.LEAD_IN_SCALING * BOUNDS.max_velocity + 1e-9).all()
    assert lead_s == 0.0 or (accelerations <= motions.LEAD_IN_SCALING * BOUNDS.max_acceleration + 1e-9).all()
    np.testing.assert_allclose(whole.sample(lead_s + 1.0)[0], GIVEN.sample(1.0)[0], atol=1e-9)


@pytest.mark.parametrize("away_rad", [0.06, -1.0])
def test_a_motion_from_far_away_is_refused_with_joint_and_numbers(away_rad: float) -> None:
    refused = rejection(motions.with_lead_in, GIVEN, {**HOME, "elbow_flex": away_rad}, ROBOT)
    sentence = f"elbow_flex at 0.0000 rad, but the arm holds it at {away_rad:.4f} rad"
    assert_refused(refused, MoveItErrorCode.CONTROL_FAILED, sentence)


def test_a_deviation_is_described_in_millimetres_and_degrees() -> None:
    note = motions.deviation_note(Deviation(position_m=0.6, orientation_rad=0.5))
    assert note == "the position is 600.0 mm off and the orientation is 28.6 degrees off, the nearest there is"
    assert motions.deviation_note(Deviation(position_m=0.001, orientation_rad=0.01)) == ""


@pytest.mark.parametrize(("arrives_s", "leaves_s"), [(5.0295, 5.023), (5.0145, 5.013), (5.0104, 5.0104)])
def test_a_trajectory_leaves_the_path_just_after_the_last_tick_before_it_comes_to_the_arm(
    arrives_s: float, leaves_s: float
) -> None:
    path_time = motions.PathTime(5.0, 1.0, 1.0, at_tick=True)
    assert path_time.earliest_leave_s(arrives_s) == pytest.approx(leaves_s)
    assert path_time.clear_of_tick(arrives_s) == pytest.approx(5.03 if arrives_s > 5.029 else arrives_s)
    assert path_time.passes_s(arrives_s) == pytest.approx(math.floor(100.0 * arrives_s + 1.0) / 100.0)
    untimed = replace(path_time, at_tick=False)
    assert untimed.clear_of_tick(arrives_s) == arrives_s
    assert (untimed.earliest_leave_s(arrives_s), untimed.passes_s(arrives_s)) == (arrives_s, arrives_s + PERIOD_S)


def test_a_trajectory_that_comes_at_a_tick_leaves_the_path_there_however_the_times_are_rounded() -> None:
    for ticks in range(1, 200):
        path_time = motions.PathTime(74_211.123_456_7, 1.0, 1.0, at_tick=True)
        tick_s = path_time.at_s + ticks * PERIOD_S
        arrives_s = path_time.clear_of_tick(tick_s - 0.0004)
        assert path_time.earliest_leave_s(arrives_s) == pytest.approx(tick_s, abs=1e-7)
        assert path_time.passes_s(arrives_s) == pytest.approx(tick_s + PERIOD_S, abs=1e-7)
