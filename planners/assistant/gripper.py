"""Open and closed position of a gripper, by the room between its fingers at the ends of their range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planners.assistant.pairs import SelfContacts
from planners.assistant.structure import Tree
from robot.description.model import Joint
from robot.trajectory import Vector

# Farthest share of a finger's points from its joint: its tip, for its other end is at the palm however it stands.
TIP_SHARE = 0.3

# The room differs by more than this between open and closed [m].
CLEAR_M = 0.002


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
