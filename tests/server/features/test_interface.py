import json
from typing import Any

from websockets.datastructures import Headers
from websockets.http11 import Request

from protocol.registry import Registry
from protocol.type_descriptions import message_hash
from server.app import App
from server.config import Settings
from server.features.clients import PATH
from server.graph.permissions import Role
from tests.helpers.rules import server_rules


async def document(**settings: Any) -> Any:
    app = App(Settings.model_validate(settings))
    response = await app._clients.routes[PATH](Request(f"/{PATH}", Headers()))
    assert (response.status, response.headers["Content-Type"]) == (200, "application/json")
    for feature in app.features:
        if feature.name == "the logs":
            await feature.stop()
    return json.loads(response.body)


async def test_the_interface_has_the_rules_by_which_the_server_decides() -> None:
    got = await document(goals={"confirm": True})
    for kind, rules in zip(("services", "topics", "actions"), server_rules(), strict=True):
        assert rules
        for name, rule in rules.items():
            shown = got[kind][name]
            assert (shown["role"], shown["drives"], shown["stops"]) == (rule.role.name.lower(), rule.drives, rule.stops)
    assert got["topics"]["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    assert got["services"]["/moveit_goal"]["type"] == "armbridge_msgs/srv/MoveitGoal"
    assert got["roles"] == [role.name.lower() for role in Role]
    assert (got["settings"]["confirm"], got["settings"]["control"]) == (True, "lease")
    assert [arm["name"] for arm in got["arms"]] == [""]
    assert (got["arms"][0]["frame"], got["arms"][0]["tip"]) == ("base_link", "gripper_frame_link")
    assert len(got["arms"][0]["groups"][got["arms"][0]["group"]]) == 5


async def test_names_that_a_setting_hides_are_left_out_and_stops_are_not() -> None:
    got = await document(access={"services_glob": ["/moveit_goal"], "topics_glob": ["/joint_states"]})
    assert {name for name in got["services"] if not name.startswith("/rosapi/")} >= {"/moveit_goal", "/arm/stop"}
    assert "/arm/enable" not in got["services"]
    assert "/stop" in got["topics"]
    assert "/arm/state" not in got["topics"]


async def test_each_type_has_its_hash_and_each_of_several_arms_its_description() -> None:
    registry, got = Registry.load(), await document(arms={"left": {}, "right": {}})
    assert got["types"].keys() == set(registry.type_names())
    assert got["types"]["std_msgs/msg/String"] == message_hash(registry, "std_msgs/msg/String")
    assert got["types"]["armbridge_msgs/action/MoveitGoal"].startswith("sha256_")
    assert len(got["types_sha256"]) == 64
    assert [arm["name"] for arm in got["arms"]] == ["", "left", "right"]
    assert got["arms"][1]["tip"].startswith("left")
