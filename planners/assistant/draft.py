"""Draft of an SRDF and of a robot.toml, with comments for someone who sees such files for the first time."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from planners.assistant.pairs import SelfContacts, UncheckedPair
from planners.errors import AssistantError
from robot.description.model import Joint, RobotModel
from robot.trajectory import Vector

# A joint of the wrist may carry a link called gripper_link: the hand, no finger.
FINGER_JOINT = re.compile(r"^(?!.*(wrist|roll|arm_|_arm)).*(grip|finger|jaw|claw|knuckle|thumb)", re.IGNORECASE)
FINGER_LINK = re.compile(r"finger|jaw|claw|knuckle|thumb", re.IGNORECASE)
TOOL_FRAME = re.compile(r"tcp|tip|tool|grasp|gripper_frame|ee_|_ee|end_?eff|flange|pinch", re.IGNORECASE)

MAX_FINGER_JOINTS = 4  # joints of one finger: more in a chain is an arm, whatever its name

MIN_ARM_JOINTS = 2


@dataclass(frozen=True)
class Structure:
    """Planning groups for an arm's SRDF."""

    base_link: str  # first link of the arm
    tip_link: str  # last link of the arm: the frame of goals
    hand_link: str  # link of the arm that carries the gripper
    arm_joints: tuple[str, ...]  # movable joints from base to tip
    # Movable joints behind the hand, those that mimic others left out; empty without a gripper.
    gripper_joints: tuple[str, ...]
    held_joints: tuple[str, ...]  # movable joints of neither


class Tree:
    """Links, root first, and joints of a robot as a tree."""

    def __init__(self, links: Sequence[str], joints: Mapping[str, Joint]) -> None:
        self.root = links[0]
        self.joints = joints
        self._above = {joint.child: joint for joint in joints.values()}
        self._below: dict[str, list[Joint]] = {link: [] for link in links}
        for joint in joints.values():
            self._below[joint.parent].append(joint)

    def chain(self, base: str, tip: str) -> list[Joint]:
        """Return the joints from one link to another, base first; AssistantError where no chain leads there."""
        found: list[Joint] = []
        link = tip
        while link != base:
            if link not in self._above:
                raise AssistantError(f"no chain of joints leads from {base!r} to {tip!r}; give --base and --tip of one")
            found.append(self._above[link])
            link = found[-1].parent
        return found[::-1]

    def links_below(self, link: str) -> Iterator[str]:
        """Yield a link and all that it carries."""
        yield link
        for joint in self._below[link]:
            yield from self.links_below(joint.child)

    def fixed_below(self, link: str) -> Iterator[str]:
        """Yield a link and those that are fixed to it, parents first."""
        yield link
        for joint in self._below[link]:
            if not joint.moves:
                yield from self.fixed_below(joint.child)

    def leaf(self, link: str) -> bool:
        """Tell whether a link carries none."""
        return not self._below[link]


def find_structure(tree: Tree, shaped: frozenset[str], base: str | None, tip: str | None) -> Structure:
    """Find arm and gripper from ``base`` or the root to ``tip`` or the frame of goals; AssistantError: none."""
    known = list(tree.links_below(tree.root))
    for option, link in (("--base", base), ("--tip", tip)):
        if link is not None and link not in known:
            raise AssistantError(f"{option} {link}: the URDF has no such link; it has {', '.join(sorted(known))}")
    start = base or tree.root
    if tip is not None:
        hand = _hand_of(tree, start, tip)
    else:
        hand = _find_hand(tree, start)
        tip = _find_tip(tree, hand, shaped)
    arm = [joint for joint in tree.chain(start, tip) if joint.movable]
    if len(arm) < MIN_ARM_JOINTS:
        raise AssistantError(
            f"the chain from {start!r} to {tip!r} has {len(arm)} movable joints, an arm has at least {MIN_ARM_JOINTS};"
            " name the arm's last link by --tip"
        )
    in_arm = {joint.name for joint in arm}
    movable = [joint for joint in tree.joints.values() if joint.movable]
    behind = [joint for link in tree.links_below(hand) for joint in movable if joint.parent == link]
    behind = [joint for joint in behind if joint.name not in in_arm]
    gripper = tuple(joint.name for joint in behind)
    held = [joint.name for joint in movable if joint.name not in {*in_arm, *gripper}]
    return Structure(start, tip, hand, tuple(joint.name for joint in arm), gripper, tuple(held))


def _find_hand(tree: Tree, start: str) -> str:
    """Return the link at the end of the longest chain, fingers left out."""
    chains = [tree.chain(start, link) for link in tree.links_below(start) if tree.leaf(link)]
    longest = max(chains, key=lambda chain: (sum(joint.movable for joint in chain), len(chain)))
    movable = [joint for joint in longest if joint.moves]
    if not movable:
        return start
    return next((joint.parent for joint in movable if _carries_fingers(tree, joint)), movable[-1].child)


def _carries_fingers(tree: Tree, joint: Joint) -> bool:
    """Tell whether a joint is the first one of a finger."""
    chains = (tree.chain(joint.parent, link) for link in tree.links_below(joint.child) if tree.leaf(link))
    if max(sum(each.moves for each in chain) for chain in chains) > MAX_FINGER_JOINTS:
        return False
    palm = set(tree.fixed_below(joint.parent))
    siblings = [each for each in tree.joints.values() if each.moves and each.parent in palm]
    named = bool(FINGER_JOINT.search(joint.name) or FINGER_LINK.search(joint.child))
    follows = any(each.mimic is not None for each in siblings)
    return follows or named or (len(siblings) > 1 and joint.type == "prismatic")


def _hand_of(tree: Tree, start: str, tip: str) -> str:
    """Return the link of the arm that carries the gripper: the first of those that are fixed to the tip."""
    hand = tip
    for joint in reversed(tree.chain(start, tip)):
        if joint.moves:
            break
        hand = joint.parent
    return hand


def _find_tip(tree: Tree, hand: str, shaped: frozenset[str]) -> str:
    """Return the frame of goals: a named tool frame fixed to the hand, else the last link fixed to it."""
    fixed = list(tree.fixed_below(hand))
    frames = [link for link in fixed if tree.leaf(link) and link not in shaped and TOOL_FRAME.search(link)]
    if frames:
        return frames[-1]
    carriers = [link for link in fixed if any(each.moves and each.parent == link for each in tree.joints.values())]
    if carriers:
        return carriers[-1]
    leaves = [link for link in fixed if tree.leaf(link) and TOOL_FRAME.search(link)]
    return (leaves or fixed)[-1] if len(fixed) > 1 else hand


# Farthest share of a finger's points from its joint: its tip, for its other end is at the palm however it stands.
TIP_SHARE = 0.3

CLEAR_M = 0.002  # the room differs by more than this between open and closed [m]


@dataclass(frozen=True)
class GripperDraft:
    """Positions of a gripper's joints."""

    joints: tuple[str, ...]  # joints with a position of their own
    opened: tuple[float, ...]  # position of each when it is open [rad or m]
    closed: tuple[float, ...]  # position of each when it is closed [rad or m]
    certain: bool  # false where the shapes do not tell the two apart

    @property
    def as_one(self) -> bool:
        """True where one number opens and one closes every joint; there are one or two joints."""
        return len(self.joints) <= 2 and len(set(self.opened)) == len(set(self.closed)) == 1


def draft_gripper(
    joints: Sequence[Joint], hand: str, tree: Tree, points_m: Mapping[str, Vector], contacts: SelfContacts, home: Vector
) -> GripperDraft:
    """Find the open and closed end of each finger's range, from points of each link in its frame, (n, 3) [m]."""
    opened, closed, certain = [], [], True
    for joint in joints:
        finger = [link for link in tree.links_below(joint.child) if link in points_m]
        # The other fingers, and what does not move of the hand: a fixed jaw.
        others = [link for link in tree.links_below(hand) if link in points_m and link not in finger]
        rooms = []
        for position in (joint.lower, joint.upper):
            state = home.copy()
            for each in joints:
                at = each.lower if position == joint.lower else each.upper
                state[contacts.joint_names.index(each.name)] = at
            placed = contacts.placements(state)
            rooms.append(_room_m(joint, finger, others, placed, points_m))
        certain = certain and abs(rooms[1] - rooms[0]) > CLEAR_M
        ends = (joint.lower, joint.upper) if rooms[0] > rooms[1] else (joint.upper, joint.lower)
        opened.append(ends[0])
        closed.append(ends[1])
    return GripperDraft(tuple(joint.name for joint in joints), tuple(opened), tuple(closed), certain)


def _room_m(
    joint: Joint,
    finger: Sequence[str],
    others: Sequence[str],
    placed: Mapping[str, pin.SE3],
    points_m: Mapping[str, Vector],
) -> float:
    """Return the distance of a finger's tip from the other fingers or the hand [m]."""
    if not finger or not others:
        return 0.0
    own = np.vstack([_placed(link, placed, points_m) for link in finger])
    rest = np.vstack([_placed(link, placed, points_m) for link in others])
    if joint.type != "prismatic":
        base = placed[finger[0]].translation
        reach_m = np.linalg.norm(own - base, axis=1)
        own = own[reach_m >= (1.0 - TIP_SHARE) * reach_m.max()]
    return float(np.linalg.norm(own[:, np.newaxis] - rest[np.newaxis], axis=2).min(axis=1).mean())


def _placed(link: str, placed: Mapping[str, pin.SE3], points_m: Mapping[str, Vector]) -> Vector:
    at = placed[link]
    return np.asarray(points_m[link] @ at.rotation.T + at.translation)


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
