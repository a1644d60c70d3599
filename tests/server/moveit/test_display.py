import numpy as np
import pytest

from robot.trajectory import Trajectory
from server.execution.motions import Performed
from server.graph.topics import Graph
from server.moveit.display import CONTACTS_TOPIC, PATH_TOPIC, PIPELINE_TOPIC, DisplayTopics
from tests.helpers.fake_arm import HOME
from tests.helpers.graph import listen
from tests.helpers.moveit import REGISTRY, ROBOT

MOTION = Trajectory(("elbow_flex",), np.array([0.0, 1.0]), np.array([[0.0], [0.5]]), np.zeros((2, 1)), np.zeros((2, 1)))


@pytest.fixture
def graph() -> Graph:
    return Graph(REGISTRY)


@pytest.fixture
def display(graph: Graph) -> DisplayTopics:
    return DisplayTopics(graph, ROBOT)


def test_a_planned_motion_is_shown_with_its_start(graph: Graph, display: DisplayTopics) -> None:
    heard = listen(graph, PATH_TOPIC)
    display.performed(Performed(HOME, (MOTION, MOTION)))
    (shown,) = heard
    assert shown["model_id"] == ROBOT.name
    assert len(shown["trajectory"]) == 2
    assert shown["trajectory_start"]["joint_state"]["name"] == list(HOME)


def test_contacts_are_spheres_in_place_of_those_before(graph, display) -> None:
    heard = listen(graph, CONTACTS_TOPIC)
    display.contacts([{"first": "gripper_link", "second": "crate", "depth_m": 0.01, "point_m": (0.3, 0.1, 0.2)}])
    clear, ball = heard[0]["markers"]
    assert clear["action"] == 3
    assert ball["ns"] == "gripper_link, crate"
    assert ball["pose"]["position"] == {"x": 0.3, "y": 0.1, "z": 0.2}
    assert ball["header"]["frame_id"] == ROBOT.root_link


def test_the_state_of_the_pipeline_is_published_for_subscribers_alone(graph: Graph, display: DisplayTopics) -> None:
    display.pipeline({}, {})
    heard = listen(graph, PIPELINE_TOPIC)
    display.pipeline({"group_name": "arm"}, {"planning_time": 0.5})
    (told,) = heard
    assert told["request"]["group_name"] == "arm"
    assert told["response"]["planning_time"] == 0.5
