import math
from collections.abc import Callable
from typing import Any

import pytest

from planners.goals import JointGoal
from planners.problem import Deviation, IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject
from server.moveit.goals import goal_checks
from server.moveit.messages import composed, pose_of
from tests.helpers.fake_arm import HOME, FakeArm
from tests.helpers.moveit import FORWARD, TIP, ServiceRig, planning_of, point, translator

LATE = PlanningFailure(MoveItErrorCode.TIMED_OUT, "late")
TURNED = {**HOME, "shoulder_pan": 0.5}
FOUND_AT_HOME, FOUND = IkAnswer((HOME,), (Deviation(),)), IkAnswer((TURNED,), (Deviation(0.002),))


def goal_at(x: float, y: float, z: float, frame: str = "") -> dict[str, Any]:
    return {"header": {"frame_id": frame}, "pose": point(x, y, z)}


async def test_goals_are_answered_in_their_order(rig: ServiceRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_checks, "GOAL_TIME_S", 10.0)
    monkeypatch.setattr(goal_checks, "WAITING_S", math.inf)
    goal_checks.offer_goal_checks(rig.graph, translator(planning=rig.context))
    wall = SceneObject("wall", ((Box((0.6, 0.1, 0.6)), Pose()),), Pose((0.3, 0.3, 0.3)))
    rig.scene_state.scene = Scene(version=77, objects=(wall,))
    answer = await rig.call(
        goal_checks.SERVICE,
        poses=[goal_at(0.3, -0.1, 0.2), goal_at(0.9, 0.0, 0.2), goal_at(0.3, 0.3, 0.2), goal_at(0.3, 0.0, 0.2, "moon")],
        joints=[{"name": ["elbow_flex"], "position": [0.4]}, {"name": ["elbow_flex"], "position": [4.0]}],
    )
    results = answer["results"]
    assert [result["code"] for result in results] == [1, -31, -12, -21, 1, -16]
    assert [result["reachable"] for result in results] == [True, False, True, False, True, False]
    assert [result["free"] for result in results] == [True, False, False, False, True, False]
    assert results[1]["position_error_m"] > 0.3


async def test_too_many_goals_and_an_unknown_position_of_the_arm_are_refused(rig: ServiceRig) -> None:
    goal_checks.offer_goal_checks(rig.graph, translator(planning=rig.context))
    many = await rig.outcome(goal_checks.SERVICE, poses=[goal_at(0.3, 0.0, 0.2)] * goal_checks.MAX_GOALS, joints=[{}])
    rig.arm.lose_positions()
    lost = await rig.outcome(goal_checks.SERVICE, poses=[goal_at(0.3, 0.0, 0.2)])
    assert (many[0], lost[0]) == (False, False)
    assert f"{goal_checks.MAX_GOALS + 1} goals, the limit is {goal_checks.MAX_GOALS}" in many[1]
    assert "joint positions unknown" in lost[1]


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
        monkeypatch.setattr("server.moveit.goals.goal_checks.time.monotonic", lambda: self.now_s)
        problems = [PlanningProblem("arm", HOME, JointGoal({"elbow_flex": at / count})) for at in range(count)]
        return await goal_checks.answers_in_time(problems, self, EMPTY_SCENE)


async def test_hard_goals_and_busy_planners_take_no_longer_than_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = Slow(lambda _asked: LATE)
    assert await pool.answers(monkeypatch, 100) == [LATE] * 100
    assert len(pool.asked) == 100
    assert pool.now_s <= 100 * goal_checks.GOAL_TIME_S
    answers = await Slow(lambda _asked: FOUND_AT_HOME, busy_s=1.0).answers(monkeypatch, 100)
    assert answers[0] is FOUND_AT_HOME
    assert answers[-1] is goal_checks.NOT_CHECKED


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, math.pi])
def test_the_orientation_error_is_the_angle_to_the_goal_pose(turn_rad: float) -> None:
    tip = pose_of(FORWARD.transforms(TURNED)[TIP])
    turn = Pose(orientation=(0.0, math.sin(turn_rad / 2), 0.0, math.cos(turn_rad / 2)))
    told = goal_checks.goal_check(planning_of(FakeArm()), HOME, FOUND, TIP, composed(tip, turn))
    assert told["orientation_error_rad"] == pytest.approx(turn_rad, abs=1e-6)
