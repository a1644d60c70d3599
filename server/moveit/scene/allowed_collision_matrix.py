"""The allowed collision matrix: the pairs of links and objects that may touch."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from robot.description.model import RobotModel
from server.errors import invalid
from server.moveit.messages import Message

Pair = frozenset[str]

FIELD = "allowed_collision_matrix"

# The matrix has the square of this many entries. MoveIt names links and attached objects in it, some dozens.
MAX_NAMES = 200

# Pairs for which a scene differs from the SRDF. They go to each planner process with every change of the scene.
MAX_EXCEPTIONS = 10_000


def disabled_collisions(robot: RobotModel) -> frozenset[Pair]:
    """Return the pairs of links whose collisions are not checked: neighbours, and those that the SRDF disables."""
    return robot.disabled_pairs | {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}


@dataclass(frozen=True)
class AllowedCollisionMatrix:
    """Contents of a moveit_msgs/AllowedCollisionMatrix; pairs that it does not name follow the SRDF."""

    names: tuple[str, ...]
    allowed: frozenset[Pair]  # pairs of them that may touch; the others may not
    defaults: Mapping[str, bool]  # name -> value for its pairs with names that are not in ``names``

    @classmethod
    def of_robot(cls, robot: RobotModel) -> AllowedCollisionMatrix:
        return cls(robot.links, disabled_collisions(robot), {})

    @cached_property
    def message(self) -> dict[str, Any]:
        index = {name: i for i, name in enumerate(self.names)}
        enabled = np.zeros((len(index), len(index)), dtype=bool)
        for pair in self.allowed:
            if len(pair) == 2:
                first, second = (index[name] for name in pair)
                enabled[first, second] = enabled[second, first] = True
        return {
            "entry_names": list(self.names),
            "entry_values": [{"enabled": row} for row in enabled.tolist()],
            "default_entry_names": list(self.defaults),
            "default_entry_values": list(self.defaults.values()),
        }

    def without(self, name: str) -> AllowedCollisionMatrix:
        if name not in self.names and name not in self.defaults:
            return self
        return replace(
            self,
            names=tuple(each for each in self.names if each != name),
            allowed=frozenset(pair for pair in self.allowed if name not in pair),
            defaults={each: value for each, value in self.defaults.items() if each != name},
        )

    def exceptions(self, disabled: frozenset[Pair], known: Collection[str]) -> dict[Pair, bool]:
        """Return the pairs for which the matrix differs from the SRDF: pair -> true if it may touch."""
        named = frozenset(self.names)
        # Counted first: an entry for a default name stands for pairs with all others.
        count = len(self.allowed ^ disabled) + len(self.defaults) * len(known)
        if count > MAX_EXCEPTIONS:
            raise invalid(
                f"{FIELD} has {count} pairs, with its default entries for {len(known)} links"
                f" and objects; the limit is {MAX_EXCEPTIONS}"
            )
        exceptions = dict.fromkeys(self.allowed - disabled, True)
        exceptions |= {pair: False for pair in disabled - self.allowed if pair <= named}
        for first, default in self.defaults.items():
            for second in known:
                pair = frozenset((first, second))
                if first != second and not pair <= named:
                    # As in MoveIt: where both names have a default, both must allow it.
                    may_touch = default and self.defaults.get(second, True)
                    if may_touch != (pair in disabled):
                        exceptions[pair] = may_touch
        return exceptions


def read_allowed_collision_matrix(message: Message) -> AllowedCollisionMatrix:
    """Read a moveit_msgs/AllowedCollisionMatrix; only entries above the diagonal count, as in MoveIt."""
    names, rows = message["entry_names"], [entry["enabled"] for entry in message["entry_values"]]
    if len(names) > MAX_NAMES:
        raise invalid(f"{FIELD}.entry_names has {len(names)} entries, more than {MAX_NAMES}")
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        raise invalid(f"{FIELD}.entry_values must be {len(names)} rows of {len(names)} values, one for each name")
    if len(set(names)) != len(names) or "" in names:
        raise invalid(f"{FIELD}.entry_names has a name twice or an empty one")
    defaults = message["default_entry_names"], message["default_entry_values"]
    if len(defaults[0]) != len(defaults[1]) or len(defaults[0]) > MAX_NAMES:
        raise invalid(f"{FIELD}: {len(defaults[0])} default_entry_names, {len(defaults[1])} default_entry_values")
    pairs = itertools.combinations(names, 2)
    above = np.array(rows, dtype=bool).reshape(len(names), len(names))[np.triu_indices(len(names), 1)]
    allowed = frozenset(frozenset(pair) for pair in itertools.compress(pairs, above.tolist()))
    return AllowedCollisionMatrix(tuple(names), allowed, dict(zip(*defaults, strict=True)))
