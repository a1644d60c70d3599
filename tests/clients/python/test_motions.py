"""The Python client moves the simulated arm, plans, grips, and reports why not."""

import asyncio
import math
from typing import Any

import numpy as np
import pytest

from armbridge_client import Arm, GoalRefused, RequestRefused, after_stop, connect, connect_async, pose
from armbridge_client.messages import String
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S


def test_the_tip_moves_to_a_position(arm: Arm) -> None:
    assert arm.move_to(x=0.25, y=0.0, z=0.12).duration_s > 0.0
    tip = arm.tip().pose.position
    assert math.dist((tip.x, tip.y, tip.z), (0.25, 0.0, 0.12)) < 0.01


def test_joints_move_and_the_state_shows_it(arm: Arm) -> None:
    arm.move_joints({"elbow_flex": 0.4, "shoulder_pan": -0.2})
    state = arm.state()
    assert state.position_rad["elbow_flex"] == pytest.approx(0.4, abs=0.02)
    assert (state.mode, state.fault) in (("moving", ""), ("holding", ""))


def test_a_plan_moves_nothing_until_it_is_executed_and_nothing_from_elsewhere(arm: Arm) -> None:
    arm.move_named("home")
    plan = arm.plan("ready")
    assert arm.state().position_rad["elbow_flex"] == pytest.approx(0.0, abs=0.02)
    assert plan.execute(speed=0.5).duration_s == pytest.approx(2.0 * plan.duration_s)
    assert arm.state().position_rad["elbow_flex"] == pytest.approx(0.5, abs=0.02)
    with pytest.raises(GoalRefused):
        plan.execute()


def test_a_stop_since_the_program_looked_or_planned_refuses_the_motion_and_a_new_look_does_not(
    server: RunningServer, arm: Arm
) -> None:
    arm.move_named("home")
    with connect(server.url) as other:
        state, plan = arm.state(), arm.plan("ready")
        other.stop()
        with after_stop(state.stops):
            for move in (lambda: arm.move_named("ready"), arm.gripper.open):
                with pytest.raises(GoalRefused, match="PREEMPTED"):
                    move()
            # A newer number within an older one counts for nothing, and a stop needs none.
            with after_stop(arm.stops()), pytest.raises(GoalRefused, match="the arm was stopped"):
                arm.move_named("ready")
            arm.stop()
        with pytest.raises(GoalRefused, match="the arm was stopped"):
            plan.execute()
    assert arm.state().position_rad["elbow_flex"] == pytest.approx(0.0, abs=0.02)
    with after_stop(arm.state().stops):
        arm.plan("ready").execute()
    with after_stop(arm.stops() + 1), pytest.raises(RequestRefused, match="field after_stop: must be a whole number"):
        arm.move_named("home")


def test_a_number_out_of_range_is_refused_before_it_is_sent(arm: Arm) -> None:
    for speed in (0.0, -1.0, 1.5, math.nan):
        with pytest.raises(ValueError, match="speed must be above 0 to 1"):
            arm.plan("home").execute(speed)
    for rate_hz in (-1.0, math.nan):
        with pytest.raises(ValueError, match="rate_hz must be 0 or more"):
            next(arm.states(rate_hz))


@pytest.mark.parametrize("way", ["move", "plan"])
def test_a_refusal_has_code_sentence_details_and_a_goal_that_works(arm: Arm, way: str) -> None:
    far = pose(0.9, 0.0, 0.1)
    with pytest.raises(GoalRefused) as caught:
        arm.move(far) if way == "move" else arm.plan(far)
    refused = caught.value
    assert (refused.code, refused.code_name) == (-31, "NO_IK_SOLUTION")
    assert "cannot reach (0.9, 0, 0.1) m" in refused.sentence
    assert refused.details["distance_m"] > 0.3
    assert refused.suggestion is not None
    arm.move(refused.suggestion)


def test_an_unknown_name_is_refused_with_the_nearest_name(arm: Arm) -> None:
    for refusing in (arm.move_named, arm.plan):
        with pytest.raises(GoalRefused) as caught:
            refusing("redy")
        assert caught.value.suggestion is not None
        assert caught.value.suggestion.named == "ready"


def test_checks_come_in_the_order_of_the_targets(arm: Arm) -> None:
    checks = arm.check({"elbow_flex": 0.3}, pose(0.9, 0.0, 0.0), {"elbow_flex": 9.0}, pose(0.25, 0.0, 0.15))
    assert [check.reachable for check in checks] == [True, False, False, True]


def test_the_gripper_opens_and_closes(arm: Arm) -> None:
    closed, opened = arm.gripper.range()
    assert arm.gripper.open().position == pytest.approx(opened, abs=0.05)
    assert arm.gripper.close(force=0.4).position == pytest.approx(closed, abs=0.05)
    with pytest.raises(RequestRefused, match=r"command\.position must be from"):
        arm.gripper.move(9.0)


def test_progress_is_reported(arm: Arm) -> None:
    arm.move_named("home")
    reported: list[str] = []
    arm.move("ready", on_progress=lambda progress: reported.append(progress.state))
    assert {"planning", "executing", "done"} <= set(reported)


def test_states_come_until_the_reader_leaves(arm: Arm) -> None:
    stamps = []
    for state in arm.states(rate_hz=50):
        stamps.append(state.stamp_s)
        if len(stamps) == 3:
            break
    assert sorted(set(stamps)) == stamps
    assert arm.asynchronous.connection.topics() == []


async def test_the_asynchronous_arm_has_the_same_methods(server: RunningServer) -> None:
    async with asyncio.timeout(TIMEOUT_S), await connect_async(server.url) as arm:
        await arm.move_named("home")
        plan = await arm.plan("ready")
        await plan.execute()
        assert (await arm.gripper.open()).position > 1.0
        async for state in arm.states():
            assert state.position_rad["elbow_flex"] == pytest.approx(0.5, abs=0.02)
            break


def test_numbers_of_numpy_are_taken(arm: Arm) -> None:
    arm.move_joints(dict(zip(("shoulder_pan", "elbow_flex"), np.array([0.1, 0.2], np.float32), strict=True)))
    arm.move_to(*np.array([0.25, 0.0, 0.15], np.float32), orientation=np.array([0.0, 0.0, 0.0, 1.0], np.float32))


def test_a_bad_value_is_refused_with_its_field(arm: Arm) -> None:
    bad: list[tuple[dict[str, Any], str]] = [
        ({"z": math.nan}, "pose.position"),
        ({"speed": 7.0}, "velocity_scaling"),
        ({"frame": "nowhere"}, "nowhere"),
    ]
    for arguments, sentence in bad:
        with pytest.raises(GoalRefused, match=sentence):
            arm.move_to(**{"x": 0.25, "y": 0.0, "z": 0.1, **arguments})


def test_a_subscription_that_is_refused_ends_with_the_servers_sentence(arm: Arm) -> None:
    with pytest.raises(RequestRefused, match="/joint_states"):
        next(arm.messages("/joint_states", String))
