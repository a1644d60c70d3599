"""Position inverse kinematics by placo: where must the joints be for a link to be at a point?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np
import placo
from numpy.typing import NDArray

from planners.collision import CollidingPair, CollisionModel
from planners.skeleton import kinematic_urdf
from robot.model import Group, RobotModel

Vector = NDArray[np.float64]

# Weight of standing still against 1 for reaching: without it a target out of reach drives joints that barely
# move the tip into their limits, and the descent ends up to 2 cm from the nearest point.
REGULARIZATION = 1e-3

# Configurations drawn once; those nearest to a target start the restarts. Placing them takes 4 ms, once per link.
SAMPLES = 2000
SAMPLE_SEED = 7

# Of 1000 reachable targets placo solves 99 % collision-free with 10 random restarts and all with 30.
RESTARTS = 30

# Further ahead than this the arm is not nearly linear, and a target far outside would throw it into its limits.
MAX_STEP_M = 0.1

# Convergence takes 3-8 steps within reach and up to 40 at its edge.
MAX_STEPS = 60

# A descent that gains less than this in a step has arrived at its nearest point.
STAGNATION_M = 2e-6

# Reached this well the rest is below the servos' 1.5 mrad, however wide the goal's tolerance.
ACCURACY_M = 1e-4

# Solutions closer than this to a known one in every joint are the same.
DISTINCT_RAD = 0.1

# More goals than this hardly shorten the motion.
MAX_SOLUTIONS = 6


@dataclass(frozen=True)
class IkResult:
    """Answer to one inverse kinematics question.

    Attributes:
        solutions: configurations in tolerance that touch nothing, least time from the seed first.
        colliding: links that touch in the best configuration in tolerance, when every such one collides.
        nearest_q: the configuration that comes nearest to the target, free of collisions if any is.
        nearest_m: position of the link there, shape (3,) [m].
        distance_m: how far that is from the target [m].
    """

    solutions: tuple[Vector, ...]
    colliding: tuple[CollidingPair, ...]
    nearest_q: Vector
    nearest_m: Vector
    distance_m: float


class PositionSolver:
    """Position inverse kinematics of one robot.

    Args:
        robot: the arm.
        collision: its collisions; configurations ``q`` are in the order of its joints.
    """

    def __init__(self, robot: RobotModel, collision: CollisionModel) -> None:
        self._collision = collision
        # placo leaks some 0.16 MB per wrapper, so there is one for life.
        self._placo = placo.RobotWrapper("", placo.Flags.ignore_collisions, kinematic_urdf(robot))
        self._max_velocity = np.array([robot.joints[name].max_velocity for name in collision.joint_names])
        rng = np.random.default_rng(SAMPLE_SEED)
        limits = collision.lower_rad, collision.upper_rad
        self._samples = rng.uniform(*limits, (SAMPLES, len(collision.joint_names)))
        self._sample_positions: dict[str, Vector] = {}

    def solve_position(
        self,
        group: Group,
        target_m: Vector,
        link: str,
        seed_q: Vector,
        tolerance_m: float,
        should_stop: Callable[[], bool],
    ) -> IkResult:
        """Find configurations that bring a link's origin to a point, or as near as possible.

        Args:
            group: the joints that may move; the others stay as in ``seed_q``.
            target_m: shape (3,), in the root link's frame [m].
            link: the link to bring there.
            seed_q: where the robot stands; the first try starts there.
            tolerance_m: distance from the target that counts as there [m].
            should_stop: ends the restarts early.
        """
        found = _Findings(self._collision, target_m, tolerance_m)
        descend = _Descent(self._placo, self._collision, group, link, target_m)
        near = self._samples_near(group, link, target_m, seed_q)
        for start_q in chain([seed_q], islice(near, RESTARTS)):
            q = descend(start_q)
            found.add(q, self._collision.tip_position(q, link))
            if found.enough or should_stop():
                break
        if found.only_colliding:
            # Every descent ended inside the arm: the nearest point is then known to a few centimetres only.
            near = self._samples_near(group, link, target_m, seed_q)
            free = (q for q in near if not self._collision.in_collision(q))
            for q in islice(free, 1):
                found.add(q, self._collision.tip_position(q, link))
        return found.result(lambda q: self.move_time_s(seed_q, q))

    def move_time_s(self, start_q: Vector, goal_q: Vector) -> float:
        """Least time between configurations at the joints' velocity limits [s]."""
        return float(np.max(np.abs(goal_q - start_q) / self._max_velocity))

    def _samples_near(self, group: Group, link: str, target_m: Vector, seed_q: Vector) -> Iterator[Vector]:
        """Samples of the group's joints, those that bring the link nearest to the target first."""
        moving = [self._collision.joint_names.index(name) for name in group.joints]
        if link not in self._sample_positions:
            self._sample_positions[link] = self._collision.tip_positions(self._samples, link)
        distances = np.linalg.norm(self._sample_positions[link] - target_m, axis=1)
        for i in np.argsort(distances, kind="stable"):
            q = seed_q.copy()
            q[moving] = self._samples[i][moving]
            yield q


class _Descent:
    """Moves a configuration to one nearby that brings a link as near as possible to a target."""

    def __init__(
        self, robot: placo.RobotWrapper, collision: CollisionModel, group: Group, link: str, target_m: Vector
    ) -> None:
        self._robot = robot
        self._limits = collision.lower_rad, collision.upper_rad
        self._columns = np.array([robot.get_joint_offset(name) for name in collision.joint_names])
        self._link = link
        self._target_m = target_m
        self._solver = robot.make_solver()
        # Otherwise the base flies to the target.
        self._solver.mask_fbase(True)
        for name in collision.joint_names:
            if name not in group.joints:
                self._solver.mask_dof(name)
        self._solver.enable_joint_limits(True)
        self._task = self._solver.add_position_task(link, target_m)
        self._task.configure("tip", "soft", 1.0)
        self._solver.add_regularization_task(REGULARIZATION)

    def __call__(self, q: Vector) -> Vector:
        """Descend from a configuration."""
        self._robot.state.q[self._columns] = q
        missing_m = self._missing_m()
        for _ in range(MAX_STEPS):
            before_m = float(np.linalg.norm(missing_m))
            if before_m < ACCURACY_M:
                break
            self._task.target_world = self._target_m - missing_m * max(0.0, 1.0 - MAX_STEP_M / before_m)
            self._solver.solve(True)
            missing_m = self._missing_m()
            if abs(before_m - float(np.linalg.norm(missing_m))) < STAGNATION_M:
                break
        # The solver keeps limits to its own accuracy only.
        lower_rad, upper_rad = self._limits
        return np.asarray(np.clip(self._robot.state.q[self._columns], lower_rad, upper_rad), dtype=np.float64)

    def _missing_m(self) -> Vector:
        """From the link's origin to the target [m]."""
        self._robot.update_kinematics()
        return self._target_m - self._robot.get_T_world_frame(self._link)[:3, 3]


class _Findings:
    """What the restarts of one question found."""

    def __init__(self, collision: CollisionModel, target_m: Vector, tolerance_m: float) -> None:
        self._collision = collision
        self._target_m = target_m
        self._tolerance_m = tolerance_m
        self._solutions: list[Vector] = []
        self._colliding: tuple[CollidingPair, ...] = ()
        self._nearest: tuple[bool, float, Vector, Vector] | None = None

    @property
    def enough(self) -> bool:
        """Whether more restarts would hardly help."""
        return len(self._solutions) >= MAX_SOLUTIONS

    @property
    def only_colliding(self) -> bool:
        """Whether nothing free was found, neither in tolerance nor near it."""
        return self._nearest is None or self._nearest[0]

    def add(self, q: Vector, position_m: Vector) -> None:
        """Take the end of one descent."""
        if any(np.max(np.abs(q - known)) < DISTINCT_RAD for known in self._solutions):
            return
        distance_m = float(np.linalg.norm(position_m - self._target_m))
        pairs = self._collision.colliding_pairs(q)
        rank = (bool(pairs), distance_m)
        if self._nearest is None or rank < self._nearest[:2]:
            self._nearest = (*rank, q, position_m)
        if distance_m <= self._tolerance_m and pairs:
            self._colliding = self._colliding or tuple(pairs)
        elif distance_m <= self._tolerance_m:
            self._solutions.append(q)

    def result(self, move_time_s: Callable[[Vector], float]) -> IkResult:
        """Sum up."""
        assert self._nearest is not None  # noqa: S101 - the seed itself is always tried
        _, distance_m, q, position_m = self._nearest
        solutions = tuple(sorted(self._solutions, key=move_time_s))
        return IkResult(solutions, () if solutions else self._colliding, q, position_m, distance_m)
