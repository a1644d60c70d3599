"""Configurations in which a wish is met: many descents from many places, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from planners.geometry.collision import CollisionModel
from planners.geometry.forward import ForwardKinematics, Placements
from planners.ik.conditions import Condition, JointCondition
from planners.ik.constraints import Wish
from planners.ik.findings import MAX_SOLUTIONS, Findings, Found
from planners.ik.kinematics import Kinematics
from robot.description.model import Group, RobotModel

Vector = NDArray[np.float64]

# Configurations drawn once; those nearest to a target start the restarts. Placing them takes 4 ms, once per link.
SAMPLES = 2000
SAMPLE_SEED = 7

# Of 1000 reachable targets placo solves 99 % collision-free with 10 restarts and all with 30.
RESTARTS = 30

# Where all of these end in contacts more are made, from samples that touch nothing themselves.
RESTARTS_AMONG_OBSTACLES = 100


class GoalSearch:
    """Finds configurations of one robot.

    Args:
        robot: the arm.
        collision: its collisions; configurations ``q`` are in the order of its joints.
    """

    def __init__(self, robot: RobotModel, collision: CollisionModel) -> None:
        self.forward = ForwardKinematics(robot, collision.joint_names)
        self._collision = collision
        self._kinematics = Kinematics(robot, self.forward, collision.joint_names)
        self._max_velocity = np.array([robot.joints[name].max_velocity for name in collision.joint_names])
        limits = collision.lower_rad, collision.upper_rad
        self._samples = np.random.default_rng(SAMPLE_SEED).uniform(*limits, (SAMPLES, len(collision.joint_names)))
        self._placements: dict[str, Placements] = {}

    def find(
        self,
        group: Group,
        wish: Wish,
        seed_q: Vector,
        should_stop: Callable[[], bool],
        *,
        wanted: int = MAX_SOLUTIONS,
        avoid_collisions: bool = True,
    ) -> Found:
        """Find configurations in which a wish is met, or as nearly as possible.

        Args:
            group: the joints that may move; the others stay as in ``seed_q``.
            wish: what is asked.
            seed_q: where the robot stands; the first descent starts there.
            should_stop: ends the restarts early.
            wanted: so many solutions are enough.
            avoid_collisions: whether configurations in which something touches are none.
        """
        findings = Findings(self.forward, self._collision if avoid_collisions else None, wish)

        def enough() -> bool:
            return findings.enough(wanted) or should_stop()

        required = Wish(wish.required)
        findings.begin()
        self._descend(findings, group, wish, self._starts(group, wish, seed_q), enough)
        if wish.preferred and not findings.any_solution:
            # The preferences may lead all descents away from where the rest can be had.
            findings.begin()
            self._descend(findings, group, required, self._starts(group, required, seed_q), enough)
        if findings.only_touching and not should_stop():
            findings.begin(patience=RESTARTS_AMONG_OBSTACLES)
            self._descend(findings, group, required, self._free_samples_near(group, required, seed_q), enough)
        if findings.only_colliding:
            # Every descent ended in a contact: the nearest free point is then known to a few centimetres only.
            findings.add(next(self._free_samples_near(group, wish, seed_q), seed_q))
        return findings.result(lambda q: self.move_time_s(seed_q, q))

    def projection(
        self, group: Group, conditions: Sequence[Condition], start_q: Vector
    ) -> Callable[[Vector], Vector | None]:
        """What brings points of a group's joints to ones nearby where conditions hold, or gives None.

        Args:
            group: the joints that may move; points have them in this order, shape (n,) [rad].
            conditions: the conditions.
            start_q: configuration of all joints; those outside the group stay there.
        """
        descent = self._kinematics.descent(group, Wish(tuple(conditions)))
        columns = [self._collision.joint_names.index(name) for name in group.joints]

        def project(point: Vector) -> Vector | None:
            q = start_q.copy()
            q[columns] = point
            inside = descent.inside(q)
            return None if inside is None else inside[columns]

        return project

    def move_time_s(self, start_q: Vector, goal_q: Vector) -> float:
        """Least time between configurations at the joints' velocity limits [s]."""
        return float(np.max(np.abs(goal_q - start_q) / self._max_velocity))

    def _descend(
        self, findings: Findings, group: Group, wish: Wish, starts: Iterable[Vector], enough: Callable[[], bool]
    ) -> None:
        descent = self._kinematics.descent(group, wish)
        for q in starts:
            findings.add(descent(q))
            if enough():
                break

    def _starts(self, group: Group, wish: Wish, seed_q: Vector) -> Iterator[Vector]:
        """Where descents begin: where the robot stands, then the samples nearest to the wish."""
        yield seed_q
        yield from islice(self._samples_near(group, wish, seed_q), RESTARTS)

    def _free_samples_near(self, group: Group, wish: Wish, seed_q: Vector) -> Iterator[Vector]:
        """The nearest samples that touch nothing."""
        near = self._samples_near(group, wish, seed_q)
        return islice((q for q in near if not self._collision.in_collision(q)), RESTARTS_AMONG_OBSTACLES)

    def _samples_near(self, group: Group, wish: Wish, seed_q: Vector) -> Iterator[Vector]:
        """Samples of the group's joints, those that come nearest to a wish first."""
        moving = [self._collision.joint_names.index(name) for name in group.joints]
        distances_m = self._distances_m((*wish.required, *wish.preferred))
        for i in np.argsort(distances_m, kind="stable"):
            q = seed_q.copy()
            q[moving] = self._samples[i][moving]
            for condition in wish.required:
                if isinstance(condition, JointCondition) and condition.column in moving:
                    q[condition.column] = condition.position_rad
            yield q

    def _distances_m(self, conditions: Sequence[Condition]) -> Vector:
        """How far each sample is from conditions on links, turns by their arm [m]."""
        distances_m = np.zeros(SAMPLES)
        for condition in conditions:
            if isinstance(condition, JointCondition):
                continue
            if condition.link not in self._placements:
                self._placements[condition.link] = self.forward.placements(self._samples, condition.link)
            distances_m += condition.arm_m * condition.distances(self._placements[condition.link])
        return distances_m
