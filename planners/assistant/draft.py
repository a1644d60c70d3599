"""Draft of an SRDF and of a robot.toml, with comments for someone who sees such files for the first time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from planners.assistant.pairs import UncheckedPair
from planners.assistant.structure import GripperDraft, Structure
from robot.description.model import RobotModel

ARM, GRIPPER = "arm", "gripper"

# Above it a velocity limit is a placeholder of a CAD exporter: three times what fast servos reach [rad/s].
PLACEHOLDER_RAD_S = 20.0


@dataclass(frozen=True)
class Draft:
    """Description of an arm for a robot folder."""

    robot: RobotModel  # the robot with joints and links; its SRDF does not count
    structure: Structure
    gripper: GripperDraft | None  # None without one
    home: Mapping[str, float]  # joint -> position of the named state home [rad or m]
    unchecked: Sequence[UncheckedPair]  # pairs of links that are not checked
    samples: int  # states that these were found in


def srdf(draft: Draft) -> str:
    """Return the text of the SRDF."""
    structure = draft.structure
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<!-- Draft by armbridge robot import. Groups are joints that are planned for together; a group_state is a",
        "     pose with a name, for /moveit_goal_named; disable_collisions are pairs of links that need no check. -->",
        f"<robot name={quoteattr(draft.robot.name)}>",
        f"  <group name={quoteattr(ARM)}>",
        f"    <chain base_link={quoteattr(structure.base_link)} tip_link={quoteattr(structure.tip_link)}/>",
        "  </group>",
    ]
    if structure.gripper_joints:
        lines.append(f"  <group name={quoteattr(GRIPPER)}>")
        lines += [f"    <joint name={quoteattr(name)}/>" for name in structure.gripper_joints]
        lines += [
            "  </group>",
            f"  <end_effector name={quoteattr(GRIPPER)} parent_link={quoteattr(structure.hand_link)}"
            f" group={quoteattr(GRIPPER)} parent_group={quoteattr(ARM)}/>",
        ]
    lines += _state("home", ARM, {name: draft.home[name] for name in structure.arm_joints})
    if draft.gripper is not None:
        for name, positions in (("open", draft.gripper.opened), ("closed", draft.gripper.closed)):
            lines += _state(name, GRIPPER, dict(zip(draft.gripper.joints, positions, strict=True)))
    lines.append(f"  <!-- Never and Always: in {draft.samples} states drawn at random, by the convex parts. -->")
    lines += [
        f"  <disable_collisions link1={quoteattr(pair.first)} link2={quoteattr(pair.second)}"
        f" reason={quoteattr(pair.reason)}/>"
        for pair in draft.unchecked
    ]
    return "\n".join([*lines, "</robot>", ""])


def _state(name: str, group: str, positions: Mapping[str, float]) -> list[str]:
    joints = [f'    <joint name={quoteattr(joint)} value="{_number(value)!r}"/>' for joint, value in positions.items()]
    return [f"  <group_state name={quoteattr(name)} group={quoteattr(group)}>", *joints, "  </group_state>"]


def robot_toml(draft: Draft, urdf: str, srdf_name: str, shapes: Mapping[str, str]) -> str:
    """Return the text of robot.toml; ``shapes`` has keys and file names of hulls and parts, and may be empty."""
    robot, structure = draft.robot, draft.structure
    lines = [
        "# Draft by armbridge robot import. Go through the lines with CHECK, then: armbridge robot check FOLDER",
        "# Lengths in metres, angles in radians, velocities per second. A line that starts with # is a comment.",
        "",
        "[robot]",
        f"title = {_text(robot.name)}",
        f"urdf = {_text(urdf)}",
        f"srdf = {_text(srdf_name)}",
        *(f"{key} = {_text(name)}" for key, name in shapes.items()),
        "",
        "[planning]",
        f"group = {_text(ARM)}",
        "# CHECK: pose goals move this link to the pose. It should be the point that grasps or touches.",
        f"tip = {_text(structure.tip_link)}",
        *_gripper_lines(draft),
        "",
        "# Limits of the joints' motion. CHECK: these are the URDF's, which in many URDFs are placeholders. The arm",
        "# moves no faster than this; start low. URDFs have no accelerations: these reach full speed in 0.4 s.",
    ]
    named = (*structure.arm_joints, *structure.gripper_joints)
    for name in named:
        joint = robot.joints[name]
        note = "  # CHECK: this looks like a placeholder" if joint.max_velocity > PLACEHOLDER_RAD_S else ""
        lines += [
            f"[joints.{_text(name)}]",
            f"max_velocity = {_number(joint.max_velocity)}{note}",
            f"max_acceleration = {_number(joint.max_acceleration)}",
            "",
        ]
    if structure.held_joints:
        lines += [
            "# Joints of neither arm nor gripper: they are not driven and stay at these positions. CHECK: they must be",
            "# where the real ones are.",
            "[held_joints]",
            *(f"{_text(name)} = {_number(draft.home[name])}" for name in structure.held_joints),
            "",
        ]
    lines += _hardware_lines(named)
    return "\n".join(lines)


def _gripper_lines(draft: Draft) -> list[str]:
    gripper = draft.gripper
    if gripper is None:
        return ["", "# No gripper was found: no joint moves behind the tip's link."]
    if not gripper.as_one:
        return [
            "",
            f"# The gripper has the joints {', '.join(gripper.joints)}, which one number does not open and close:",
            "# its named states open and closed are in the SRDF, and there is no [gripper].",
        ]
    unsure = "" if gripper.certain else " The shapes do not tell which is which."
    return [
        "",
        "[gripper]",
        f"joints = {json.dumps(gripper.joints)}",
        f"# CHECK: position of each joint when the gripper is open and when it is closed.{unsure}",
        f"open = {_number(gripper.opened[0])}",
        f"closed = {_number(gripper.closed[0])}",
    ]


def _hardware_lines(joints: Sequence[str]) -> list[str]:
    first = joints[0]
    return [
        "[hardware]",
        '# A simulated arm that follows exactly. For a real one: kind = "feetech" or "dynamixel", and a table like the',
        "# one below for each joint (docs/robots.md).",
        'kind = "ideal"',
        "",
        "# [[hardware.servos]]",
        f"# joint = {_text(first)}",
        "# id = 1",
        '# model = "sts3215"',
        "# sign = 1            # -1: the servo's ticks fall while the joint's position rises",
        '# zero = "middle"     # the joint is at 0 in the middle of its calibrated range',
        "",
    ]


def _text(value: str) -> str:
    # JSON's strings are TOML's basic strings, except surrogate pairs.
    return json.dumps(value, ensure_ascii=False)


def _number(value: float) -> float:
    """Round a number for a file: six digits, no negative zero."""
    return round(float(value), 6) + 0.0
