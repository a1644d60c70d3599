"""Goals of every kind in scenes drawn at random: solved, valid, CPU time; and the first answers of a planner.

``python -m benchmarks.planning_random SEED`` draws other scenes than those of the table. Starts and goals are free, and
joined by a path, by the official meshes, which are part of the reference data beside the checkout.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.random_scenes import GRIPPER_RAD, JOINTS, TOLERANCE_M, RandomScene, Vector
from harness.figures import percentiles, print_table
from harness.server import REFERENCE
from planners.files import problem_file
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import Goal, JointGoal, PoseGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import CartesianPlan, CartesianProblem, Line, Plan, PlanningProblem, Request
from planners.scene import Pose
from robot.description.robot_folder import built_in

SEED = 1
SCENES = 6
PAIRS = 8
TIP = "gripper_frame_link"

PATH_M = 0.05  # a tip path goes as far as this, straight

# Tolerance of a pose goal about each axis [rad].
TURN_RAD = 0.05
ALLOWED_TIME_S = 1.0

FIRST_ANSWERS = 5  # processes whose first answers are measured, for each kind

KINDS = ("joint goal", "position goal", "pose goal", "path of the tip")


def run(seed: int = SEED) -> None:
    """Measure the scenes of a seed and print the tables."""
    if not REFERENCE.is_dir():
        print("random scenes are not measured: there is no reference data beside the checkout")
        return
    rows: dict[str, list[tuple[bool, list[str], float]]] = defaultdict(list)
    for number in range(SCENES):
        for kind, answered in _measured(RandomScene(seed, number)):
            rows[kind].append(answered)
    print_table(
        f"Goals in {SCENES} random scenes, seed {seed}",
        ["goal", "problems", "solved", "valid by full meshes", "CPU p50 / p95 / p99 [ms]"],
        [_row(kind, rows[kind]) for kind in (*(f"{kind}{how}" for kind in KINDS for how in HOW),) if rows[kind]],
    )
    for kind in rows:
        for _, faults, _ in rows[kind]:
            if faults:
                print(f"{kind}: {'; '.join(faults)}")
    print_table(
        f"First answers of {FIRST_ANSWERS} new planner processes, CPU p50 [ms]",
        ["goal", "as loaded: first", "third", "as a worker is warmed up: first", "third"],
        [_first_row(kind, seed) for kind in KINDS],
    )


HOW = (", straight", ", searched")  # a motion without a search, and one with


def _measured(scene: RandomScene) -> Iterator[tuple[str, tuple[bool, list[str], float]]]:
    """Yield the kind of each problem, whether it was solved, the motion's faults, and the CPU time [s]."""
    planner = _planner(scene, warm=True)
    for start, goal in islice(scene.connected_pairs(), PAIRS):
        for kind, request in _requests(start, goal):
            started_s = time.process_time()
            answer = planner.answer(request)
            cpu_s = time.process_time() - started_s
            straight = not isinstance(answer, Plan) or answer.method == "straight line"
            faults: list[str] = []
            if isinstance(answer, Plan | CartesianPlan) and len(answer.trajectory.time_s) > 1:
                asked = {"start": start.tolist()} | ({"goal": goal.tolist()} if kind == KINDS[0] else {})
                faults = scene.judge.faults(asked, _as_json(answer))
            yield f"{kind}{HOW[0] if straight else HOW[1]}", (isinstance(answer, Plan | CartesianPlan), faults, cpu_s)


def _requests(start: Vector, goal: Vector) -> Iterator[tuple[str, Request]]:
    forward = ForwardKinematics(built_in("so101").model, [*JOINTS, "gripper"])
    start_rad = dict(zip(JOINTS, start.tolist(), strict=True)) | {"gripper": GRIPPER_RAD}
    forward.place(np.array([*goal, GRIPPER_RAD]))
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(forward.placement(TIP)).tolist()
    there = Pose((x, y, z), (qx, qy, qz, qw))
    goals: Mapping[str, Goal] = {
        KINDS[0]: JointGoal(dict(zip(JOINTS, goal.tolist(), strict=True))),
        KINDS[1]: PositionGoal(TIP, there.position_m, TOLERANCE_M),
        KINDS[2]: PoseGoal(TIP, there, TOLERANCE_M, (TURN_RAD, TURN_RAD, TURN_RAD), strict=True),
    }
    for kind, asked in goals.items():
        yield kind, PlanningProblem("arm", start_rad, asked, allowed_time_s=ALLOWED_TIME_S)
    forward.place(np.array([*start, GRIPPER_RAD]))
    from_m = forward.placement(TIP).translation.copy()
    way_m = np.array(there.position_m) - from_m
    end_m = from_m + way_m * min(1.0, PATH_M / max(float(np.linalg.norm(way_m)), 1e-9))
    end = Pose((float(end_m[0]), float(end_m[1]), float(end_m[2])))
    yield KINDS[3], CartesianProblem("arm", start_rad, TIP, (Line(end),), allowed_time_s=ALLOWED_TIME_S)


def _planner(scene: RandomScene, *, warm: bool) -> Planner:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.json"
        path.write_text(json.dumps(scene.fields))
        file = problem_file.read(path, built_in("so101").model)
    planner = Planner(file.robot, time.process_time)
    if warm:
        planner.warm_up()
    planner.set_scene(file.scene)
    return planner


def _as_json(answer: Plan | CartesianPlan) -> dict[str, Any]:
    motion = answer.trajectory
    return {
        "time_from_start": motion.time_s,
        "positions": motion.positions_rad,
        "velocities": motion.velocities_rad_s,
        "accelerations": motion.accelerations_rad_s2,
    }


def _row(kind: str, answered: list[tuple[bool, list[str], float]]) -> list[str]:
    solved = [one for one in answered if one[0]]
    valid = sum(not faults for _, faults, _ in solved)
    cpu = percentiles((cpu_s for _, _, cpu_s in answered), 50, 95, 99, digits=1)
    return [kind, str(len(answered)), str(len(solved)), f"{valid} of {len(solved)}", " / ".join(cpu)]


def _first_row(kind: str, seed: int) -> list[str]:
    cells = []
    for warm in (False, True):
        times_s = []
        for number in range(FIRST_ANSWERS):
            # A process for each: what has been loaded once stays.
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
                times_s.append(process.submit(_first_and_third, kind, seed, number, warm).result())
        cells += [percentiles((each[which] for each in times_s), 50, digits=1)[0] for which in (0, 1)]
    return [kind, *cells]


def _first_and_third(kind: str, seed: int, number: int, warm: bool) -> tuple[float, float]:
    """CPU time of the first and the third answer to a problem of a new planner [s]."""
    scene = RandomScene(seed, number)
    start, goal = next(scene.connected_pairs())
    planner = _planner(scene, warm=warm)
    request = dict(_requests(start, goal))[kind]
    times_s = []
    for _ in range(3):
        started_s = time.process_time()
        planner.answer(request)
        times_s.append(time.process_time() - started_s)
    return times_s[0], times_s[2]


if __name__ == "__main__":
    run(int(sys.argv[1]) if len(sys.argv) > 1 else SEED)
