"""An arm as others publish it, served and moved over a real socket: Panda, whose poses are whole ones."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from harness.clients import ArmClient, arm_client
from harness.server import RunningServer
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.robot_folder import _robots, _urdfs, find_example
from server.moveit.messages import pose_of, write_pose

pytestmark = pytest.mark.skipif(find_example("panda") is None, reason="the package example-robot-data is not installed")

# Bent, and far from every limit [rad].
BENT = (0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.7)

ARRIVED_RAD = 0.005
POSITION_M = 0.012


class ServedArm(NamedTuple):
    """A server with a published arm, and the arm's description."""

    running: RunningServer
    robot: RobotModel

    def tip(self, positions_rad: dict[str, float]) -> np.ndarray:
        rest = {joint.name: 0.0 for joint in self.robot.movable_joints}
        return ForwardPlacements(self.robot).transforms({**rest, **positions_rad})[self.robot.tip_link]


@pytest.fixture(scope="module")
def arm() -> Iterator[ServedArm]:
    robots = _robots()
    assert robots is not None
    packages, urdf = (robots.parents[1],), _urdfs(robots)["panda"]
    srdf = Path(urdf.parents[1] / "srdf" / "panda.srdf")
    with RunningServer(f"--port 0 --urdf {urdf} --srdf {srdf} --package-path {packages[0]}") as running:
        yield ServedArm(running, model.load(urdf, srdf, packages))


async def goes(client: ArmClient, **goal: Any) -> dict[str, float]:
    """Send a goal; returns where the joints are when it is reached."""
    answer = await client.call("/moveit_goal", **goal)
    assert answer["success"], answer
    return await client.positions()


async def test_goals_of_joints_and_of_whole_poses_and_straight_paths_are_reached(arm: ServedArm) -> None:
    root, joints = arm.robot.root_link, arm.robot.groups[arm.robot.default_group].joints
    bent = dict(zip(joints, BENT, strict=True))
    async with arm_client(arm.running.url) as client:
        at = await goes(client, joints={"name": joints, "position": list(bent.values())})
        assert {name: at[name] for name in joints} == pytest.approx(bent, abs=ARRIVED_RAD)

        wanted = arm.tip({**bent, joints[0]: bent[joints[0]] + 0.4, joints[-1]: 0.1})
        pose = {"header": {"frame_id": root}, "pose": write_pose(pose_of(wanted))}
        reached = arm.tip(await goes(client, pose=pose))
        np.testing.assert_allclose(reached[:3, 3], wanted[:3, 3], atol=POSITION_M)
        np.testing.assert_allclose(reached[:3, :3], wanted[:3, :3], atol=0.03)

        lowered = reached.copy()
        lowered[2, 3] -= 0.08
        path = {
            "header": {"frame_id": root},
            "group_name": arm.robot.default_group,
            "waypoints": [write_pose(pose_of(lowered))],
            "max_step": 0.01,
            "avoid_collisions": True,
        }
        answer = await client.call("/compute_cartesian_path", **path)
        assert answer["fraction"] == 1.0, answer["error_code"]
        action, type_name = "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory"
        done = await client.result(await client.send_goal(action, type_name, {"trajectory": answer["solution"]}))
        assert done["values"]["error_code"]["val"] == 1, done
        np.testing.assert_allclose(arm.tip(await client.positions())[:3, 3], lowered[:3, 3], atol=POSITION_M)
