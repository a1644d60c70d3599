"""Foxglove's own readers on the bytes that it subscribes to, and the layout in ``examples/``."""

import asyncio
import base64
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cbor2
import pytest
from websockets.asyncio.client import ClientConnection, connect

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.programs import install_with_npm, run

HERE = Path(__file__).parent / "foxglove"
LAYOUT = json.loads((ROOT / "examples" / "foxglove_layout.json").read_text())
PANELS: dict[str, dict[str, Any]] = LAYOUT["configById"]

# Beside what the layout shows: what its 3D panel subscribes to unasked.
SHOWN_UNASKED = ("/tf", "/tf_static", "/monitored_planning_scene")


@dataclass
class Heard:
    """What a client of Foxglove's kind gets to know."""

    types: dict[str, str]
    services: list[str]
    messages: dict[str, dict[str, str]]


def panels(kind: str) -> list[dict[str, Any]]:
    return [panel for name, panel in PANELS.items() if name.split("!")[0] == kind]


def shown_topics() -> set[str]:
    """Every topic that a panel reads."""
    paths = [path["value"] for plot in panels("Plot") for path in plot["paths"]]
    paths += [panel["topicPath"] for panel in panels("RawMessages")]
    paths += [panel["topicToRender"] for kind in ("DiagnosticSummary", "RosOut") for panel in panels(kind)]
    paths += [layer["topic"] for panel in panels("3D") for layer in panel["layers"].values() if layer.get("topic")]
    return {path.split(".")[0] for path in paths}


def placed(node: Any) -> list[str]:
    """The panels of a layout, from left to right."""
    return [node] if isinstance(node, str) else [*placed(node["first"]), *placed(node["second"])]


async def call(websocket: ClientConnection, service: str) -> dict[str, Any]:
    await websocket.send(json.dumps({"op": "call_service", "service": service, "args": {}}))
    answer: dict[str, Any] = json.loads(await websocket.recv())["values"]
    return answer


async def listen(url: str, topics: set[str]) -> Heard:
    """Subscribe as Foxglove does, have the arm move, and wait for a message on each topic."""
    async with asyncio.timeout(TIMEOUT_S), connect(url, max_size=None) as websocket:
        known = await call(websocket, "/rosapi/topics_and_raw_types")
        services = (await call(websocket, "/rosapi/services"))["services"]
        types = dict(zip(known["topics"], known["types"], strict=True))
        texts = dict(zip(known["topics"], known["typedefs_full_text"], strict=True))
        for topic in topics:
            await websocket.send(json.dumps({"op": "subscribe", "topic": topic, "compression": "cbor-raw"}))
        await websocket.send(json.dumps({"op": "publish", "topic": "/moveit_goal_named", "msg": {"data": "ready"}}))
        messages: dict[str, dict[str, str]] = {}
        while topics - messages.keys():
            told = cbor2.loads(await websocket.recv())
            data = base64.b64encode(told["msg"]["bytes"]).decode()
            messages[told["topic"]] = {"definition": texts[told["topic"]], "base64": data}
    return Heard(types, services, messages)


@pytest.fixture(scope="module")
def heard(server: RunningServer) -> Heard:
    return asyncio.run(listen(server.url, shown_topics() | set(SHOWN_UNASKED)))


@pytest.fixture(scope="module")
def decoded(heard: Heard, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Every message as Foxglove's readers decode it."""
    folder = tmp_path_factory.mktemp("foxglove")
    shutil.copytree(HERE, folder, dirs_exist_ok=True)
    install_with_npm(folder)
    told = json.dumps(heard.messages)
    done = run("node", "decode.mjs", cwd=folder, input=told)
    assert done.returncode == 0, done.stderr
    messages: dict[str, Any] = json.loads(done.stdout)
    return messages


def test_every_panel_has_its_place_and_its_topics_are_readable(heard: Heard, decoded: dict[str, Any]) -> None:
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)
    assert shown_topics() <= heard.types.keys()
    assert decoded.keys() == shown_topics() | set(SHOWN_UNASKED)


def test_a_joint_state_has_the_joints_that_the_plots_name(decoded: dict[str, Any]) -> None:
    state = decoded["/joint_states"]
    assert len(state["position"]) == len(state["effort"]) == len(state["name"])
    for plot in panels("Plot"):
        assert [path["label"] for path in plot["paths"]] == state["name"]


def test_the_robot_and_its_transforms_are_told(decoded: dict[str, Any]) -> None:
    assert decoded["/robot_description"]["data"].lstrip().startswith("<")
    assert "gripper_frame_link" in {
        transform["child_frame_id"] for topic in ("/tf", "/tf_static") for transform in decoded[topic]["transforms"]
    }


def test_buttons_publish_on_topics_and_call_services_that_there_are(heard: Heard) -> None:
    for button in panels("Publish"):
        assert heard.types[button["topicName"]] == button["datatype"]
        json.loads(button["value"])
    assert {button["serviceName"] for button in panels("CallService")} <= set(heard.services)
