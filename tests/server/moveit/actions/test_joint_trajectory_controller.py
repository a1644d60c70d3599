"""FollowJointTrajectory and the controller's topics."""

import contextlib
import math
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.messages import ArmState, Outcome
from server.errors import GraphError, RefusedError
from server.execution.goal import Answer, GoalState, Progress, TimeLimits
from server.execution.motions import ExternalTrajectory, Performed
from server.graph.actions import GoalStatus
from server.moveit.actions.joint_trajectory_controller import (
    INDUSTRIAL_ACTION,
    FollowCode,
    JointTrajectoryController,
    check_trajectory,
    checked_duration_s,
    follow_code,
    read_segment_tolerances,
)
from server.moveit.trajectories import external_trajectory
from tests.helpers.fake_arm import HOME, JOINTS, FakeArm, settle
from tests.helpers.messages import time_message
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import ROBOT, ActionDesk, goal_context, message, outcome

ACTION = "/arm_controller/follow_joint_trajectory"
TOPIC = "/arm_controller/joint_trajectory"
TRAJECTORY = {"joint_names": ["elbow_flex"], "points": [{"positions": [0.3], "time_from_start": {"sec": 2}}]}
MOVING = Progress(GoalState.EXECUTING, "", 0.5, 1.0)


class Desk(ActionDesk):
    def __init__(self) -> None:
        super().__init__()
        context = goal_context(self.graph, self.arm, self.context, self.queue)
        self.controller = JointTrajectoryController(context, ROBOT.groups["arm"], "arm", industrial=True)

    async def publish(self, **trajectory: Any) -> None:
        self.graph.publish(self.client, TOPIC, trajectory)
        await settle()

    @property
    def codes(self) -> list[tuple[int, int]]:
        return [(result.status, result.values["error_code"]) for result in self.results]


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


@pytest.mark.parametrize("action", [ACTION, INDUSTRIAL_ACTION])
async def test_a_trajectory_is_played_under_both_names_with_feedback_of_every_joint_while_the_arm_moves(
    desk: Desk, action: str
) -> None:
    await desk.send(action, trajectory=TRAJECTORY)
    assert isinstance(desk.asked[0], ExternalTrajectory)
    desk.arm.state = at(0.2, 0.3)
    desk.report(replace(MOVING, state=GoalState.PLANNED))
    desk.report(MOVING)
    (feedback,) = desk.feedback
    assert feedback["joint_names"] == list(ARM)
    assert feedback["error"]["positions"] == pytest.approx([0.1] * len(ARM))
    desk.finish()
    await settle()
    assert desk.codes == [(GoalStatus.SUCCEEDED, FollowCode.SUCCESSFUL)]
    assert len(desk.feedback) == 1


async def test_a_refused_goal_is_answered_with_code_and_sentence(desk: Desk) -> None:
    await desk.send(ACTION, trajectory={**TRAJECTORY, "joint_names": ["knee"]})
    await desk.send(ACTION, trajectory=TRAJECTORY, goal_time_tolerance={"sec": 60})
    aborted = GoalStatus.ABORTED
    assert desk.codes == [(aborted, FollowCode.INVALID_JOINTS), (aborted, FollowCode.INVALID_GOAL)]
    assert "'knee'" in desk.results[0].values["error_string"]
    assert (len(desk.refused), desk.asked) == (2, [])


TOO_LONG = {**TRAJECTORY, "points": [{"positions": [0.3], "time_from_start": {"sec": 601}}]}
TOO_LONG_WORDS = "trajectory.points[0].time_from_start is 601 s, longer than goals.max_trajectory_duration_s = 600"


async def test_a_trajectory_that_takes_too_long_is_refused_and_the_motion_continues(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.send(ACTION, trajectory=TOO_LONG)
    with pytest.raises(GraphError, match="601 s, longer than"):
        await desk.publish(**TOO_LONG)
    assert desk.codes == [(GoalStatus.ABORTED, FollowCode.INVALID_GOAL)]
    assert desk.results[0].values["error_string"] == TOO_LONG_WORDS
    assert desk.refused == [TOO_LONG_WORDS] * 2
    assert len(desk.asked) == 1


async def test_a_goal_older_than_a_stop_is_answered_and_forgotten(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk, "last_stop", lambda _joints: math.inf)
    await desk.send(ACTION, trajectory=TRAJECTORY)
    assert desk.codes == [(GoalStatus.CANCELED, FollowCode.INVALID_GOAL)]
    assert not desk.controller._goals


async def test_stamps_are_of_the_servers_time_and_not_too_far_in_the_future(desk: Desk) -> None:
    for ahead_s in (700.0, 2e4, 3e8):
        stamp = {"sec": int(time.time() + ahead_s), "nanosec": 0}
        with pytest.raises(GraphError, match=r"to the last point of the trajectory is .* longer than"):
            await desk.publish(**TRAJECTORY, header={"stamp": stamp})
    assert desk.asked == []
    desk.graph.message_types.wall_clock = lambda: 5000.0
    for stamp in (0, 5003):
        await desk.publish(**TRAJECTORY, header={"stamp": {"sec": stamp}})
    motions = [each.trajectory(dict.fromkeys(JOINTS, 0.2), time.monotonic(), None) for each in desk.asked]
    assert [motion.duration_s for motion in motions] == pytest.approx([2.0, 5.0], abs=0.5)


async def test_the_publisher_hears_of_each_refusal_of_a_stream_and_others_of_the_first_in_a_row(desk: Desk) -> None:
    for stream in ([TOO_LONG] * 3, [TRAJECTORY], [TOO_LONG] * 3):
        for trajectory in stream:
            with pytest.raises(GraphError) if trajectory is TOO_LONG else contextlib.nullcontext():
                await desk.publish(**trajectory)
    assert desk.refused == [TOO_LONG_WORDS] * 2


async def test_a_trajectory_on_the_topic_preempts_the_current_motion_and_an_empty_one_stops_the_arm(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.publish(**TRAJECTORY)
    assert len(desk.asked) == 2
    assert desk.codes == [(GoalStatus.CANCELED, FollowCode.INVALID_GOAL)]
    await desk.send(ACTION, trajectory=TRAJECTORY)
    await desk.publish(joint_names=["elbow_flex"])
    assert len(desk.asked) == 3
    assert "stopped by an empty trajectory" in desk.results[-1].values["error_string"]


ARM = ROBOT.groups["arm"].joints
END = Performed({}, (smooth_move(dict.fromkeys(ARM, (0.0, 0.5)), 1.0),))
REACHED = Answer(MoveItErrorCode.SUCCESS, "the arm is there", performed=END)


def at(position_rad: float, goal_rad: float, clock_s: float = 1.0) -> ArmState:
    position, goal = np.full(len(JOINTS), position_rad), np.full(len(JOINTS), goal_rad)
    return replace(FakeArm().state, clock_s=clock_s, position_rad=position, goal_rad=goal)


ELBOW = {"name": "elbow_flex"}


async def test_a_joint_that_leaves_the_path_tolerance_ends_the_motion(desk: Desk) -> None:
    await desk.send(ACTION, trajectory=TRAJECTORY, path_tolerance=[{**ELBOW, "position": 0.05}])
    desk.controller.take_state(at(0.0, 0.3))
    desk.report(MOVING)
    desk.controller.take_state(at(0.26, 0.3))
    assert desk.queue.active_count == 1
    for lag_rad in (0.06, 0.07):
        desk.controller.take_state(at(0.3 - lag_rad, 0.3))
    await settle()
    assert desk.codes == [(GoalStatus.ABORTED, FollowCode.PATH_TOLERANCE_VIOLATED)]
    assert "elbow_flex is 0.060 rad" in desk.results[0].values["error_string"]


@pytest.mark.parametrize(("end_rad", "code"), [(0.49, FollowCode.SUCCESSFUL), (0.45, None)])
async def test_a_goal_within_its_tolerance_succeeds_at_once_and_violates_it_with_a_joint_that_stays_away(
    desk: Desk, end_rad: float, code: FollowCode | None
) -> None:
    tolerance = {"goal_tolerance": [{**ELBOW, "position": 0.02}], "goal_time_tolerance": {"sec": 1}}
    await desk.send(ACTION, trajectory=TRAJECTORY, **tolerance)
    desk.arm.state = at(end_rad, 0.5, 10.0)
    desk.finish(REACHED)
    await settle()
    assert desk.codes == [(GoalStatus.SUCCEEDED, code)] * (code is not None)
    desk.controller.take_state(at(end_rad, 0.5, 11.0))
    assert desk.codes[0] == (
        (GoalStatus.SUCCEEDED, code) if code is not None else (GoalStatus.ABORTED, FollowCode.GOAL_TOLERANCE_VIOLATED)
    )


LOST, NOT_SETTLED = {"outcome": Outcome.TRACKING_LOST.value}, {"outcome": Outcome.NOT_SETTLED.value}
ENDS = [
    (REACHED, FollowCode.SUCCESSFUL),
    (Answer(MoveItErrorCode.CONTROL_FAILED, "", LOST), FollowCode.PATH_TOLERANCE_VIOLATED),
    (Answer(MoveItErrorCode.CONTROL_FAILED, "", NOT_SETTLED), FollowCode.GOAL_TOLERANCE_VIOLATED),
    (Answer(MoveItErrorCode.PREEMPTED, ""), FollowCode.INVALID_GOAL),
]


@pytest.mark.parametrize(("answer", "code"), ENDS)
def test_every_end_has_a_code_of_the_controllers(answer: Answer, code: FollowCode) -> None:
    assert follow_code(answer) is code


ARM_GROUP = ROBOT.groups["arm"]
POINT = {"positions": [0.3], "time_from_start": {"sec": 2}}
REQUESTED: dict[str, Any] = {"joint_names": ["elbow_flex"], "points": [POINT], "header": {"stamp": {"sec": 0}}}


def refusal(**changes: Any) -> RefusedError | None:
    trajectory = message("trajectory_msgs/msg/JointTrajectory", **{**REQUESTED, **changes})
    try:
        check_trajectory(trajectory, ARM_GROUP, checked_duration_s(trajectory, TimeLimits()), 1000.0)
        external_trajectory(trajectory, ROBOT, HOME)
    except RefusedError as error:
        return error
    return None


def at_rest(time_s: float, position_rad: float) -> dict[str, Any]:
    """A point with velocity 0."""
    return {"positions": [position_rad], "velocities": [0.0], "time_from_start": time_message(time_s)}


def test_an_unplayable_trajectory_is_refused_with_a_code() -> None:
    for changes, code, words in (
        ({"points": []}, FollowCode.INVALID_GOAL, "points is empty"),
        ({"joint_names": ["knee"]}, FollowCode.INVALID_JOINTS, "'knee'"),
        # A joint of another controller.
        ({"joint_names": ["gripper"]}, FollowCode.INVALID_JOINTS, "'gripper'"),
        (
            {"header": {"stamp": {"sec": 1000, "nanosec": 10**9}}},
            FollowCode.INVALID_GOAL,
            "trajectory.header.stamp.nanosec",
        ),
        ({"header": {"stamp": {"sec": 990}}}, FollowCode.OLD_HEADER_TIMESTAMP, "8.0 s ago"),
        ({"points": [{**POINT, "positions": []}]}, FollowCode.INVALID_GOAL, "positions"),
        ({"points": [{**POINT, "positions": [9.0]}]}, FollowCode.INVALID_GOAL, "9.000 rad"),
        # A swing between its points, and a zigzag.
        (
            {"points": [at_rest(0, 0.0), {**at_rest(1, 0.25), "velocities": [8.0]}, at_rest(2, 0.5)]},
            FollowCode.INVALID_GOAL,
            "would move at 8.00 rad/s, above its limit of 1.68 rad/s, at 1.000 s",
        ),
        (
            {"points": [at_rest(0.01 * step, 0.01 * (step % 2)) for step in range(21)]},
            FollowCode.INVALID_GOAL,
            "would accelerate by 600.00 rad/s^2",
        ),
    ):
        refused = refusal(**changes)
        assert refused is not None, changes
        assert getattr(refused, "code", FollowCode.INVALID_GOAL) is code
        assert words in refused.failure.message


def test_trajectories_that_other_controllers_reject_silently_are_accepted() -> None:
    efforts, in_motion = {"points": [{**POINT, "effort": [0.0]}]}, {"points": [{**POINT, "velocities": [0.5]}]}
    for changes in ({}, {"header": {"stamp": {"sec": 1000}}}, efforts, in_motion):
        assert refusal(**changes) is None, changes


def tolerances(**fields: Any) -> Any:
    goal = message("control_msgs/action/FollowJointTrajectory_Goal", **fields)
    return outcome(read_segment_tolerances, goal, ARM_GROUP)


def test_positive_tolerances_alone_are_checked_and_those_that_cannot_be_kept_refused() -> None:
    for position_rad, demanded in ((0.05, {"elbow_flex": 0.05}), (0.0, {}), (-1.0, {})):
        assert tolerances(path_tolerance=[{"name": "elbow_flex", "position": position_rad}]).path == demanded
    for fields, words in (
        ({"goal_tolerance": [{"name": "knee"}]}, "goal_tolerance names the joint 'knee'"),
        ({"path_tolerance": [{"name": "elbow_flex", "position": math.nan}]}, "path_tolerance"),
        ({"goal_time_tolerance": {"sec": 60}}, "at most 10 s, not 60 s"),
    ):
        assert words in tolerances(**fields).message


@pytest.mark.parametrize("name", ["state", "controller_state"])
async def test_subscribers_get_reference_and_feedback_of_the_joints(desk: Desk, name: str) -> None:
    heard = desk.listen(f"/arm_controller/{name}", "control_msgs/JointTrajectoryControllerState")
    desk.controller.take_state(at(0.2, 0.3))
    desk.controller.take_state(replace(at(0.2, 0.3), goal_rad=None))
    (state,) = heard
    assert state["joint_names"] == list(ARM)
    assert state["reference"]["positions"] == [0.3] * len(ARM)
    assert state["error"]["positions"] == pytest.approx([0.1] * len(ARM))
    assert state["speed_scaling_factor"] == 1.0
    # It is published without another check, so it must have every field already.
    types = desk.graph.message_types
    assert types.complete("control_msgs/msg/JointTrajectoryControllerState", state, types.now()) == state
