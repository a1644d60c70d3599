"""Pairs of links that need no collision check, found in uniformly drawn states as MoveIt's Setup Assistant does."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin

from planners.geometry.broadphase import CONTACT_M, GJK_TOLERANCE
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.parts import PartPair, Parts
from planners.geometry.shapes import enclosing
from robot.description.model import RobotModel
from robot.trajectory import Vector

BATCH = 500  # states between two looks at the pairs that are decided
REPORTS = 5  # reports of progress, at most

ADJACENT, NEVER, ALWAYS = "Adjacent", "Never", "Always"

Pair = tuple[str, str]


@dataclass(frozen=True)
class UncheckedPair:
    """Two links whose collision need not be checked, and MoveIt's word for the reason."""

    first: str
    second: str
    reason: str


class SelfContacts:
    """Contacts of a robot's links with each other, whose shapes are ``parts`` in the links' frames.

    A state has the positions of ``joint_names``, shape (n,), within ``lower`` and ``upper`` [rad or m]. ``adjacent``
    are the pairs that a joint connects, links without shape between them left out, and ``pairs`` all other pairs of
    links with shapes.
    """

    def __init__(self, robot: RobotModel, parts: Mapping[str, Parts]) -> None:
        self.joint_names = tuple(joint.name for joint in robot.movable_joints)
        self.lower = np.array([joint.lower for joint in robot.movable_joints])
        self.upper = np.array([joint.upper for joint in robot.movable_joints])
        self._forward = ForwardKinematics(robot, self.joint_names)
        self._parts = parts
        shaped = [link for link in robot.links if link in parts]
        self.adjacent = _adjacent(robot, frozenset(parts))
        self.pairs: list[Pair] = [pair for pair in combinations(shaped, 2) if frozenset(pair) not in self.adjacent]
        points = {link: each.outline() for link, each in parts.items()}
        self._middles = {link: 0.5 * (each.min(axis=0) + each.max(axis=0)) for link, each in points.items()}
        self._radii_m = {
            link: float(np.linalg.norm(each - self._middles[link], axis=1).max()) for link, each in points.items()
        }
        self._hulls = {link: enclosing(each) for link, each in points.items()}

    def touching(self, state: Vector, pairs: Collection[Pair]) -> list[Pair]:
        """Return the pairs among some that touch in a state."""
        self._forward.place(state)
        links = {link for pair in pairs for link in pair}
        at = {link: self._forward.placement(link) for link in links}
        middles = {link: at[link].act(self._middles[link]) for link in links}
        return [pair for pair in pairs if self._touch(pair, at, middles)]

    def placements(self, state: Vector) -> dict[str, pin.SE3]:
        """Return the pose of each link with shapes in the root link's frame."""
        self._forward.place(state)
        return {link: self._forward.placement(link) for link in self._parts}

    def _touch(self, pair: Pair, at: Mapping[str, pin.SE3], middles: Mapping[str, Vector]) -> bool:
        first, second = pair
        offset = middles[first] - middles[second]
        if offset @ offset > (self._radii_m[first] + self._radii_m[second] + CONTACT_M) ** 2:
            return False
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.gjk_tolerance, request.security_margin = GJK_TOLERANCE, CONTACT_M
        at_first, at_second = (coal.Transform3s(at[link].rotation, at[link].translation) for link in pair)
        if not coal.collide(self._hulls[first], at_first, self._hulls[second], at_second, request, result):
            return False
        return PartPair(self._parts[first], at[first], self._parts[second], at[second]).nearer_than(0.0)


def unchecked_pairs(
    contacts: SelfContacts, samples: int, seed: int, progress: Callable[[int], None]
) -> list[UncheckedPair]:
    """Return pairs that are adjacent, or touch in all or no drawn states; ``progress`` gets the number of states."""
    random = np.random.default_rng(seed)
    seen: dict[Pair, set[bool]] = {pair: set() for pair in contacts.pairs}
    done = 0
    while done < samples:
        # A pair that was seen both ways must be checked, whatever happens in other states.
        undecided = [pair for pair, found in seen.items() if len(found) < 2]
        for _ in range(min(BATCH, samples - done)):
            touching = set(contacts.touching(random.uniform(contacts.lower, contacts.upper), undecided))
            for pair in undecided:
                seen[pair].add(pair in touching)
        before, done = done, min(done + BATCH, samples)
        if REPORTS * before // samples < REPORTS * done // samples:
            progress(done)
    adjacent = [UncheckedPair(min(pair), max(pair), ADJACENT) for pair in contacts.adjacent]
    decided = [
        UncheckedPair(*pair, ALWAYS if True in found else NEVER) for pair, found in seen.items() if len(found) == 1
    ]
    return sorted(adjacent, key=lambda pair: (pair.first, pair.second)) + decided


def free_state(
    contacts: SelfContacts, unchecked: Sequence[UncheckedPair], states: Sequence[Vector], tries: int, seed: int
) -> tuple[Vector, bool]:
    """Return the first free state, else a drawn one near the first; false with the first if none is free."""
    excused = {frozenset((pair.first, pair.second)) for pair in unchecked}
    checked = [pair for pair in contacts.pairs if frozenset(pair) not in excused]
    for state in states:
        if not contacts.touching(state, checked):
            return state, True
    random = np.random.default_rng(seed)
    drawn = [random.uniform(contacts.lower, contacts.upper) for _ in range(tries)]
    if states:
        drawn.sort(key=lambda state: float(np.linalg.norm(state - states[0])))
    free = next((state for state in drawn if not contacts.touching(state, checked)), None)
    return ([*states, *drawn][0], False) if free is None else (free, True)


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
