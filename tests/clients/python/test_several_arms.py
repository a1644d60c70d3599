"""Two arms of one server over one connection, each by its name."""

import pytest

from armbridge_client import ArmError, GoalRefused, after_stop, connect, pose
from harness.server import FAST_ARMS, ROOT, RunningServer


def test_each_arm_has_its_own_names() -> None:
    with (
        RunningServer(f"--port 0 --config {ROOT / 'examples' / 'two_arms.toml'}", FAST_ARMS) as server,
        connect(server.url, arm="left") as left,
    ):
        right = left.other("right")
        for arm in (left, right):
            arm.plan({"shoulder_pan": 0.3}).execute()
            assert arm.state().position_rad[f"{arm.name}_shoulder_pan"] == pytest.approx(0.3, abs=0.02)
            # The server lists the named states of one group, with that group's joints.
            arm.plan("ready").execute()
            assert arm.state().position_rad[f"{arm.name}_elbow_flex"] == pytest.approx(0.5, abs=0.02)
            assert arm.gripper.open().position > 1.0
            assert arm.plan({"gripper": 1.0}).duration_s > 0.0
            arm.plan(pose(0.25, 0.05, 0.2)).execute()
            arm.move_to(0.25, 0.0, 0.2)
        # Each frame is its arm's: the same point of both is as far apart as their feet.
        assert left.tip().pose.position.y - right.tip().pose.position.y == pytest.approx(0.4, abs=0.03)
        assert left.control().holder == left.server.name
        with pytest.raises(GoalRefused):
            left.move_joints({"right_shoulder_pan": 0.1})
        with pytest.raises(ArmError, match="no arm 'middle'; its arms: left, right"):
            left.other("middle")
        assert left.check({"elbow_flex": 0.1}, pose(0.25, 0.0, 0.2))[1].reachable
        with pytest.raises(ArmError, match="poses of the arm right cannot be checked"):
            right.check(pose(0.25, 0.0, 0.2))
        both = left.other("")
        both.move("home", group="both_arms")
        # A stop of one arm is none of the other.
        with after_stop(both.stops()):
            right.stop()
            left.move_joints({"shoulder_pan": 0.1})
            for move in (
                lambda: right.move_joints({"shoulder_pan": 0.1}),
                lambda: both.move("ready", group="both_arms"),
            ):
                with pytest.raises(GoalRefused, match="the arm was stopped"):
                    move()
