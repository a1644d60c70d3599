from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from planners.goals import JointGoal
from planners.problem import Deviation, IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject
from protocol.registry import Registry
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph
from server.moveit import goal_checks
from server.moveit.goal_checks import GOAL_TIME_S, MAX_GOALS, NOT_ASKED, SERVICE, GoalChecks, answers_in_time
from server.moveit.goal_reports import GoalReports
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.scene_state import SceneState
from tests.helpers.goal_translator import TRANSLATOR
from tests.helpers.moveit_services import HOME, ROBOT, DirectPool

CLIENT = Node("client")
LATE = PlanningFailure(MoveItErrorCode.TIMED_OUT, "late")
FOUND = IkAnswer((HOME,), (Deviation(),))


class Desk:
    def __init__(self) -> None:
        self.graph = Graph(Registry.load())
        self.scene = SceneState(ROBOT)
        self.present_rad: dict[str, float] | None = HOME
        reports = GoalReports(ROBOT, MoveItParameters(), TRANSLATOR.tip)
        GoalChecks(self.graph, reports).open(TRANSLATOR, lambda: self.present_rad, DirectPool(), self.scene)  # type: ignore[arg-type]

    async def check(self, **request: Any) -> Response:

        answered: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
        self.graph.services.call(CLIENT, SERVICE, request, answered.set_result)
        return await answered


@pytest.fixture
async def desk() -> Desk:
    return Desk()


def point(x: float, y: float, z: float, frame: str = "") -> dict[str, Any]:
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y, "z": z}}}


async def test_poses_and_joint_goals_are_answered_in_their_order(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_checks, "GOAL_TIME_S", 1.0)
    wall = SceneObject("wall", ((Box((0.6, 0.1, 0.6)), Pose()),), Pose((0.3, 0.3, 0.3)))
    desk.scene.scene = Scene(version=77, objects=(wall,))
    answer = await desk.check(
        poses=[point(0.3, -0.1, 0.2), point(0.9, 0.0, 0.2), point(0.3, 0.3, 0.2), point(0.3, 0.0, 0.2, "moon")],
        joints=[{"name": ["elbow_flex"], "position": [0.4]}, {"name": ["elbow_flex"], "position": [4.0]}],
    )
    results = answer.values["results"]
    assert [result["code"] for result in results] == [1, -31, -12, -21, 1, -16]
    assert [(result["reachable"], result["free"]) for result in results] == [
        (True, True),
        (False, False),
        (True, False),
        (False, False),
        (True, True),
        (False, False),
    ]
    assert results[1]["position_error_m"] > 0.3


async def test_more_goals_than_allowed_are_refused_with_the_limit(desk: Desk) -> None:
    answer = await desk.check(poses=[point(0.3, 0.0, 0.2)] * MAX_GOALS, joints=[{}])
    assert not answer.ok
    assert f"{MAX_GOALS + 1} goals, the limit is {MAX_GOALS}" in answer.values


async def test_nothing_can_be_told_while_nobody_knows_where_the_arm_is(desk: Desk) -> None:
    desk.present_rad = None
    answer = await desk.check(poses=[point(0.3, 0.0, 0.2)])
    assert not answer.ok
    assert "not known" in answer.values


class Slow:
    """Planners in a time of their own, which take what they are allowed."""

    def __init__(self, answer: Callable[[IkQuestion], IkAnswer | PlanningFailure], busy_s: float = 0.0) -> None:
        self.now_s = 0.0
        self.asked: list[IkQuestion] = []
        self._answer = answer
        self._busy_s = busy_s

    async def ask(self, request: IkQuestion, _scene: Scene) -> IkAnswer | PlanningFailure:
        self.asked.append(request)
        answer = self._answer(request)
        self.now_s += self._busy_s + (request.allowed_time_s if answer is LATE else 0.001)
        return answer

    async def answers(self, monkeypatch: pytest.MonkeyPatch, count: int) -> list[IkAnswer | PlanningFailure]:
        monkeypatch.setattr("server.moveit.goal_checks.time.monotonic", lambda: self.now_s)
        problems: list[PlanningProblem | PlanningFailure] = [
            PlanningProblem("arm", HOME, JointGoal({"elbow_flex": at / count})) for at in range(count)
        ]
        return await answers_in_time(problems, self, EMPTY_SCENE)


async def test_the_time_that_easy_goals_leave_goes_to_the_hard_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    hard = 0.8
    pool = Slow(lambda asked: LATE if asked.goal.positions_rad["elbow_flex"] >= hard else FOUND)  # type: ignore[union-attr]
    await pool.answers(monkeypatch, 20)
    assert pool.now_s <= 20 * GOAL_TIME_S
    assert len(pool.asked) > 20
    assert all(asked.goal.positions_rad["elbow_flex"] >= hard for asked in pool.asked[20:])  # type: ignore[union-attr]


async def test_goals_that_are_all_hard_are_looked_at_once_within_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = Slow(lambda _asked: LATE)
    assert await pool.answers(monkeypatch, 100) == [LATE] * 100
    assert len(pool.asked) == 100
    assert pool.now_s <= 100 * GOAL_TIME_S


async def test_a_call_does_not_wait_for_ever_for_busy_planners(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = await Slow(lambda _asked: FOUND, busy_s=1.0).answers(monkeypatch, 100)
    assert answers[0] is FOUND
    assert answers[-1] is NOT_ASKED
