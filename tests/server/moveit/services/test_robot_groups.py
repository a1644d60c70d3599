"""The joint groups that a page is told: tips, grippers, namespaces, and links that a held object may touch."""

import json

import pytest

from robot.description import model
from robot.description.joined import PlacedArm, joined, prefixed
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.services.description import ROBOT_TOPIC, groups_document, publish_groups
from tests.helpers.graph import listen
from tests.helpers.moveit import REGISTRY, ROBOT

PARAMETERS = MoveItParameters()


def joint(name: str, kind: str, parent: str, child: str, limits: str = 'lower="-1" upper="2"', more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.1"/>'
        f'<axis xyz="0 0 1"/><limit {limits} velocity="1" effort="1"/>{more}</joint><link name="{child}"/>'
    )


# A lift, a wheel and an arm, whose two fingers carry a third that follows one of them.
SLIDES = 'lower="0" upper="0.05"'
LIFT = f"""<robot name="r"><link name="base"/>
{joint("lift", "prismatic", "base", "column", 'lower="0" upper="0.4"')}
{joint("turn", "continuous", "column", "shoulder", "")}{joint("bend", "revolute", "shoulder", "fore")}
{joint("mount", "fixed", "fore", "hand", "")}{joint("left", "prismatic", "hand", "left_finger", SLIDES)}
{joint("right", "prismatic", "hand", "right_finger", SLIDES)}
{joint("nail", "prismatic", "left_finger", "nail_link", SLIDES, '<mimic joint="left"/>')}</robot>"""
LIFT_GROUPS = """<robot name="r">
<group name="fingers"><joint name="left"/><joint name="right"/></group>
<group name="upper"><chain base_link="column" tip_link="hand"/></group>
<group name="whole"><joint name="lift"/><group name="upper"/></group>
<group name="ends"><joint name="lift"/><joint name="bend"/></group>
<end_effector name="hand" parent_link="hand" group="fingers" parent_group="upper"/>
<group_state name="open" group="fingers"><joint name="left" value="0.04"/><joint name="right" value="0.04"/>
</group_state>
</robot>"""


def test_groups_have_their_joints_tips_and_the_gripper_and_grippers_are_no_groups() -> None:
    robot = model.parse(LIFT, LIFT_GROUPS)
    document = groups_document(robot, {"": robot}, PARAMETERS)
    kinds = {"lift": "prismatic", "turn": "continuous", "bend": "revolute"}
    assert document["joints"] == {**kinds, "left": "prismatic", "right": "prismatic"}
    assert [(each["name"], each["joints"], each["tip"]) for each in document["groups"]] == [
        ("upper", ("turn", "bend"), "hand"),
        ("whole", ("lift", "turn", "bend"), "hand"),
        ("ends", ("lift", "bend"), "fore"),
    ]
    upper = document["groups"][0]
    action = "/gripper_controller/gripper_cmd"
    assert upper["gripper"] == {"joints": ("left", "right"), "open": 0.04, "closed": 0.0, "action": action}
    assert upper["touch_links"] == ["fore", "hand", "left_finger", "nail_link", "right_finger"]
    assert document["default_group"] == "upper"
    # Six joints of 0.1 m one behind the other, of which the lift and a finger slide.
    assert document["reach_m"] == pytest.approx(0.6 + 0.4 + 0.05)


def test_groups_are_latched_as_json_and_of_several_arms_each_names_its_arm() -> None:
    graph = Graph(REGISTRY)
    publish_groups(graph, ROBOT, {"": ROBOT}, PARAMETERS)
    (kept,) = listen(graph, ROBOT_TOPIC)
    (arm,) = json.loads(kept["data"])["groups"]
    assert (arm["name"], arm["tip"], arm["namespace"]) == ("arm", "gripper_frame_link", "")
    arms = {name: prefixed(ROBOT, name) for name in ("left", "right")}
    document = groups_document(joined("both", {name: PlacedArm(arm) for name, arm in arms.items()}), arms, PARAMETERS)
    groups = {each["name"]: each for each in document["groups"]}
    namespaces = {name: each["namespace"] for name, each in groups.items()}
    assert namespaces == {"left_arm": "/left", "right_arm": "/right", "both_arms": None}
    assert groups["right_arm"]["gripper"]["action"] == "/right/gripper_controller/gripper_cmd"
    assert groups["both_arms"]["gripper"] is None
    assert document["default_group"] == "left_arm"
