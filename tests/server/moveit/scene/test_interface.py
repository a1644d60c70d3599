from planners.problem import MoveItErrorCode
from protocol.registry import Registry
from server.graph import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.interface import SceneInterface
from server.moveit.scene.scene_state import AssumedStates, SceneState
from tests.helpers.arm_server import ArmClient
from tests.helpers.clock import FakeClock
from tests.helpers.planning_scene import ROBOT, box, current_state, pose

TOPICS = {
    "/planning_scene": "moveit_msgs/msg/PlanningScene",
    "/planning_scene_world": "moveit_msgs/msg/PlanningSceneWorld",
    "/collision_object": "moveit_msgs/msg/CollisionObject",
    "/attached_collision_object": "moveit_msgs/msg/AttachedCollisionObject",
    "/monitored_planning_scene": "moveit_msgs/msg/PlanningScene",
}
SERVICES = {
    "/get_planning_scene": "moveit_msgs/srv/GetPlanningScene",
    "/apply_planning_scene": "moveit_msgs/srv/ApplyPlanningScene",
    "/clear_octomap": "std_srvs/srv/Empty",
    "/save_geometry_to_file": "moveit_msgs/srv/SaveGeometryToFile",
    "/load_geometry_from_file": "moveit_msgs/srv/LoadGeometryFromFile",
}


def test_the_scene_has_moveits_names_and_types():
    graph = Graph(Registry.load(), call_later=FakeClock().call_later)
    scene = SceneInterface(graph, ROBOT, SceneState(ROBOT), AssumedStates(ROBOT), MoveItParameters())
    scene.open(current_state())
    assert graph.topic_types() == TOPICS
    assert graph.services.types() == SERVICES
    scene.close()


async def test_what_a_client_puts_in_the_way_is_in_the_way_until_it_takes_it_away(client: ArmClient) -> None:
    point = {"x": 0.3, "y": 0.1, "z": 0.05}
    block = box("block", at=pose(**point))
    assert (
        await client.call("/apply_planning_scene", scene={"is_diff": True, "world": {"collision_objects": [block]}})
    )["success"]
    results = len(client.topics.get("/moveit_goal_result", ()))
    await client.goal("/moveit_goal_pose", "geometry_msgs/PoseStamped", {"pose": {"position": point}})
    result = (await client.until("/moveit_goal_result", lambda heard: len(heard) > results))[-1]
    assert result["val"] == MoveItErrorCode.GOAL_IN_COLLISION
    assert "block" in result["message"]
    everything = {"is_diff": True, "world": {"collision_objects": [{"operation": 1}]}}
    assert (await client.call("/apply_planning_scene", scene=everything))["success"]
    scene = (await client.call("/get_planning_scene"))["scene"]
    assert scene["world"]["collision_objects"] == []
