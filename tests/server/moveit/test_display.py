import numpy as np

from robot.trajectory import Trajectory
from server.execution.motions import Performed
from server.graph.topics import Graph
from server.moveit.display import CONTACTS_TOPIC, PATH_TOPIC, PIPELINE_TOPIC, DisplayTopics
from tests.helpers.fake_arm import HOME
from tests.helpers.graph import listen
from tests.helpers.moveit import REGISTRY, ROBOT

MOTION = Trajectory(("elbow_flex",), np.array([0.0, 1.0]), np.array([[0.0], [0.5]]), np.zeros((2, 1)), np.zeros((2, 1)))


def test_motions_contacts_and_the_state_of_the_pipeline_are_shown_to_subscribers() -> None:
    graph = Graph(REGISTRY)
    display = DisplayTopics(graph, ROBOT)
    display.pipeline({}, {})
    paths, contacts, pipeline = (listen(graph, topic) for topic in (PATH_TOPIC, CONTACTS_TOPIC, PIPELINE_TOPIC))
    display.performed(Performed(HOME, (MOTION, MOTION)))
    (shown,) = paths
    assert (shown["model_id"], len(shown["trajectory"])) == (ROBOT.name, 2)
    assert shown["trajectory_start"]["joint_state"]["name"] == list(HOME)
    # Contacts are spheres, in place of those before.
    display.contacts([{"first": "gripper_link", "second": "crate", "depth_m": 0.01, "point_m": (0.3, 0.1, 0.2)}])
    clear, ball = contacts[0]["markers"]
    assert (clear["action"], ball["ns"]) == (3, "gripper_link, crate")
    assert ball["pose"]["position"] == {"x": 0.3, "y": 0.1, "z": 0.2}
    assert ball["header"]["frame_id"] == ROBOT.root_link
    display.pipeline({"group_name": "arm"}, {"planning_time": 0.5})
    (told,) = pipeline
    assert (told["request"]["group_name"], told["response"]["planning_time"]) == ("arm", 0.5)
