"""Narrow passages around four arms, drawn by seed: shelves, cages, boxes and tables.

They are of the kinds of Chamzas et al., "MotionBenchMaker: A tool to generate and benchmark motion planning datasets",
2022, in proportion to the arm. Motions of arms without hulls of their own are judged by the shapes of their URDF.
``python -m benchmarks.planning_passages SEED PROBLEMS`` draws others, or more.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, count

import numpy as np
import pinocchio as pin

from benchmarks.published_arms import ARMS
from harness.figures import percentiles, print_table
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import link_name, placement, plain_urdf, solid
from planners.goals import JointGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from planners.scene import Box, Cylinder, Pose, Scene, SceneObject, Shape
from robot.description import robot_folder
from robot.description.meshes import with_mesh_paths
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector

SEED = 1
PROBLEMS = 8
ALLOWED_TIME_S = 5.0

# Furniture is in proportion to the arm: to the distance of the tip that one of ten free states exceeds.
REACH_SHARE = 0.9
STATES = 200

# Places that are tried for a piece of furniture around the tip, as its size [m] by the reach.
TRIES = 2000
BOARD = 0.02

STEP = 0.01  # the judge moves no joint further between two checks [rad or m]


def board(size: Sequence[float], at: Sequence[float]) -> tuple[Shape, Pose]:
    """Return a box of a size by the reach, its middle in the frame of the furniture."""
    return Box((size[0], size[1], size[2])), Pose((at[0], at[1], at[2]))


def shelf(reach_m: float) -> list[tuple[Shape, Pose]]:
    """Return a shelf with three layers, open to the arm, the hand in the middle one."""
    width, depth, height, thick = 0.7 * reach_m, 0.35 * reach_m, 0.36 * reach_m, BOARD * reach_m
    layers = [board((depth, width, thick), (0.0, 0.0, (k - 0.5) * height)) for k in (-1, 0, 1, 2)]
    sides = [board((depth, thick, 3.0 * height), (0.0, side * width / 2.0, 0.0)) for side in (-1.0, 1.0)]
    return [*layers, *sides, board((thick, width, 3.0 * height), (depth / 2.0, 0.0, 0.0))]


def cage(reach_m: float) -> list[tuple[Shape, Pose]]:
    """Return a cage of bars around the hand, open on no side."""
    half, thick = 0.22 * reach_m, 0.03 * reach_m
    ends = (-half, half)
    posts = [board((thick, thick, 2.0 * half), (x, y, 0.0)) for x in ends for y in (-half, 0.0, half)]
    along = [board((2.0 * half, thick, thick), (0.0, y, z)) for y in ends for z in ends]
    across = [board((thick, 2.0 * half, thick), (x, 0.0, z)) for x in ends for z in ends]
    return [*posts, *along, *across]


def box(reach_m: float) -> list[tuple[Shape, Pose]]:
    """Return a box without a lid around the hand."""
    half, thick = 0.22 * reach_m, BOARD * reach_m
    walls = [board((2.0 * half, thick, 1.4 * half), (0.0, side * half, -0.3 * half)) for side in (-1.0, 1.0)]
    walls += [board((thick, 2.0 * half, 1.4 * half), (side * half, 0.0, -0.3 * half)) for side in (-1.0, 1.0)]
    return [*walls, board((2.0 * half, 2.0 * half, thick), (0.0, 0.0, -half))]


def table(reach_m: float) -> list[tuple[Shape, Pose]]:
    """Return a table below the hand, and cylinders on it around the hand."""
    top = board((0.6 * reach_m, 1.2 * reach_m, BOARD * reach_m), (0.0, 0.0, -0.15 * reach_m))
    can = Cylinder(0.04 * reach_m, 0.25 * reach_m)
    around = ((-0.2, 0.12), (-0.2, -0.12), (0.1, 0.22), (0.1, -0.22), (0.15, 0.0))
    return [top, *((can, Pose((x * reach_m, y * reach_m, 0.0))) for x, y in around)]


KINDS: dict[str, Callable[[float], list[tuple[Shape, Pose]]]] = {
    "shelf": shelf,
    "cage": cage,
    "box": box,
    "table": table,
}


class Judge:
    """Contacts by pinocchio alone: the meshes of a URDF as they are, not their hulls."""

    def __init__(self, robot: RobotModel) -> None:
        urdf = with_mesh_paths(plain_urdf(robot), robot.mesh_directory, robot.package_directories)
        self._model = pin.buildModelFromXML(urdf)
        self._bare = pin.buildGeomFromUrdfString(self._model, urdf, pin.GeometryType.COLLISION)
        self._robot = robot
        self._data = self._model.createData()
        self._names = [str(name) for name in self._model.names]

    def set_scene(self, furniture: Sequence[tuple[Shape, Pose]], pose: Pose) -> None:
        """Put furniture around the arm."""
        geometry = self._bare.copy()
        links = [link_name(self._model, shape) for shape in geometry.geometryObjects]
        never = {frozenset((joint.parent, joint.child)) for joint in self._robot.joints.values()}
        never |= self._robot.disabled_pairs
        moving = [shape.parentJoint for shape in geometry.geometryObjects]
        for i, j in combinations(range(len(links)), 2):
            if moving[i] != moving[j] and frozenset((links[i], links[j])) not in never:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
        for shape, at in furniture:
            place = placement(pose) * placement(at)
            k = geometry.addGeometryObject(pin.GeometryObject("thing", 0, 0, place, solid(shape, 1.0)[0]))
            for i in np.flatnonzero(moving):
                geometry.addCollisionPair(pin.CollisionPair(int(i), k))
        self._geometry, self._geometry_data = geometry, geometry.createData()

    def collides(self, positions: dict[str, float]) -> bool:
        """Return true if anything touches; joints that are not named follow or stand at 0."""
        q = pin.neutral(self._model)
        for name, joint in self._robot.joints.items():
            value = positions.get(name)
            if joint.mimic is not None:
                value = joint.mimic.multiplier * positions.get(joint.mimic.joint, 0.0)
            if value is not None and name in self._names:
                q[self._model.joints[self._names.index(name)].idx_v] = value
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        pairs = range(len(self._geometry.collisionPairs))
        return any(pin.computeCollision(self._geometry, self._geometry_data, pair) for pair in pairs)

    def touched(self, motion: Trajectory, start_rad: dict[str, float]) -> bool:
        """Return true if anything touches on a motion."""
        for before, after in zip(motion.positions_rad[:-1], motion.positions_rad[1:], strict=True):
            steps = max(1, int(np.ceil(np.max(np.abs(after - before)) / STEP)))
            for share in np.linspace(0.0, 1.0, steps + 1):
                point = before + share * (after - before)
                if self.collides(start_rad | dict(zip(motion.joint_names, point.tolist(), strict=True))):
                    return True
        return False


class Draw:
    """Random problems for one arm; the same seed draws the same."""

    def __init__(self, robot: RobotModel, seed: int) -> None:
        # The hulls of the built-in arms stand for meshes that are not in the package.
        self.robot, self.judge = robot, None if robot.hulls else Judge(robot)
        self.group = robot.groups[robot.default_group]
        self._collision = CollisionModel(robot)
        self._forward = ForwardKinematics(robot, self._collision.joint_names)
        self._rng = np.random.default_rng(seed)
        self._versions = count(1)
        tips_m = [np.linalg.norm(self._tip(self._state()).translation) for _ in range(STATES)]
        self._reach_m = float(np.quantile(tips_m, REACH_SHARE))

    def problems(self, kind: str) -> Iterator[tuple[Scene, PlanningProblem]]:
        """Yield scenes with a start outside a piece of furniture and a goal in it, without an end."""
        furniture = KINDS[kind](self._reach_m)
        while True:
            goal = self._state()
            tip = self._tip(goal)
            x, y, z = tip.translation.tolist()
            turned = pin.SE3(pin.exp3(np.array([0.0, 0.0, float(np.arctan2(y, x))])), tip.translation)
            # The furniture stands before the arm, and is reached into from its side.
            if not 0.5 < np.hypot(x, y) / self._reach_m < 0.95 or z < 0.0:
                continue
            *_, qz, qw = pin.SE3ToXYZQUAT(turned).tolist()
            pose = Pose((x, y, z), (0.0, 0.0, qz, qw))
            scene = Scene(next(self._versions), (SceneObject("furniture", tuple(furniture), pose),))
            self._collision.set_scene(scene)
            if self.judge is not None:
                self.judge.set_scene(furniture, pose)
            if not self._free(goal):
                continue
            starts = (self._state() for _ in range(TRIES))
            start = next((q for q in starts if self._outside(q, tip) and self._free(q)), None)
            if start is not None:
                ends = JointGoal({name: self._named(goal)[name] for name in self.group.joints})
                yield scene, PlanningProblem(self.group.name, self._named(start), ends, allowed_time_s=ALLOWED_TIME_S)

    def _outside(self, q: Vector, tip: pin.SE3) -> bool:
        return bool(np.linalg.norm(self._tip(q).translation - tip.translation) > 0.5 * self._reach_m)

    def _free(self, q: Vector) -> bool:
        touches = self.judge is not None and self.judge.collides(self._named(q))
        return not touches and not self._collision.collides(q)

    def _state(self) -> Vector:
        lower, upper = self._collision.lower_rad, self._collision.upper_rad
        columns = [self._collision.joint_names.index(name) for name in self.group.joints]
        q: Vector = np.clip(np.zeros(len(lower)), lower, upper)
        q[columns] = self._rng.uniform(lower, upper)[columns]
        return q

    def _tip(self, q: Vector) -> pin.SE3:
        self._forward.place(q)
        return self._forward.placement(self.robot.tip_link).copy()

    def _named(self, q: Vector) -> dict[str, float]:
        return dict(zip(self._collision.joint_names, q.tolist(), strict=True))


def run(seed: int = SEED, problems: int = PROBLEMS) -> None:
    """Plan the problems of a seed for each arm and kind."""
    rows = []
    for name, read in (ARMS | {"fetch": lambda: robot_folder.resolve("fetch").model}).items():
        draw = Draw(read(), seed)
        planner = Planner(draw.robot, time.process_time)
        planner.warm_up()
        for kind in KINDS:
            solved, touched, times_s = 0, 0, []
            for (scene, problem), _ in zip(draw.problems(kind), range(problems), strict=False):
                planner.set_scene(scene)
                started_s = time.process_time()
                plan = planner.plan(problem)
                times_s.append(time.process_time() - started_s)
                if isinstance(plan, Plan):
                    solved += 1
                    touched += draw.judge is not None and draw.judge.touched(plan.trajectory, dict(problem.start_rad))
            cpu = " / ".join(percentiles(times_s, 50, 95, digits=0))
            rows.append([name, kind, str(problems), str(solved), str(touched) if draw.judge else "-", cpu])
    header = ["arm", "around the goal", "problems", "solved in 5 s", "touch by the meshes", "CPU p50 / p95 [ms]"]
    print_table(f"Narrow passages, seed {seed}", header, rows)


if __name__ == "__main__":
    run(*map(int, sys.argv[1:3]))
