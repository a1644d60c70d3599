import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planners.goals import JointGoal
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    Deviation,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
)
from planners.scene import EMPTY_SCENE, Scene
from robot.control.checks import refusal
from robot.control.pacing import PERIOD_S
from robot.description.limits import JointBounds
from server.errors import RefusedError
from server.execution.motions import (
    HORIZON_S,
    LEAD_IN_SCALING,
    START_TOLERANCE_RAD,
    STATE_AGE_S,
    MotionStep,
    PathTime,
    PlannedSequence,
    Positions,
    deviation_note,
    plan_sequence,
    splice_point_of,
    with_lead_in,
)
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101
from tests.helpers.steps import StepOf

if TYPE_CHECKING:
    from planners.interface import Planners

START = {"a": 0.0, "b": 0.5}
WALL = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is a wall", {"pairs": []})


def to(position_rad: float) -> MotionStep:
    def problem(start_rad: Positions) -> PlanningProblem:
        return PlanningProblem("arm", dict(start_rad), JointGoal({"a": position_rad}))

    return StepOf(problem)


class Planning:
    """Goes straight; to a position beyond 1 there is no way."""

    def __init__(self, deviation: Deviation | None = None) -> None:
        self.deviation = deviation or Deviation()
        self.starts: list[Positions] = []

    async def ask(
        self, request: PlanningProblem | CartesianProblem, _scene: Scene
    ) -> Plan | CartesianPlan | PlanningFailure:
        assert isinstance(request, PlanningProblem)
        assert isinstance(request.goal, JointGoal)
        self.starts.append(request.start_rad)
        end_rad = request.goal.positions_rad["a"]
        if end_rad > 1.0:
            return WALL
        motion = smooth_move({"a": (request.start_rad["a"], end_rad)}, 1.0)
        return Plan(motion, "straight line", 0.25, deviation=self.deviation)


async def planned_by(planning: Planning, *steps: MotionStep) -> PlannedSequence:
    return await plan_sequence(steps, START, EMPTY_SCENE, cast("Planners", planning))


async def test_each_step_is_planned_from_where_the_one_before_ends() -> None:
    planning = Planning()
    planned = await planned_by(planning, to(0.3), to(0.7))
    assert planning.starts == [START, {"a": 0.3, "b": 0.5}]
    assert planned.failure is None
    assert len(planned.performed.planned) == 2
    assert (planned.duration_s, planned.performed.planning_time_s) == (2.0, 0.5)
    assert planned.summary == "a motion of 2.0 s (straight line, straight line; planned in 500 ms)"


async def test_the_motions_before_a_failure_are_kept_and_the_item_is_named() -> None:
    planned = await planned_by(Planning(), to(0.3), to(2.0), to(0.1))
    assert len(planned.performed.planned) == 1
    assert planned.failure is not None
    assert planned.failure.message == "items[1]: there is a wall"
    assert planned.failure.details == {"pairs": [], "item": 1}
    assert planned.problem is not None


async def test_a_step_without_a_problem_is_not_planned() -> None:
    planning = Planning()

    def refusing(_start_rad: Positions) -> PlanningProblem:
        raise RefusedError(WALL)

    planned = await planned_by(planning, StepOf(refusing))
    assert (planned.failure, planned.problem, planning.starts) == (WALL, None, [])


UNDER_WAY = smooth_move({"a": (0.0, 1.0), "b": (0.5, -0.5)}, 2.0)

ROBOT = so101()
JOINTS = ROBOT.groups["arm"].joints
HOME = dict.fromkeys(JOINTS, 0.0)
BOUNDS = JointBounds.of(ROBOT, JOINTS)
GIVEN = smooth_move(dict.fromkeys(JOINTS, (0.0, 0.4)), 2.0)

NEAR = st.floats(-START_TOLERANCE_RAD, START_TOLERANCE_RAD)


@given(st.floats(0.0, 0.9), st.floats(0.0, 1.0), st.floats(0.1, 1.0))
# The lead begins by rounding alone before a point of the motion.
@example(0.06, 1e-279, 1.0)
def test_the_lead_is_the_motion_s_curve_up_to_the_splice_point(fraction: float, share: float, speed: float) -> None:
    path_time = PathTime(5.0, fraction * UNDER_WAY.duration_s, speed)
    splice_point = splice_point_of(UNDER_WAY, path_time, 5.0, HORIZON_S)
    assert splice_point is not None
    assert (np.diff(splice_point.lead.time_s) > 0.0).all()
    time_s = share * splice_point.lead.duration_s
    # Each derivative of a short piece has more of the rounding.
    for order, (ours, theirs) in enumerate(
        zip(splice_point.lead.sample(time_s), UNDER_WAY.sample(splice_point.from_s + time_s), strict=True)
    ):
        np.testing.assert_allclose(ours, theirs, atol=(1e-9, 1e-6, 1e-3)[order])
    # There is the whole horizon to plan in, at whatever speed the motion is played.
    left_s = splice_point.from_s + splice_point.lead.duration_s - fraction * UNDER_WAY.duration_s
    assert left_s == pytest.approx(HORIZON_S * speed)


def test_the_lead_begins_before_the_state_of_an_arm_whose_clock_is_faster() -> None:
    splice_point = splice_point_of(UNDER_WAY, PathTime(0.0, 1.5, 10.0), 0.0, HORIZON_S)
    assert splice_point is not None
    assert splice_point.from_s == pytest.approx(1.5 - 10.0 * STATE_AGE_S)


@pytest.mark.parametrize("path_time", [PathTime(0.0, 1.0, 0.0), PathTime(0.0, 2.01, 1.0)], ids=["waits", "has ended"])
def test_a_motion_that_cannot_be_replaced_has_no_splice_point(path_time: PathTime) -> None:
    assert splice_point_of(UNDER_WAY, path_time, 0.0, HORIZON_S) is None


def test_a_motion_about_to_end_is_replaced_at_its_end() -> None:
    splice_point = splice_point_of(UNDER_WAY, PathTime(0.0, 1.9, 1.0), 0.05, HORIZON_S)
    assert splice_point is not None
    assert splice_point.positions_rad == {"a": 1.0, "b": -0.5}


@given(st.lists(NEAR, min_size=len(JOINTS), max_size=len(JOINTS)))
def test_a_motion_from_nearby_is_led_in_within_the_limits(held: list[float]) -> None:
    whole = with_lead_in(GIVEN, dict(zip(JOINTS, held, strict=True)), ROBOT)
    assert not refusal(whole, JOINTS, BOUNDS, np.array(held))
    lead_s = whole.duration_s - GIVEN.duration_s
    samples = [whole.sample(time_s) for time_s in np.linspace(0.0, max(lead_s - 1e-6, 0.0), 20)]
    speeds, accelerations = np.abs([sample[1:] for sample in samples]).swapaxes(0, 1)
    assert (speeds <= LEAD_IN_SCALING * BOUNDS.max_velocity + 1e-9).all()
    assert lead_s == 0.0 or (accelerations <= LEAD_IN_SCALING * BOUNDS.max_acceleration + 1e-9).all()
    np.testing.assert_allclose(whole.sample(lead_s + 1.0)[0], GIVEN.sample(1.0)[0], atol=1e-9)


@pytest.mark.parametrize("away_rad", [0.06, -1.0])
def test_a_motion_from_far_away_is_refused_with_joint_and_numbers(away_rad: float) -> None:
    sentence = f"elbow_flex at 0.0000 rad, but the arm holds it at {away_rad:.4f} rad"
    with pytest.raises(RefusedError, match=re.escape(sentence)) as refused:
        with_lead_in(GIVEN, {**HOME, "elbow_flex": away_rad}, ROBOT)
    assert refused.value.failure.code is MoveItErrorCode.CONTROL_FAILED


def test_a_deviation_is_described_in_millimetres_and_degrees() -> None:
    note = deviation_note(Deviation(position_m=0.0042, orientation_rad=0.5))
    assert "4.2 mm" in note
    assert "28.6 degrees" in note


@pytest.mark.parametrize(("arrives_s", "leaves_s"), [(5.0295, 5.023), (5.0145, 5.013), (5.0104, 5.0104)])
def test_a_trajectory_leaves_the_path_just_after_the_last_tick_before_it_comes_to_the_arm(
    arrives_s: float, leaves_s: float
) -> None:
    path_time = PathTime(5.0, 1.0, 1.0, at_tick=True)
    assert path_time.earliest_leave_s(arrives_s) == pytest.approx(leaves_s)
    assert path_time.passes_s(arrives_s) == pytest.approx(math.floor(100.0 * arrives_s + 1.0) / 100.0)
    untimed = replace(path_time, at_tick=False)
    assert (untimed.earliest_leave_s(arrives_s), untimed.passes_s(arrives_s)) == (arrives_s, arrives_s + PERIOD_S)
