"""First plans, before anybody waits for them."""

from __future__ import annotations

import dataclasses
import time

import pytest

from planners import worker
from planners.pipeline import Planner
from planners.problem import CartesianPlan, CartesianProblem, Plan, PlanningProblem
from robot.description import model
from tests.helpers import robots
from tests.planners.small_arms import PALLETIZER_SRDF, PALLETIZER_URDF


class Listening(Planner):
    """A planner that keeps what it is asked and what it answers."""

    def __init__(self, robot):
        super().__init__(robot, time.process_time)
        self.asked = []

    def answer(self, request, should_stop=lambda: False):
        answer = super().answer(request, should_stop)
        self.asked.append((request, answer))
        return answer


ARMS = {
    "seven joints": (robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF),
    "mimics": (PALLETIZER_URDF, PALLETIZER_SRDF),
}


@pytest.mark.parametrize("texts", ARMS.values(), ids=ARMS)
def test_goals_and_a_path_are_planned_once(texts):
    planner = Listening(model.parse(*texts))
    planner.warm_up()
    kinds = [type(request) for request, _ in planner.asked]
    assert kinds == [PlanningProblem, PlanningProblem, CartesianProblem]
    assert isinstance(planner.asked[0][1], Plan)
    assert isinstance(planner.asked[2][1], CartesianPlan)


def test_a_group_without_a_tip_is_warmed_up_by_a_joint_goal_alone():
    robot = dataclasses.replace(model.parse(*ARMS["mimics"]), tip_link="")
    planner = Listening(robot)
    planner.warm_up()
    assert [type(request) for request, _ in planner.asked] == [PlanningProblem]


def test_a_bug_in_the_first_plans_leaves_the_planner_as_it_is(monkeypatch):
    robot = model.parse(*ARMS["mimics"])

    def fail(*_):
        raise ValueError("broken")

    monkeypatch.setattr(Planner, "answer", fail)
    assert isinstance(worker.warm_planner(robot), Planner)
