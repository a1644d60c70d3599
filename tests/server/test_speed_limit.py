"""The speed limit holds for every kind of motion, by the goals that the arm process writes to its joints.

Server, supervisor and controller are the real ones, in stepped time; the joints are ideal.
"""

import asyncio
import math
from collections.abc import Callable
from contextvars import Context
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot.hardware.ideal import IdealArm
from robot.trajectory import PERIOD_S, Vector
from server.config import Settings
from server.moveit.parameters import MoveItParameters
from server.teaching.taught_motion import TaughtMotion
from tests.helpers.arm_rig import BOUNDS, NAMES
from tests.helpers.messages import time_message
from tests.helpers.moveit import FORWARD, ROBOT
from tests.helpers.stage import ARM_JOINTS, DEFAULTS, RigArm, ServerStage, inline_threads
from tests.helpers.stage import REQUESTS as SHARED_REQUESTS

pytestmark = pytest.mark.stepped_time

LIMIT = 0.1

# The controller chooses the rate of a motion so that no joint is faster; what is left is rounding.
TOLERANCE = 1e-6

# The motions take longer under the limit; their greatest speed comes within this time [s].
TRIAL_S, LOOK_S = 3.5, 0.5

READY = ROBOT.named_states["arm"]["ready"]
REACH = {"joint_names": list(ARM_JOINTS), "points": [{"positions": [0.8, 0.0, 0.0, 0.0, 0.0]}]}
SWING = TaughtMotion(ARM_JOINTS, np.arange(6) * 0.2, np.linspace(0.0, 0.9, 6)[:, np.newaxis] * np.eye(5)[0])


PUBLISHING: set[asyncio.Future[None]] = set()


def follow(stage: ServerStage) -> None:
    """Follow a leader who waits for 2 s and then turns at 1 rad/s."""
    stage.call("/teleop/start", leader="/glove")

    async def lead() -> None:
        for at_s in np.arange(0.0, TRIAL_S, 0.02).tolist():
            pan_rad = 0.1 + min(max(at_s - 2.0, 0.0), 1.2)
            header = {"stamp": time_message(5.0 + at_s)}
            sample = {"header": header, "name": ["shoulder_pan"], "position": [pan_rad]}
            stage.publish("/glove", "sensor_msgs/JointState", sample)
            await asyncio.sleep(0.02)

    # The leader is no part of the call.
    Context().run(lambda: PUBLISHING.add(asyncio.ensure_future(lead())))


def pose_goal(stage: ServerStage) -> None:
    """Ask for the pose of the tip at the state *ready*."""
    placed = FORWARD.transforms(dict.fromkeys(NAMES, 0.0) | READY)["gripper_frame_link"]
    position = dict(zip("xyz", placed[:3, 3].tolist(), strict=True))
    orientation = dict(zip("xyzw", Rotation.from_matrix(placed[:3, :3]).as_quat().tolist(), strict=True))
    message = {"header": {"frame_id": ROBOT.root_link}, "pose": {"position": position, "orientation": orientation}}
    stage.publish("/moveit_goal_pose", "geometry_msgs/PoseStamped", message)


def move_group(factor: float) -> Callable[[ServerStage], None]:
    goals = [{"joint_constraints": [{"joint_name": "shoulder_pan", "position": 1.2}]}]
    request = {"group_name": "arm", "goal_constraints": goals, "max_velocity_scaling_factor": factor}
    scaled = {**request, "max_acceleration_scaling_factor": 1.0}
    return lambda stage: stage.send("/move_action", "moveit_msgs/action/MoveGroup", request=scaled)


def trajectory(duration_s: int) -> dict[str, Any]:
    """A trajectory to 0.8 rad, at a greatest speed that is above the limit."""
    return {**REACH, "points": [{**REACH["points"][0], "time_from_start": {"sec": duration_s, "nanosec": 0}}]}


SHARED = ("a named goal", "joints", "a called goal", "MoveGroup", "the gripper", "a jog", "parking")
REQUESTS: dict[str, Callable[[ServerStage], None]] = {
    **{name: SHARED_REQUESTS[name] for name in SHARED},
    "a pose": pose_goal,
    "MoveGroup with the factor 0.3": move_group(0.3),
    "MoveGroup with the factor 1": move_group(1.0),
    "FollowJointTrajectory": lambda stage: stage.send(
        "/arm_controller/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory", trajectory=trajectory(1)
    ),
    "ExecuteTrajectory": lambda stage: stage.send(
        "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", trajectory={"joint_trajectory": trajectory(1)}
    ),
    "a following": follow,
    "a replay": lambda stage: stage.send("/replay_motion", "armbridge_msgs/action/ReplayMotion", name="swing"),
}


@pytest.fixture
def goals_rad(monkeypatch: pytest.MonkeyPatch) -> list[Vector]:
    """Goals that were written to the joints, one each tick."""
    inline_threads(monkeypatch)
    written: list[Vector] = []
    write = IdealArm.write_goals

    def note(arm: IdealArm, goal_rad: Vector) -> None:
        written.append(goal_rad)
        write(arm, goal_rad)

    monkeypatch.setattr(IdealArm, "write_goals", note)
    return written


def share_of(goals_rad: list[Vector]) -> float:
    """Return the greatest velocity of the goals, as a share of the joint's velocity limit."""
    steps_rad = np.abs(np.diff(goals_rad, axis=0))
    return float((steps_rad / (BOUNDS.max_velocity * PERIOD_S)).max())


async def peak_share(
    request: Callable[[ServerStage], None],
    limit: float,
    goals_rad: list[Vector],
    settings: Settings = DEFAULTS,
    enough: float = math.inf,
) -> float:
    """Return the greatest velocity that a request commands under a limit, or one that is enough."""
    arm = RigArm(settings)
    running = asyncio.create_task(arm.run())
    try:
        await asyncio.sleep(0.1)
        await arm.stage.teaching._motions.save("swing", SWING)
        arm.stage.call("/arm/set_speed_limit", speed_limit=limit)
        request(arm.stage)
        for _ in range(round(TRIAL_S / LOOK_S)):
            await asyncio.sleep(LOOK_S)
            if share_of(goals_rad) > enough:
                break
    finally:
        while PUBLISHING:
            PUBLISHING.pop().cancel()
        await arm.stage.close()
        running.cancel()
    return share_of(goals_rad)


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=REQUESTS.keys())
async def test_no_joint_is_commanded_faster_than_the_speed_limit_and_without_it_the_motion_is_faster(
    request_: Callable[[ServerStage], None], goals_rad: list[Vector]
) -> None:
    assert LIMIT / 2 < await peak_share(request_, LIMIT, goals_rad) <= LIMIT * (1.0 + TOLERANCE)
    goals_rad.clear()
    assert await peak_share(request_, 1.0, goals_rad, enough=1.2 * LIMIT) > 1.2 * LIMIT


@pytest.mark.parametrize("action", ["FollowJointTrajectory", "ExecuteTrajectory"])
async def test_a_faster_trajectory_is_refused_if_the_setting_says_so(action: str, goals_rad: list[Vector]) -> None:
    answers: list[Any] = []

    def ask(stage: ServerStage) -> None:
        stage.answers = answers
        REQUESTS[action](stage)

    settings = Settings(moveit=MoveItParameters(faster_trajectories="refuse"))
    assert await peak_share(ask, LIMIT, goals_rad, settings) == 0.0
    assert "the speed limit of 0.1 times its velocity limit; moveit.faster_trajectories = slow" in str(answers)
