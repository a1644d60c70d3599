"""The records of answered goals, as the services of the goal history tell them."""

import itertools
import json
from typing import Any

import numpy as np
import pytest

from planners.goals import JointGoal
from planners.problem import MoveItErrorCode, PlanningProblem
from planners.scene import EMPTY_SCENE, Scene
from robot.trajectory import Trajectory
from server.execution.goal import Answer, Goal, GoalRequest
from server.execution.motions import Performed, PlannedMotion
from server.graph.permissions import Node
from server.moveit.goals.goal_history import GoalHistory
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import ServiceRig

HISTORY, RECORD = "/armbridge/goal_history", "/armbridge/goal_record"
NAMED = {"data": "ready"}

STILL = np.zeros((2, 1))
MOTION = Trajectory(("shoulder_pan",), np.array([0.0, 2.5]), np.array([[0.0], [0.4]]), STILL, STILL)


class Records(ServiceRig):
    """A history, and a client of its services."""

    def __init__(self) -> None:
        super().__init__()
        stamps = itertools.count(1000)
        self.history = GoalHistory(self.graph, self.context, lambda: float(next(stamps)))

    async def record(self, goal_id: str) -> Any:
        return await self.call(RECORD, goal_id=goal_id)


@pytest.fixture
def records() -> Records:
    return Records()


def goal(goal_id: str, *steps: float, only_for: Node | None = None) -> Goal:
    """A goal that moves the base joint to one position after the other [rad]."""
    made = [(lambda start, to=to: PlanningProblem("arm", start, JointGoal({"shoulder_pan": to}))) for to in steps]
    request = PlannedMotion(tuple(made), frozenset({"shoulder_pan"})) if steps else None
    return Goal(goal_id, GoalRequest("/moveit_goal_named", request, NAMED, only_for=only_for))


def answer(
    *planned: Trajectory,
    code: MoveItErrorCode = MoveItErrorCode.SUCCESS,
    text: str = "the arm is there",
    to_rad: float = 0.4,
    scene: Scene = EMPTY_SCENE,
) -> Answer:
    problem = PlanningProblem("arm", HOME, JointGoal({"shoulder_pan": to_rad}))
    found = Performed(HOME, planned, planning_time_s=0.012, methods=("rrt",), scene=scene, problem=problem)
    return Answer(code, text, performed=found)


def take(records: Records, goal_id: str, *steps: float, ends: Answer | None = None, **options: Any) -> None:
    records.history.on_answer(goal(goal_id, *steps, **options), ends or answer(MOTION))


async def test_the_history_tells_the_last_100_goals_but_those_of_their_client_alone(records: Records) -> None:
    take(records, "1", 0.4, only_for=Node("client"))
    assert (await records.call(HISTORY))["goals"] == []
    for number in range(103):
        take(records, str(number), 0.4)
    told = await records.call(HISTORY)
    assert [status["hardware_id"] for status in told["goals"]] == [str(number) for number in range(3, 103)]
    assert told["stamps"] == [1000.0 + number for number in range(3, 103)]
    assert not (await records.record("2"))["success"]
    assert (await records.record("3"))["success"]


async def test_a_record_tells_what_was_asked_and_found(records: Records) -> None:
    moved = goal("7", 0.4)
    records.history.on_answer(moved, answer(MOTION))
    told = await records.record("7")
    assert told["success"]
    assert json.loads(told["asked"]) == NAMED
    assert (told["duration_s"], told["planning_time_s"]) == (2.5, 0.012)
    assert told["summary"] == "a motion of 2.5 s (rrt; planned in 12 ms)"
    assert [part["joint_trajectory"]["joint_names"] for part in told["planned"]] == [["shoulder_pan"]]


async def test_a_record_has_the_problem_that_failed_and_none_of_a_goal_that_was_refused(records: Records) -> None:
    failed = answer(MOTION, code=MoveItErrorCode.NO_IK_SOLUTION, text="out of reach", to_rad=0.9)
    take(records, "1", 0.4, 0.9, ends=failed)
    told = await records.record("1")
    assert told["problem_name"] == "goal-1-NO_IK_SOLUTION.json"
    (problem,) = json.loads(told["problem"])["goal_problems"]
    assert problem["goal"]["joints"]["positions_rad"] == {"shoulder_pan": 0.9}
    take(records, "2", ends=Answer(MoveItErrorCode.FAILURE, "there is no pose 'x'"))
    told = await records.record("2")
    assert (told["success"], told["problem"], told["planned"]) == (True, "", [])
    assert told["message"].startswith("no problem file: the goal was refused before planning")


async def test_goals_of_the_last_ten_scenes_alone_have_a_problem_file(records: Records) -> None:
    for number in range(11):
        take(records, str(number), 0.4, ends=answer(MOTION, scene=Scene()))
    forgotten, kept = await records.record("0"), await records.record("1")
    assert forgotten["message"] == "no problem file: the scene has changed more than 10 times since"
    assert forgotten["planned"]
    assert kept["problem"]
