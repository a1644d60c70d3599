"""Arm and gripper of a robot that has no SRDF yet, found in the tree of its links and joints.

The arm is the longest chain of movable joints from the root. Joints at its end that look like fingers are the
gripper: several that start at one link, or one with a finger's name. Its open and closed position are found by the room
between its fingers at the ends of their range.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planners.assistant.pairs import SelfContacts
from planners.errors import AssistantError
from robot.description.model import Joint
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

    def driven(self, joints: Sequence[Joint]) -> list[Joint]:
        """Return the joints with a position of their own."""
        return [joint for joint in joints if joint.movable]

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
    """Find arm and gripper, from ``base`` or else the root to ``tip`` or else the frame of goals that is found.

    Links in ``shaped`` have a collision shape. AssistantError: a link is unknown, or there is no arm.
    """
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
    arm = tree.driven(tree.chain(start, tip))
    if len(arm) < MIN_ARM_JOINTS:
        raise AssistantError(
            f"the chain from {start!r} to {tip!r} has {len(arm)} movable joints, an arm has at least {MIN_ARM_JOINTS};"
            " name the arm's last link by --tip"
        )
    in_arm = {joint.name for joint in arm}
    movable = tree.driven(list(tree.joints.values()))
    behind = [joint for link in tree.links_below(hand) for joint in movable if joint.parent == link]
    behind = [joint for joint in behind if joint.name not in in_arm]
    gripper = tuple(joint.name for joint in behind)
    held = [joint.name for joint in movable if joint.name not in {*in_arm, *gripper}]
    return Structure(start, tip, hand, tuple(joint.name for joint in arm), gripper, tuple(held))


def _find_hand(tree: Tree, start: str) -> str:
    """Return the link at the end of the longest chain, fingers left out."""
    chains = [tree.chain(start, link) for link in tree.links_below(start) if tree.leaf(link)]
    longest = max(chains, key=lambda chain: (len(tree.driven(chain)), len(chain)))
    movable = [joint for joint in longest if joint.moves]
    if not movable:
        return start
    for joint in movable:
        if _carries_fingers(tree, joint):
            return joint.parent
    return movable[-1].child


def _carries_fingers(tree: Tree, joint: Joint) -> bool:
    """Tell whether a joint is the first one of a finger."""
    longest = max(
        sum(each.moves for each in tree.chain(joint.parent, link))
        for link in tree.links_below(joint.child)
        if tree.leaf(link)
    )
    if longest > MAX_FINGER_JOINTS:
        return False
    siblings = [
        each
        for link in tree.fixed_below(joint.parent)
        for each in tree.joints.values()
        if each.parent == link and each.moves
    ]
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
    """Find the open and the closed end of each finger's range.

    ``joints`` are the gripper's joints with a position of their own, ``points_m`` points on the surface of each link,
    shape (n, 3) in its frame [m], and ``home`` has the position of every joint, shape (n,) [rad or m].
    """
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
    points: Vector = points_m[link] @ at.rotation.T + at.translation
    return points
