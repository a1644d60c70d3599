"""CPU time of planning for published arms beside the built-in one: goals in free space, and paths of the tip.

Panda and UR5 are those of the package example-robot-data.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin

from harness.figures import percentiles, print_table
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import AnyGoal, JointGoal, PoseGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import CartesianPlan, CartesianProblem, Line, Plan, PlanningProblem, Request
from planners.scene import Pose
from robot.description import model, robot_folder
from robot.description.model import RobotModel
from robot.description.robot_folder import find_example
from robot.trajectory import Vector

PROBLEMS = 120
SEED = 5
PATH_M = 0.08
POSITION_TOLERANCE_M = 0.002
TURN_TOLERANCE_RAD = 0.02

UR5_GROUP = '<group name="arm"><chain base_link="world" tip_link="tool0"/></group>'  # UR5's own SRDF has no group


def published(name: str, more_srdf: str = "") -> RobotModel:
    """Read an arm of example-robot-data, with elements added to its SRDF."""
    example = find_example(name)
    if example is None:
        raise SystemExit(f"there is no {name}: pip install example-robot-data")
    return model.parse(
        example.urdf.read_text(),
        example.srdf.read_text().replace("</robot>", f"{more_srdf}</robot>"),
        mesh_directory=example.urdf.parent,
        package_directories=example.packages,
    )


ARMS: dict[str, Callable[[], RobotModel]] = {
    "so101": lambda: robot_folder.resolve("so101").model,
    "panda": lambda: published("panda"),
    "ur5": lambda: published("ur5", UR5_GROUP),
}


class Draw:
    """Random requests for one arm, from free states to free states."""

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._group = robot, robot.groups[robot.default_group]
        self._collision = CollisionModel(robot)
        self._forward = ForwardKinematics(robot, self._collision.joint_names)
        self._rng = np.random.default_rng(SEED)

    def requests(self) -> Iterator[tuple[str, Request]]:
        """Yield by turns a joint goal, a goal of the tip and a path of the tip, with their kinds."""
        tip, group = self._robot.tip_link, self._group
        full = len(group.joints) >= 6
        for number in range(PROBLEMS):
            start, end = self._state(), self._state()
            pose = self._pose(end)
            joint_goal = JointGoal({name: self._named(end)[name] for name in group.joints})
            goals: dict[str, AnyGoal] = {"joint goal": joint_goal}
            if full:
                turns_rad = (TURN_TOLERANCE_RAD,) * 3
                goals["pose goal"] = PoseGoal(tip, pose, POSITION_TOLERANCE_M, turns_rad, strict=True)
            else:
                goals["position goal"] = PositionGoal(tip, pose.position_m, POSITION_TOLERANCE_M)
            for kind, goal in goals.items():
                yield kind, PlanningProblem(group.name, self._named(start), goal, seed=number)
            at = self._pose(start)
            way_m = self._rng.normal(size=3)
            x, y, z = (np.array(at.position_m) + PATH_M * way_m / np.linalg.norm(way_m)).tolist()
            line = Line(Pose((x, y, z), at.orientation))
            yield "path of 8 cm", CartesianProblem(group.name, self._named(start), tip, (line,), keep_orientation=full)

    def _state(self) -> Vector:
        """Return a free configuration, the joints outside the group as near to 0 as they can be."""
        lower, upper = self._collision.lower_rad, self._collision.upper_rad
        columns = [self._collision.joint_names.index(name) for name in self._group.joints]
        while True:
            q: Vector = np.clip(np.zeros(len(lower)), lower, upper)
            q[columns] = self._rng.uniform(lower, upper)[columns]
            if not self._collision.in_collision(q):
                return q

    def _named(self, q: Vector) -> dict[str, float]:
        return dict(zip(self._collision.joint_names, q.tolist(), strict=True))

    def _pose(self, q: Vector) -> Pose:
        self._forward.place(q)
        placement = self._forward.placement(self._robot.tip_link)
        x, y, z, *turn = pin.SE3ToXYZQUAT(placement).tolist()
        return Pose((x, y, z), (turn[0], turn[1], turn[2], turn[3]))


def run() -> None:
    """Plan the same kinds of requests for each arm, and compare them with the first one's."""
    times_s: dict[tuple[str, str], list[float]] = defaultdict(list)
    loads = []
    for name, read in ARMS.items():
        started_s = time.process_time()
        robot = read()
        planner = Planner(robot, time.process_time)
        loaded_s = time.process_time()
        planner.warm_up()
        loads.append([name, f"{loaded_s - started_s:.2f}", f"{time.process_time() - loaded_s:.2f}"])
        for kind, request in Draw(robot).requests():
            started_s = time.process_time()
            answer = planner.answer(request)
            spent_s = time.process_time() - started_s
            whole = isinstance(answer, Plan) or (isinstance(answer, CartesianPlan) and answer.fraction == 1.0)
            times_s[name, kind if whole else f"{kind}, refused or part"].append(spent_s)
    reference_s = {
        kind: float(np.median(values)) for (name, kind), values in times_s.items() if name == next(iter(ARMS))
    }
    reference_s["pose goal"] = reference_s["position goal"]
    print_table("Loading, CPU time [s]", ["arm", "description and planner", "first plans"], loads)
    print_table(
        "Planning, CPU time [ms]",
        ["arm", "request", "problems", "p50", "p95", "max", "p50 of so101's"],
        [
            [name, kind, str(len(values)), *percentiles(values, 50, 95, 100), _ratio(values, reference_s.get(kind))]
            for (name, kind), values in times_s.items()
        ],
    )


def _ratio(values: list[float], reference_s: float | None) -> str:
    return "-" if reference_s is None else f"{float(np.median(values)) / reference_s:.1f}"
