"""CPU time of the same joint goals as the scene grows, and of goals of arms with more joints."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from benchmarks.published_arms import UR5_GROUP, published
from harness.figures import percentiles, print_table
from harness.meshes import ball
from planners.geometry.collision import CollisionModel
from planners.goals import JointGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from planners.scene import Box, Mesh, Pose, Scene, SceneObject
from robot.description.joined import PlacedArm, joined, prefixed
from robot.description.model import RobotModel
from robot.description.robot_folder import built_in
from robot.description.srdf import Group

SEED = 3
GOALS = 40
BOXES = (1, 10, 100, 1000)
# In two meshes, each of which may have 80 000.
TRIANGLES = (1_000, 10_000, 100_000)
BOX_M = 0.02

# Boxes lie between these distances from the base's axis [m].
NEAR_M, FAR_M = 0.12, 0.45
BALL_M = 0.06
BALLS = {"ball": (0.26, 0.0, 0.2), "other_ball": (0.0, 0.26, 0.2)}
ALLOWED_TIME_S = 5.0

ALL = "all"  # group of every joint of a robot

Case = tuple[str, RobotModel, Scene]


def run() -> None:
    """Measure how planning grows and print the tables."""
    so101 = built_in("so101").model
    _print("objects", [(f"{count} boxes of 2 cm", so101, _boxes(count)) for count in BOXES])
    _print("triangles", [(f"two balls, {count} triangles", so101, _balls(count)) for count in TRIANGLES])
    pair = {name: PlacedArm(prefixed(so101, name), (0.0, y_m, 0.0)) for name, y_m in (("left", 0.2), ("right", -0.2))}
    arms: Mapping[str, RobotModel] = {
        "SO-101": so101,
        "UR5": published("ur5", UR5_GROUP),
        "Panda": published("panda"),
        "two SO-101": joined("pair", pair),
        "two SO-101 with their grippers": _as_one_group(joined("pair", pair)),
    }
    empty = Scene(1)
    _print("joints", [(f"{name}, {len(_group(robot))} joints", robot, empty) for name, robot in arms.items()])


def _print(what: str, cases: Sequence[Case]) -> None:
    rows, least = [], 0.0
    for name, robot, scene in cases:
        set_s, times_s, solved = _measured(robot, scene)
        median_s = float(np.median(times_s))
        least = least or median_s
        cells = percentiles(times_s, 50, 95, digits=1)
        rows.append([name, f"{1e3 * set_s:.1f}", f"{solved} of {len(times_s)}", *cells, f"{median_s / least:.2f}"])
    print_table(
        f"Joint goals as the number of {what} grows, CPU time [ms]",
        ["", "scene taken over", "solved", "p50", "p95", "p50, of the first row's"],
        rows,
    )


def _measured(robot: RobotModel, scene: Scene) -> tuple[float, list[float], int]:
    """CPU time to take the scene over and of each goal [s], and how many goals were reached."""
    planner = Planner(robot, time.process_time)
    planner.warm_up()
    started_s = time.process_time()
    refusal = planner.set_scene(scene)
    if refusal is not None:
        raise SystemExit(refusal.message)
    set_s = time.process_time() - started_s
    times_s, solved = [], 0
    for problem in _problems(robot, scene):
        started_s = time.process_time()
        solved += isinstance(planner.plan(problem), Plan)
        times_s.append(time.process_time() - started_s)
    return set_s, times_s, solved


def _problems(robot: RobotModel, scene: Scene) -> Iterator[PlanningProblem]:
    """Yield goals between random configurations that are free in the scene; the same ones while these are."""
    collision, rng = CollisionModel(robot), np.random.default_rng(SEED)
    collision.set_scene(scene)
    group = _group(robot)
    columns = [collision.joint_names.index(name) for name in group]
    rest = np.clip(np.zeros(len(collision.joint_names)), collision.lower_rad, collision.upper_rad)
    lower, upper = (np.clip(each, -np.pi, np.pi)[columns] for each in (collision.lower_rad, collision.upper_rad))
    found = 0
    while found < GOALS:
        q = np.tile(rest, (2, 1))
        q[:, columns] = rng.uniform(lower, upper, (2, len(group)))
        if any(collision.in_collision(each) for each in q):
            continue
        found += 1
        start_rad = dict(zip(collision.joint_names, q[0].tolist(), strict=True))
        goal = JointGoal(dict(zip(group, q[1][columns].tolist(), strict=True)))
        yield PlanningProblem(_group_name(robot), start_rad, goal, allowed_time_s=ALLOWED_TIME_S)


def _as_one_group(robot: RobotModel) -> RobotModel:
    joints = tuple(joint.name for joint in robot.joints.values() if joint.movable)
    return dataclasses.replace(robot, groups={**robot.groups, ALL: Group(ALL, joints, "", "")})


def _group_name(robot: RobotModel) -> str:
    return next((name for name in (ALL, "both_arms") if name in robot.groups), robot.default_group)


def _group(robot: RobotModel) -> Sequence[str]:
    return robot.groups[_group_name(robot)].joints


def _boxes(count: int) -> Scene:
    rng = np.random.default_rng(SEED)
    objects = []
    for i in range(count):
        angle, away_m = rng.uniform(-np.pi, np.pi), rng.uniform(NEAR_M, FAR_M)
        place = (float(away_m * np.cos(angle)), float(away_m * np.sin(angle)), float(rng.uniform(-0.05, 0.6)))
        objects.append(SceneObject(f"box{i}", ((Box((BOX_M, BOX_M, BOX_M)), Pose()),), Pose(place)))
    return Scene(count + 1, tuple(objects))


def _balls(triangles: int) -> Scene:
    """Balls of about so many triangles in all around the arm."""
    around = int(np.sqrt(triangles / (2.0 * len(BALLS)))) + 1
    mesh = Mesh(*ball(BALL_M, around))
    return Scene(triangles, tuple(SceneObject(name, ((mesh, Pose()),), Pose(at_m)) for name, at_m in BALLS.items()))
