"""Files of worlds: the built-in ones are read, and each thing that is wrong with one has a sentence."""

import json
from pathlib import Path
from typing import Any

import pytest

from protocol.errors import MessageError
from server.graph.topics import Graph
from server.moveit.scene.worlds import read_world
from tests.helpers.messages import REGISTRY

MESSAGE_TYPES = Graph(REGISTRY).message_types
CUBE = {"id": "cube", "primitives": [{"type": 1, "dimensions": [0.03, 0.03, 0.03]}]}


@pytest.mark.parametrize(("name", "movable"), [("cubes", 4), ("table", 1), ("peg", 1)])
def test_a_built_in_world_has_objects_and_movable_ones(name: str, movable: int) -> None:
    scene, bodies = read_world(name, MESSAGE_TYPES)
    assert len(scene["world"]["collision_objects"]) >= len(bodies)
    assert [body["movable"] for body in bodies] == [True] * movable


def test_a_saved_scene_is_a_world_of_fixed_objects(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    path.write_text(json.dumps({"world": {"collision_objects": [CUBE]}}))
    scene, bodies = read_world(str(path), MESSAGE_TYPES)
    assert ([each["id"] for each in scene["world"]["collision_objects"]], list(bodies)) == (["cube"], [])


REFUSED: list[tuple[Any, str]] = [
    ({"bodies": 3}, "wanted armbridge_msgs/srv/SetBody_Request, got 3"),
    ({"bodies": [{"id": "cube", "weight": 1.0}]}, "field weight: wanted a field of .*SetBody_Request"),
    ({"bodies": [{"id": "ball"}]}, r"bodies\[0\]\.id: there is no object 'ball' in the scene"),
    ({"bodies": [{"id": "cube", "mass": -1.0}]}, r"bodies\[0\]\.mass must be 0 to 100 kg, .* not -1"),
    ({"bodies": [{"id": "cube", "friction": float("nan")}]}, r"bodies\[0\]\.friction must be 0 to 10, .* nan"),
    ([], "message: wanted moveit_msgs/msg/PlanningScene, got a list of 0"),
    ({"objects": []}, "field objects: wanted a field of moveit_msgs/msg/PlanningScene"),
]


@pytest.mark.parametrize(("content", "sentence"), REFUSED)
def test_what_is_wrong_with_a_file_has_a_sentence(content: Any, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.json"
    whole = {"world": {"collision_objects": [CUBE]}, **content} if isinstance(content, dict) else content
    path.write_text(json.dumps(whole))
    with pytest.raises((ValueError, MessageError), match=sentence):
        read_world(str(path), MESSAGE_TYPES)


def test_a_file_that_is_not_there_or_no_json_has_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no such file; the built-in worlds are cubes, peg, table"):
        read_world("cube", MESSAGE_TYPES)
    path = tmp_path / "broken.json"
    path.write_text("{")
    with pytest.raises(ValueError, match="Expecting property name"):
        read_world(str(path), MESSAGE_TYPES)
