from __future__ import annotations

import asyncio
import base64
import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.registry import Registry
from robot.description import model
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber
from server.moveit.description import (
    FILE_SERVICE,
    SRDF_TOPIC,
    URDF_TOPIC,
    RobotDescription,
)

REGISTRY = Registry.load()
ROBOT = model.builtin()
PACKAGE = "so101_description"
CLIENT = Node("client")


@pytest.fixture
def files(tmp_path: Path) -> Path:
    directory = tmp_path / "robot"
    (directory / "assets").mkdir(parents=True)
    (directory / "assets" / "base.stl").write_bytes(b"solid")
    return directory


@pytest.mark.parametrize("topic", [URDF_TOPIC, SRDF_TOPIC])
def test_who_subscribes_later_gets_the_description_and_who_asks_for_it_the_parameter(topic: str) -> None:
    graph = Graph(REGISTRY)
    parameters: dict[str, str] = {}
    RobotDescription(graph, ROBOT, parameters.__setitem__).open()
    (kept,) = graph.subscribe(CLIENT, topic, "std_msgs/String", Subscriber(lambda _: None))
    assert ET.fromstring(kept.msg["data"]).tag == "robot"
    assert json.loads(parameters[topic]) == json.loads(parameters[topic[1:]]) == kept.msg["data"]


async def test_a_mesh_is_served_by_the_name_that_the_description_gives_it(files: Path) -> None:
    graph = Graph(REGISTRY)
    RobotDescription(graph, replace(ROBOT, mesh_directory=files), lambda _name, _value: None).open()
    answered: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
    graph.services.call(CLIENT, FILE_SERVICE, {"name": f"package://{PACKAGE}/assets/base.stl"}, answered.set_result)
    assert base64.b64decode((await answered).values["value"]) == b"solid"
