"""Arms as others publish them, served and moved over a real socket: Panda and UR5, whose poses are whole ones."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.clients import arm_client, frame_client
from harness.server import RunningServer
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.robot_folder import _robots, _urdfs, find_example
from server.moveit.messages import pose_of, write_pose

pytestmark = [
    pytest.mark.skipif(find_example("panda") is None, reason="the package example-robot-data is not installed")
]

# The package's own SRDF of the UR5 has no group; links that never touch are those of MoveIt's setup, as neighbours are.
UR5_SRDF = """
<robot name="ur5">
  <group name="arm"><chain base_link="base_link" tip_link="tool0"/></group>
  <disable_collisions link1="base_link" link2="shoulder_link" reason="Adjacent"/>
  <disable_collisions link1="shoulder_link" link2="upper_arm_link" reason="Adjacent"/>
  <disable_collisions link1="upper_arm_link" link2="forearm_link" reason="Adjacent"/>
  <disable_collisions link1="forearm_link" link2="wrist_1_link" reason="Adjacent"/>
  <disable_collisions link1="wrist_1_link" link2="wrist_2_link" reason="Adjacent"/>
  <disable_collisions link1="wrist_2_link" link2="wrist_3_link" reason="Adjacent"/>
  <disable_collisions link1="wrist_1_link" link2="wrist_3_link" reason="Never"/>
</robot>
"""

# Bent, and far from every limit [rad].
BENT = {"panda": (0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.7), "ur5": (0.3, -1.2, 1.4, -1.7, -1.5, 0.2)}

ARRIVED_RAD = 0.005
POSITION_M = 0.012


class ServedArm:
    """A server with a published arm, and the arm's description."""

    def __init__(self, name: str, running: RunningServer, robot: RobotModel) -> None:
        self.running = running
        self.robot = robot
        self.joints = robot.groups[robot.default_group].joints
        self.bent = dict(zip(self.joints, BENT[name], strict=True))

    def tip(self, positions_rad: dict[str, float]) -> np.ndarray:
        rest = {joint.name: 0.0 for joint in self.robot.movable_joints}
        return ForwardPlacements(self.robot).transforms({**rest, **positions_rad})[self.robot.tip_link]

    def pose(self, transform: np.ndarray) -> dict[str, Any]:
        return {"header": {"frame_id": self.robot.root_link}, "pose": write_pose(pose_of(transform))}


@pytest.fixture(scope="module", params=sorted(BENT))
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedArm]:
    robots = _robots()
    assert robots is not None
    packages = (robots.parents[1],)
    urdf, srdf = _urdfs(robots)[request.param], tmp_path_factory.mktemp("arm") / "arm.srdf"
    srdf.write_text(UR5_SRDF if request.param == "ur5" else Path(urdf.parents[1] / "srdf" / "panda.srdf").read_text())
    arguments = f"--urdf {urdf} --srdf {srdf} --package-path {packages[0]}"
    with RunningServer(f"--port 0 {arguments}", {"ARMBRIDGE_ACCESS__CONTROL": "shared"}) as running:
        yield ServedArm(request.param, running, model.load(urdf, srdf, packages))


async def test_goals_of_joints_and_of_whole_poses_and_straight_paths_are_reached(arm: ServedArm) -> None:
    async with frame_client(arm.running.url) as client, arm_client(arm.running.url) as caller:
        await client.open_goals()
        await client.subscribe("/joint_states", "sensor_msgs/JointState")

        goal = {"name": list(arm.bent), "position": list(arm.bent.values())}
        result = await client.reach("/moveit_goal_joints", goal)
        assert result["val"] == 1, result
        at = await client.positions()
        assert [at[name] for name in arm.joints] == pytest.approx(list(arm.bent.values()), abs=ARRIVED_RAD)

        turned = {**arm.bent, arm.joints[0]: arm.bent[arm.joints[0]] + 0.4, arm.joints[-1]: 0.1}
        wanted = arm.tip(turned)
        result = await client.reach("/moveit_goal_pose", arm.pose(wanted))
        assert result["val"] == 1, result
        reached = arm.tip(await client.positions())
        np.testing.assert_allclose(reached[:3, 3], wanted[:3, 3], atol=POSITION_M)
        np.testing.assert_allclose(reached[:3, :3], wanted[:3, :3], atol=0.03)

        lowered = reached.copy()
        lowered[2, 3] -= 0.08
        path = {
            "header": {"frame_id": arm.robot.root_link},
            "group_name": arm.robot.default_group,
            "waypoints": [arm.pose(lowered)["pose"]],
            "max_step": 0.01,
            "avoid_collisions": True,
        }
        answer = await caller.call("/compute_cartesian_path", **path)
        assert answer["fraction"] == 1.0, answer["error_code"]
        action, type_name = "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory"
        done = await caller.result(await caller.send_goal(action, type_name, {"trajectory": answer["solution"]}))
        assert done["values"]["error_code"]["val"] == 1, done
        np.testing.assert_allclose(arm.tip(await client.positions())[:3, 3], lowered[:3, 3], atol=POSITION_M)
