"""Verification without a process: an arm that is where it is put, and goals that end as a test says."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode
from robot.faults import Fault, FaultCode
from robot.messages import ChangePace, Mode, Pace
from server.arm.arms import ServedArm
from server.arm.commissioning import IDLE_TIMEOUT_S, Dialogue, ProcedureFailed
from server.arm.verifying import SLOWLY, FirstMotions, VerificationProcedure
from server.config import ArmSettings
from server.execution.goal import Answer, Goal, GoalRequest
from tests.helpers.fake_arm import FakeArm
from tests.helpers.robots import so101

pytestmark = pytest.mark.stepped_time


class Goals:
    """Goal queue that answers each goal at once by the next code, and the last code for ever."""

    def __init__(self, *codes: MoveItErrorCode) -> None:
        self._codes = list(codes)
        self.asked: list[Mapping[str, float]] = []
        self.scalings: set[float] = set()
        self.cancelled: list[str] = []

    def go_to(self, positions_rad: Mapping[str, float], scaling: float) -> Goal:
        self.asked.append(positions_rad)
        self.scalings.add(scaling)
        goal = Goal(str(len(self.asked)), GoalRequest("the server"))
        if self._codes:
            code = self._codes.pop(0) if len(self._codes) > 1 else self._codes[0]
            goal.answered.set_result(Answer(code, f"it ended as {code.name}"))
        return goal

    def cancel(self, number: str, _reason: str) -> None:
        self.cancelled.append(number)


class Verification:
    """A verification whose arm holds."""

    def __init__(self, goals: Goals) -> None:
        self.arm = FakeArm()
        self.arm.state = replace(self.arm.state, torque_enabled=True)
        served = ServedArm("", ArmSettings(), SimpleNamespace(calibration_file=None), self.arm.as_arm)
        self.procedure = VerificationProcedure(
            self.arm.as_arm, so101(), frozenset({"gripper"}), goals.go_to, goals.cancel, FirstMotions(served, Path())
        )
        self.dialogue = Dialogue("verify", lambda: None)
        self.task = asyncio.create_task(self.procedure.run(self.dialogue))

    async def say_move(self) -> None:
        await until(lambda: self.dialogue.step.name == "torque")
        self.dialogue.answer("torque", "move")


async def test_nothing_is_asked_of_the_arm_before_the_person_says_move_and_their_silence_ends_it() -> None:
    goals = Goals(MoveItErrorCode.SUCCESS)
    verification = Verification(goals)
    await asyncio.sleep(IDLE_TIMEOUT_S + 1.0)
    with pytest.raises(ProcedureFailed, match="nobody has answered for 15 minutes"):
        await verification.task
    assert goals.asked == []


async def test_a_pose_that_cannot_be_planned_is_replaced_by_another_one() -> None:
    goals = Goals(MoveItErrorCode.GOAL_IN_COLLISION, MoveItErrorCode.SUCCESS)
    verification = Verification(goals)
    await verification.say_move()
    await until(lambda: verification.dialogue.step.name == "measuring")
    assert len(goals.asked) == 2
    assert goals.asked[0] != goals.asked[1]
    assert goals.scalings == {SLOWLY}
    verification.task.cancel()


@pytest.mark.parametrize("code", [MoveItErrorCode.PREEMPTED, MoveItErrorCode.CONTROL_FAILED])
async def test_an_arm_that_was_stopped_is_moved_no_further(code: MoveItErrorCode) -> None:
    goals = Goals(code)
    verification = Verification(goals)
    await verification.say_move()
    with pytest.raises(ProcedureFailed, match=f"zero was not reached: it ended as {code.name}"):
        await verification.task
    assert len(goals.asked) == 1


async def test_a_fault_on_the_way_ends_it_and_its_goal() -> None:
    goals = Goals()
    verification = Verification(goals)
    await verification.say_move()
    await until(lambda: bool(goals.asked))
    fault = Fault(FaultCode.STALLED, "joint elbow_flex is stalled")
    verification.procedure.take_state(
        replace(verification.arm.state, mode=Mode.FAULT, fault=fault), verification.dialogue
    )
    with pytest.raises(ProcedureFailed, match="elbow_flex is stalled"):
        await verification.task
    verification.procedure.close()
    assert goals.cancelled == ["1"]


CAP = 0.25
Start = Callable[..., tuple[FakeArm, FirstMotions]]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Starts one server after the other of an arm with a calibration."""
    (tmp_path / "arm.json").write_text("{}")

    def start(**settings: Any) -> tuple[FakeArm, FirstMotions]:
        arm, description = FakeArm(), SimpleNamespace(calibration_file=tmp_path / "arm.json")
        served = ServedArm("", ArmSettings(**{"serial": "/dev/ttyACM0", **settings}), description, arm.as_arm)
        first_motions = FirstMotions(served, tmp_path / "verified")
        first_motions.begin()
        return arm, first_motions

    return start


@pytest.mark.parametrize(("limit", "after"), [(CAP, [0.8]), (0.1, [])])
def test_an_unverified_arm_moves_slowly_and_a_verified_one_at_its_own_speed_or_as_a_client_chose(
    start: Start, limit: float, after: list[float]
) -> None:
    arm, first_motions = start(speed_limit=0.8)
    assert arm.changes == [ChangePace(speed_limit=CAP)]
    assert "not verified yet: no joint moves faster than 25%" in first_motions.advice
    # The arm says that this is its limit.
    arm.state = replace(arm.state, pace=Pace(speed_limit=limit))
    first_motions.take_verified()
    assert arm.changes[1:] == [ChangePace(speed_limit=share) for share in after]
    assert start()[0].changes == [], "after a restart"


def test_nothing_is_limited_without_servos_or_where_the_settings_say_so(start: Start) -> None:
    for settings in ({"serial": None}, {"unverified_speed_limit": 1.0}, {"speed_limit": 0.1}):
        arm, first_motions = start(**settings)
        assert (arm.changes, first_motions.advice) == ([], ""), settings


def test_a_new_calibration_or_trim_is_to_be_verified_again(start: Start, tmp_path: Path) -> None:
    start()[1].take_verified()
    assert start(zero_offset_rad={"elbow_flex": 0.05})[1].advice
    (tmp_path / "arm.json").write_text('{"other": 1}')
    assert start()[1].advice
