"""Narrow passages around four arms, drawn by seed: shelves, cages, boxes and tables; and other planners beside ours.

They are of the seven kinds of Chamzas et al., "MotionBenchMaker: A tool to generate and benchmark motion planning
datasets", 2022, in proportion to the arm. Motions are judged by the meshes of the URDF; the SO-101's are part of the
reference data beside the checkout. ``python -m benchmarks.planning_passages SEED PROBLEMS`` draws others, or more.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, replace
from functools import partial
from itertools import combinations, count, islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from benchmarks.planning_peer import PEERS, PERIOD_S
from benchmarks.published_arms import ARMS
from harness.figures import percentiles, print_table
from harness.server import REFERENCE
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import link_name, placement, plain_urdf, solid
from planners.goals import JointGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from planners.scene import Box, Cylinder, Pose, Scene, SceneObject, Shape
from robot.description import model, robot_folder
from robot.description.meshes import with_mesh_paths
from robot.description.model import RobotModel
from robot.description.urdf import JointLimits
from robot.trajectory import Vector

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
END = 1e-3  # a motion may begin and end so far from start and goal [rad or m]

GROUPS = {"fetch": "arm_with_torso"}  # others have their default group
PEER_FILE = Path(__file__).with_name("planning_peer.py")
PEER_S = 60.0  # for each problem of a peer, which has 20 s for it, and for its start

Furniture = list[tuple[Shape, Pose]]


def board(size: Sequence[float], at: Sequence[float]) -> tuple[Shape, Pose]:
    """Return a box of a size by the reach, its middle in the frame of the furniture."""
    return Box((size[0], size[1], size[2])), Pose((at[0], at[1], at[2]))


def bookshelf(reach_m: float, width: float, height: float) -> Furniture:
    """Return a shelf with three layers, open to the arm, the hand in the middle one."""
    width, depth, height, thick = width * reach_m, 0.35 * reach_m, height * reach_m, BOARD * reach_m
    layers = [board((depth, width, thick), (0.0, 0.0, (k - 0.5) * height)) for k in (-1, 0, 1, 2)]
    sides = [board((depth, thick, 3.0 * height), (0.0, side * width / 2.0, 0.0)) for side in (-1.0, 1.0)]
    return [*layers, *sides, board((thick, width, 3.0 * height), (depth / 2.0, 0.0, 0.0))]


def cage(reach_m: float) -> Furniture:
    """Return a cage of bars around the hand, open on no side."""
    half, thick = 0.22 * reach_m, 0.03 * reach_m
    ends = (-half, half)
    posts = [board((thick, thick, 2.0 * half), (x, y, 0.0)) for x in ends for y in (-half, 0.0, half)]
    along = [board((2.0 * half, thick, thick), (0.0, y, z)) for y in ends for z in ends]
    across = [board((thick, 2.0 * half, thick), (x, 0.0, z)) for x in ends for z in ends]
    return [*posts, *along, *across]


def box(reach_m: float) -> Furniture:
    """Return a box without a lid around the hand."""
    half, thick = 0.22 * reach_m, BOARD * reach_m
    walls = [board((2.0 * half, thick, 1.4 * half), (0.0, side * half, -0.3 * half)) for side in (-1.0, 1.0)]
    walls += [board((thick, 2.0 * half, 1.4 * half), (side * half, 0.0, -0.3 * half)) for side in (-1.0, 1.0)]
    return [*walls, board((2.0 * half, 2.0 * half, thick), (0.0, 0.0, -half))]


def table(reach_m: float, top: float) -> Furniture:
    """Return a table whose top has a height above the hand by the reach, and cylinders around the hand."""
    boards = [board((0.6 * reach_m, 1.2 * reach_m, BOARD * reach_m), (0.0, 0.0, top * reach_m))]
    if top > 0.0:
        ends = [(x * reach_m, y * reach_m) for x in (-0.28, 0.28) for y in (-0.58, 0.58)]
        boards += [
            board((BOARD * reach_m, BOARD * reach_m, 0.5 * reach_m), (*end, (top - 0.25) * reach_m)) for end in ends
        ]
    can = Cylinder(0.04 * reach_m, 0.25 * reach_m)
    around = ((-0.2, 0.12), (-0.2, -0.12), (0.1, 0.22), (0.1, -0.22), (0.15, 0.0))
    return [*boards, *((can, Pose((x * reach_m, y * reach_m, 0.0))) for x, y in around)]


KINDS: dict[str, Callable[[float], Furniture]] = {
    "bookshelf_small": partial(bookshelf, width=0.7, height=0.36),
    "bookshelf_tall": partial(bookshelf, width=0.5, height=0.5),
    "bookshelf_thin": partial(bookshelf, width=0.7, height=0.26),
    "box": box,
    "cage": cage,
    "table_pick": partial(table, top=-0.15),
    "table_under_pick": partial(table, top=0.15),
}


class Passage(NamedTuple):
    """A problem among furniture."""

    name: str
    furniture: Furniture  # in the frame of its pose
    pose: Pose
    problem: PlanningProblem

    @property
    def scene(self) -> Scene:
        """The furniture as an object."""
        return Scene(next(_VERSIONS), (SceneObject("furniture", tuple(self.furniture), self.pose),))


_VERSIONS = count(1)


class Answer(NamedTuple):
    """Answer of a planner to a problem."""

    cpu_s: float
    positions: Vector | None  # of the motion, shape (m, n) [rad], or None
    duration_s: float = 0.0
    code: str = "no motion"


class Judge:
    """Contacts by pinocchio alone: the meshes of a URDF as they are, not their hulls."""

    def __init__(self, robot: RobotModel) -> None:
        urdf = with_mesh_paths(plain_urdf(robot), robot.mesh_directory, robot.package_directories)
        self._model = pin.buildModelFromXML(urdf)
        self._bare = pin.buildGeomFromUrdfString(self._model, urdf, pin.GeometryType.COLLISION)
        self._robot = robot
        self._data = self._model.createData()
        self._names = [str(name) for name in self._model.names]

    def set_scene(self, furniture: Furniture, pose: Pose) -> None:
        """Put furniture around the arm."""
        geometry = self._bare.copy()
        links = [link_name(self._model, shape) for shape in geometry.geometryObjects]
        moving = [shape.parentJoint for shape in geometry.geometryObjects]
        for i, j in combinations(range(len(links)), 2):
            if moving[i] != moving[j] and frozenset((links[i], links[j])) not in _unchecked(self._robot):
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

    def valid(self, passage: Passage, positions: Vector) -> bool:
        """Return true if a motion, shape (m, n) [rad], leads from start to goal and touches nothing."""
        start_rad, ends = dict(passage.problem.start_rad), passage.problem.goal
        assert isinstance(ends, JointGoal)
        names, goal = list(ends.positions_rad), list(ends.positions_rad.values())
        if not np.allclose(positions[[0, -1]], ([start_rad[name] for name in names], goal), atol=END):
            return False
        self.set_scene(passage.furniture, passage.pose)
        for before, after in pairwise(positions):
            steps = max(1, int(np.ceil(np.max(np.abs(after - before)) / STEP)))
            for share in np.arange(1, steps + 1) / steps:
                point = before + share * (after - before)
                if self.collides(start_rad | dict(zip(names, point.tolist(), strict=True))):
                    return False
        return True


class Draw:
    """Random problems for one arm; the same seed draws the same."""

    def __init__(self, name: str, robot: RobotModel, seed: int) -> None:
        self.robot, self.meshes = robot, _with_meshes(name, robot)
        self.judge = None if self.meshes is None else Judge(self.meshes)
        self.group = robot.groups[GROUPS.get(name, robot.default_group)]
        self._collision = CollisionModel(robot)
        self._forward = ForwardKinematics(robot, self._collision.joint_names)
        self._rng = np.random.default_rng(seed)
        tips_m = [np.linalg.norm(self._tip(self._state()).translation) for _ in range(STATES)]
        self._reach_m = float(np.quantile(tips_m, REACH_SHARE))

    def passages(self, kind: str) -> Iterator[Passage]:
        """Yield problems with a start outside a piece of furniture and a goal in it, without an end."""
        furniture, number = KINDS[kind](self._reach_m), count()
        while True:
            goal = self._state()
            tip = self._tip(goal)
            x, y, z = tip.translation.tolist()
            turned = pin.SE3(pin.exp3(np.array([0.0, 0.0, float(np.arctan2(y, x))])), tip.translation)
            # The furniture stands before the arm, and is reached into from its side.
            if not 0.5 < np.hypot(x, y) / self._reach_m < 0.95 or z < 0.0:
                continue
            *_, qz, qw = pin.SE3ToXYZQUAT(turned).tolist()
            ends = JointGoal({name: self._named(goal)[name] for name in self.group.joints})
            problem = PlanningProblem(self.group.name, {}, ends, allowed_time_s=ALLOWED_TIME_S)
            passage = Passage("", furniture, Pose((x, y, z), (0.0, 0.0, qz, qw)), problem)
            self._collision.set_scene(passage.scene)
            if self.judge is not None:
                self.judge.set_scene(furniture, passage.pose)
            if not self._free(goal):
                continue
            starts = (self._state() for _ in range(TRIES))
            start = next((q for q in starts if self._outside(q, tip) and self._free(q)), None)
            if start is not None:
                problem = replace(problem, start_rad=self._named(start))
                yield passage._replace(name=f"{kind} {next(number)}", problem=problem)

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
    """Plan the problems of a seed for each arm by each planner."""
    header = [
        "planner",
        "problems",
        "solved in 5 s",
        "valid by the meshes",
        "CPU p50 / p95 / p99 [ms]",
        "duration p50 [s]",
    ]
    for name, read in (ARMS | {"fetch": lambda: robot_folder.resolve("fetch").model}).items():
        draw = Draw(name, read(), seed)
        passages = [each for kind in KINDS for each in islice(draw.passages(kind), problems)]
        planners: dict[str, list[Answer]] = {"armbridge": list(_ours(draw.robot, passages))}
        if draw.meshes is not None:
            planners |= {peer: _theirs(peer, draw.meshes, draw.group.joints, passages) for peer in PEERS}
        planners = {planner: answers for planner, answers in planners.items() if answers}
        rows = [[planner, *_cells(draw.judge, passages, answers)] for planner, answers in planners.items()]
        print_table(f"Narrow passages of {name}, seed {seed}", header, rows)
        for i, passage in enumerate(passages):
            if planners["armbridge"][i].positions is None:
                solvers = [planner for planner, answers in planners.items() if answers[i].positions is not None]
                others = f"solved by {', '.join(solvers)}" if solvers else "solved by no planner"
                print(f"{passage.name}: {planners['armbridge'][i].code}; {others}")


def _unchecked(robot: RobotModel) -> frozenset[frozenset[str]]:
    return robot.disabled_pairs | {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}


def _with_meshes(name: str, robot: RobotModel) -> RobotModel | None:
    """Return an arm with its own limits and the shapes of its URDF, None if these are not there."""
    if not robot.hulls:
        return robot
    folder = REFERENCE / name
    urdf = next(folder.glob("*.urdf"), None)
    if urdf is None:
        return None
    limits = {
        joint.name: JointLimits(joint.lower, joint.upper, joint.max_velocity, joint.max_acceleration)
        for joint in robot.movable_joints
    }
    return model.parse(urdf.read_text(), robot.srdf, mesh_directory=folder, limits=limits)


def _ours(robot: RobotModel, passages: Sequence[Passage]) -> Iterator[Answer]:
    planner = Planner(robot, time.process_time)
    planner.warm_up()
    for passage in passages:
        planner.set_scene(passage.scene)
        started_s = time.process_time()
        plan = planner.plan(passage.problem)
        cpu_s = time.process_time() - started_s
        if isinstance(plan, Plan):
            yield Answer(cpu_s, plan.trajectory.positions_rad, plan.trajectory.duration_s)
        else:
            yield Answer(cpu_s, None, code=f"{plan.code.name} ({plan.message})")


def _theirs(peer: str, robot: RobotModel, joints: Sequence[str], passages: Sequence[Passage]) -> list[Answer]:
    """Let another planner answer in its own interpreter; nothing if it is not installed."""
    python = Path(__file__).parents[1] / "build" / peer.split(",")[0].lower() / "bin" / "python"
    if not python.exists():
        print(f"{peer} is not measured: make bench-planning installs it")
        return []
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder, "problems.json"), Path(folder, "answers.json")
        files[0].write_text(json.dumps({"arm": _arm(robot, joints), "problems": [_fields(each) for each in passages]}))
        command = [str(python), str(PEER_FILE), peer, *map(str, files)]
        try:
            subprocess.run(command, capture_output=True, text=True, check=True, timeout=PEER_S * len(passages))
        except subprocess.TimeoutExpired as error:
            print(f"{peer} took longer than {error.timeout:g} s")
            return []
        except subprocess.CalledProcessError as error:
            print(f"{peer}: {error.stderr.strip().splitlines()[-1]}")
            return []
        answers = json.loads(files[1].read_text())
    return [
        Answer(cpu_s, np.array(positions), PERIOD_S * (len(positions) - 1)) if positions else Answer(cpu_s, None)
        for cpu_s, positions in answers
    ]


def _arm(robot: RobotModel, joints: Sequence[str]) -> dict[str, Any]:
    """Describe an arm to a peer: joints outside the group stand still at 0."""
    root = ET.fromstring(with_mesh_paths(plain_urdf(robot), robot.mesh_directory, robot.package_directories))
    for element in root.iterfind("joint"):
        if element.get("name") not in joints:
            element.set("type", "fixed")
    urdf = ET.tostring(root, encoding="unicode")
    bare = pin.buildModelFromXML(urdf)
    shapes = pin.buildGeomFromUrdfString(bare, urdf, pin.GeometryType.COLLISION).geometryObjects
    srdf = ET.Element("robot", name=str(root.get("name")))
    group = ET.SubElement(srdf, "group", name="arm")
    for name in joints:
        ET.SubElement(group, "joint", name=name)
    moving = {link_name(bare, shape): shape.parentJoint for shape in shapes}
    for first, second in combinations(moving, 2):
        if moving[first] == moving[second] or frozenset((first, second)) in _unchecked(robot):
            ET.SubElement(srdf, "disable_collisions", link1=first, link2=second, reason="Never")
    return {
        "urdf": urdf,
        "srdf": ET.tostring(srdf, encoding="unicode"),
        "tip": robot.tip_link,
        "joints": list(joints),
        "velocity": [robot.joints[name].max_velocity for name in joints],
        "acceleration": [robot.joints[name].max_acceleration for name in joints],
        "standing": [link for link, joint in moving.items() if joint == 0],
    }


def _fields(passage: Passage) -> dict[str, Any]:
    ends = passage.problem.goal
    assert isinstance(ends, JointGoal)
    return {
        "start": [passage.problem.start_rad[name] for name in ends.positions_rad],
        "goal": list(ends.positions_rad.values()),
        "seed": passage.problem.seed,
        "things": [
            {
                "size": np.hstack(astuple(shape)).tolist(),
                "placement": (placement(passage.pose) * placement(at)).homogeneous.tolist(),
            }
            for shape, at in passage.furniture
        ],
    }


def _cells(judge: Judge | None, passages: Sequence[Passage], answers: Sequence[Answer]) -> list[str]:
    found = [
        (passage, answer.positions, answer.duration_s)
        for passage, answer in zip(passages, answers, strict=True)
        if answer.positions is not None and answer.cpu_s <= ALLOWED_TIME_S
    ]
    valid = "-" if judge is None else str(sum(judge.valid(passage, positions) for passage, positions, _ in found))
    cpu = percentiles((answer.cpu_s for answer in answers), 50, 95, 99, digits=0)
    duration = percentiles((duration_s for *_, duration_s in found), 50, scale=1.0)
    return [str(len(answers)), str(len(found)), valid, " / ".join(cpu), *duration]


if __name__ == "__main__":
    run(*map(int, sys.argv[1:3]))
