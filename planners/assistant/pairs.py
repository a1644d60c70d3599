"""Pairs of links that need no collision check, found in uniformly drawn states as MoveIt's Setup Assistant does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin

from planners.geometry.contacts import CONTACT_M, GJK_TOLERANCE, Parts, nearer_than, outline
from planners.geometry.kinematics import kinematic_urdf
from robot.description.model import RobotModel
from robot.trajectory import Vector

BATCH = 500

ADJACENT, NEVER, ALWAYS = "Adjacent", "Never", "Always"


@dataclass(frozen=True)
class UncheckedPair:
    """Two links whose collision need not be checked, and MoveIt's word for the reason."""

    first: str
    second: str
    reason: str


class SelfContacts:
    """Contacts of a robot's links by their convex parts or meshes.

    Args:
        robot: its joints.
        parts: shapes of each link that has some.
        joint_names: joints of a state, each with a position of its own.
        place: puts ``joint_names``' positions into pinocchio's configuration.

    Attributes:
        adjacent: pairs that a joint connects, links without shape between them left out.
        pairs: every other pair.
    """

    def __init__(self, robot: RobotModel, parts: Mapping[str, Parts]) -> None:
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        self._parts = parts
        self._joint_of = {link: self._model.frames[self._model.getFrameId(link)].parentJoint for link in parts}
        self.joint_names = tuple(str(name) for name in list(self._model.names)[1:])
        joints = [robot.joints[name] for name in self.joint_names]
        self.lower = np.array([joint.lower for joint in joints])
        self.upper = np.array([joint.upper for joint in joints])
        self.adjacent = _adjacent(robot, frozenset(parts))
        shaped = [link for link in robot.links if link in parts]
        self.pairs = [pair for pair in combinations(shaped, 2) if frozenset(pair) not in self.adjacent]
        # Around the middle of the box around all parts of a link.
        points = {link: np.vstack([outline(shape) for shape in each.shapes]) for link, each in parts.items()}
        self._middles = {link: 0.5 * (each.min(axis=0) + each.max(axis=0)) for link, each in points.items()}
        self._radii = {
            link: float(np.linalg.norm(each - self._middles[link], axis=1).max()) for link, each in points.items()
        }
        self._hulls = {link: _hull(each) for link, each in points.items()}

    def draw(self, random: np.random.Generator) -> Vector:
        """Return a state drawn uniformly within the position limits."""
        state: Vector = random.uniform(self.lower, self.upper)
        return state

    def touching(self, state: Vector, pairs: Sequence[tuple[str, str]]) -> list[bool]:
        """Tell of each pair whether it touches in a state.

        Args:
            state: position of each joint, shape (n,) [rad or m].
            pairs: names of links.
        """
        pin.forwardKinematics(self._model, self._data, state)
        at = {link: self._data.oMi[joint] for link, joint in self._joint_of.items()}
        middles = {link: at[link].act(middle) for link, middle in self._middles.items()}
        return [self._touch(first, second, at, middles) for first, second in pairs]

    def free(self, state: Vector) -> bool:
        """Tell whether no pair touches in a state, pairs that are always or never checked aside."""
        return not any(self.touching(state, self.pairs))

    def _touch(self, first: str, second: str, at: Mapping[str, pin.SE3], middles: Mapping[str, Vector]) -> bool:
        offset = middles[first] - middles[second]
        if offset @ offset > (self._radii[first] + self._radii[second] + CONTACT_M) ** 2:
            return False
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.gjk_tolerance, request.security_margin = GJK_TOLERANCE, CONTACT_M
        places = (coal.Transform3s(at[link].rotation, at[link].translation) for link in (first, second))
        if not coal.collide(self._hulls[first], next(places), self._hulls[second], next(places), request, result):
            return False
        return nearer_than(self._parts[first], at[first], self._parts[second], at[second], 0.0)


def unchecked_pairs(
    contacts: SelfContacts, samples: int, seed: int, progress: Callable[[int], None]
) -> list[UncheckedPair]:
    """Return the pairs that are adjacent, that touch in every drawn state and that touch in none.

    Args:
        contacts: the robot's links.
        samples: states to draw.
        seed: of the draws; same seed, same pairs.
        progress: called with the number of states that are done.
    """
    random = np.random.default_rng(seed)
    seen: dict[tuple[str, str], set[bool]] = {pair: set() for pair in contacts.pairs}
    done = 0
    while done < samples:
        # A pair that was seen both ways is to be checked, whatever the other states say.
        open_pairs = [pair for pair, found in seen.items() if len(found) < 2]
        for _ in range(min(BATCH, samples - done)):
            touches = contacts.touching(contacts.draw(random), open_pairs)
            for pair, touch in zip(open_pairs, touches, strict=True):
                seen[pair].add(touch)
        done = min(done + BATCH, samples)
        progress(done)
    adjacent = [UncheckedPair(*sorted(pair), ADJACENT) for pair in contacts.adjacent]
    decided = [
        UncheckedPair(*pair, ALWAYS if True in found else NEVER) for pair, found in seen.items() if len(found) == 1
    ]
    return sorted(adjacent, key=lambda pair: (pair.first, pair.second)) + decided


def _adjacent(robot: RobotModel, shaped: frozenset[str]) -> frozenset[frozenset[str]]:
    above = {joint.child: joint.parent for joint in robot.joints.values()}
    found = set()
    for link in shaped:
        parent = above.get(link)
        while parent is not None and parent not in shaped:
            parent = above.get(parent)
        if parent is not None:
            found.add(frozenset((link, parent)))
    return frozenset(found)


def _hull(points_m: Vector) -> coal.Convex:
    from planners.geometry.shapes import enclosing

    return enclosing(points_m)
