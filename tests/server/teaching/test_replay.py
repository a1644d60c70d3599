"""Replay and services of taught motions."""

import asyncio
import logging
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.waiting import until
from planners.goals import JointGoal
from planners.problem import JointPathProblem, MoveItErrorCode, PlanningFailure, PlanningProblem
from robot.messages import ArmState, Mode
from robot.trajectory import Trajectory
from server.execution.goal import Answer, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import Role
from server.teaching.replay import MAX_REPEAT, NAME, groups_of, offer_replay, planned, result
from server.teaching.services import Teaching, TeachingRecorder, joints_to_teach
from server.teaching.taught_motion import MAX_DURATION_S, MotionFiles, TaughtMotion
from tests.helpers.fake_arm import HOME, JOINTS, FakeArm
from tests.helpers.moveit import BENT, ROBOT, SEVEN, ActionDesk, ServiceRig, box, diff, planning_of, pose, rejection
from tests.helpers.rules import server_rules

POINTS = np.linspace(0.1, 0.5, 11)[:, np.newaxis] * np.ones(len(JOINTS))
WAVE = TaughtMotion(JOINTS, np.arange(11) * 0.3, POINTS)


@pytest.fixture
async def desk(tmp_path: Path) -> ActionDesk:
    """The action with one taught motion."""
    made, motions = ActionDesk(), MotionFiles(tmp_path, ROBOT)
    offer_replay(made.graph, made.context, motions, made.queue)
    await motions.save("wave", WAVE)
    return made


async def replay(desk: ActionDesk, **goal: Any) -> ActionGoal:
    """Ask for a replay, and wait until it is asked of the executor."""
    sent = await desk.send(NAME, name="wave", **goal)
    await until(lambda: desk.asked)
    return sent


def problems(motion: PlannedMotion) -> list[Any]:
    return [step(HOME) for step in motion.steps]


def test_a_replay_goes_to_the_start_of_each_group_and_then_follows_all_joints() -> None:
    arm, gripper, path = problems(planned(WAVE, 1.0, 0, planning_of(FakeArm())))
    assert isinstance(arm, PlanningProblem)
    assert isinstance(path, JointPathProblem)
    assert (arm.group, gripper.group) == ("arm", "gripper")
    assert arm.goal == JointGoal(dict.fromkeys(JOINTS[:-1], 0.1))
    assert (path.joint_names, path.positions_rad.tolist()) == (JOINTS, POINTS.tolist())


async def test_a_replay_backwards_begins_at_the_end_and_is_repeated(desk: ActionDesk) -> None:
    await replay(desk, speed=0.5, reverse=True, repeat=1)
    arm, _, path, *again = problems(desk.asked[0])
    assert arm.goal == JointGoal(dict.fromkeys(JOINTS[:-1], 0.5))
    assert path.positions_rad.tolist() == POINTS[::-1].tolist()
    assert (path.speed, len(again)) == (0.5, 3)


def test_joints_that_make_no_group_without_others_are_refused() -> None:
    assert [group.name for group in groups_of(ROBOT, frozenset(JOINTS))] == ["arm", "gripper"]
    failure = rejection(groups_of, ROBOT, frozenset({"elbow_flex", "gripper"}))
    assert "elbow_flex" in failure.message
    assert groups_of(SEVEN, frozenset(SEVEN.groups[SEVEN.default_group].joints))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"speed": -1.0}, "speed: must be above 0 and at most 2, not -1"),
        ({"speed": 2.1}, "not 2.1"),
        ({"repeat": MAX_REPEAT + 1}, f"repeat: must be 0 to {MAX_REPEAT}"),
        ({"name": "dance"}, "saved are: wave"),
    ],
)
async def test_a_wrong_field_is_refused(desk: ActionDesk, fields: dict[str, Any], says: str) -> None:
    await desk.send(NAME, **({"name": "wave"} | fields))
    await until(lambda: desk.results)
    assert (desk.results[0].status, desk.asked) == (GoalStatus.ABORTED, [])
    assert says in desk.results[0].values["message"]


async def test_a_bug_costs_its_replay_only_and_never_its_result(
    desk: ActionDesk, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def broken(*_arguments: object) -> None:
        raise ValueError("broken")

    monkeypatch.setattr(MotionFiles, "load", broken)
    await desk.send(NAME, name="wave")
    await until(lambda: desk.results)
    assert (desk.results[0].ok, desk.results[0].values) == (False, "internal error: ValueError: broken")


async def test_a_replay_is_a_goal_with_feedback_and_a_result_that_can_be_cancelled(desk: ActionDesk) -> None:
    await replay(desk, speed=0.0)
    assert problems(desk.asked[0])[-1].speed == 1.0
    desk.report(Progress(GoalState.EXECUTING, "moving", 0.25, 3.0))
    assert desk.feedback[-1] == {"state": "executing", "fraction": 0.25, "remaining_s": 3.0}
    desk.finish()
    await until(lambda: desk.results)
    desk.asked.clear()
    (await replay(desk)).cancel()
    await until(lambda: len(desk.results) == 2)
    assert [result.status for result in desk.results] == [GoalStatus.SUCCEEDED, GoalStatus.CANCELED]
    assert desk.results[0].values["error_code"]["val"] == 1


def test_a_refusal_says_where_without_the_number_of_the_step() -> None:
    failure = PlanningFailure(
        MoveItErrorCode.INVALID_MOTION_PLAN, "items[2]: at 1.20 s of the motion would touch: crate", {"item": 2}
    )
    assert result(Answer.of(failure))["message"] == "at 1.20 s of the motion would touch: crate"


async def test_a_slower_replay_names_the_place(desk: ActionDesk, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    await replay(desk)
    slow = Trajectory(JOINTS, 2.0 * WAVE.time_s, POINTS, np.zeros_like(POINTS), np.zeros_like(POINTS))
    desk.finish(Answer(MoveItErrorCode.SUCCESS, "there", performed=Performed({}, (slow,))))
    await until(lambda: desk.results)
    words = "took 3.00 s longer than asked for, most of all at"
    assert words in desk.results[0].values["message"]
    assert f"the replay of 'wave' {words}" in caplog.text


START = np.array(list(BENT.values()))
RELAXED = ArmState(1.0, Mode.RELAXED, JOINTS, position_rad=START)


class Lesson(ServiceRig):
    """Teaching on a graph of its own, and a hand."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.motions = MotionFiles(folder, ROBOT)
        self.teaching = Teaching(self.graph, self.context, self.motions)
        self.states = self.listen("/teach/state", "armbridge_msgs/TeachState")
        self.state = RELAXED
        self.teaching.on_state("", self.state)

    def hand(self, lasts_s: float = 2.0, **to_rad: float) -> None:
        """Lead joints to positions, and rest there for a moment."""
        before = self.state
        assert before.position_rad is not None
        goal = before.position_rad.copy()
        for name, value in to_rad.items():
            goal[JOINTS.index(name)] = value
        for passed_s in np.arange(0.02, lasts_s + 0.5, 0.02):
            share = 0.5 - 0.5 * np.cos(np.pi * min(passed_s / lasts_s, 1.0))
            at = before.position_rad + share * (goal - before.position_rad)
            self.state = replace(before, clock_s=before.clock_s + float(passed_s), position_rad=at)
            self.teaching.on_state("", self.state)

    async def done(self, service: str, **request: Any) -> dict[str, Any]:
        """Call a service of teaching that must succeed."""
        answer: dict[str, Any] = await self.call(f"/teach/{service}", **request)
        assert answer["success"], answer
        return answer

    async def refused(self, service: str, **request: Any) -> str:
        """Return the reason of a service of teaching that must be refused."""
        answer = await self.call(f"/teach/{service}", **request)
        assert not answer["success"]
        return str(answer["message"])

    async def begin(self, name: str = "wave") -> None:
        """Begin a recording, and lead the arm."""
        await self.done("begin", name=name)
        self.hand(shoulder_pan=0.7, gripper=0.6)

    async def teach(self, name: str) -> dict[str, Any]:
        await self.begin(name)
        return await self.done("end")

    async def put_crate_at_the_end(self, name: str) -> None:
        """Put a crate where the tip is at the end of a motion."""
        end = (await self.call("/teach/get", name=name))["trajectory"]["points"][-1]["positions"]
        state = {"joint_state": {"name": list(JOINTS), "position": end}}
        tip = await self.call("/compute_fk", fk_link_names=["gripper_frame_link"], robot_state=state)
        crate = box("crate", at=pose(**tip["pose_stamped"][0]["pose"]["position"]))
        self.scene_state.apply_diff(diff(world={"collision_objects": [crate]}), BENT)


@pytest.fixture
async def lesson(tmp_path: Path) -> AsyncIterator[Lesson]:
    made = Lesson(tmp_path / "motions")
    yield made
    await made.teaching.stop()


async def test_a_taught_motion_is_saved_with_its_gripper_and_found_by_its_name(lesson: Lesson) -> None:
    ended = await lesson.teach("wave")
    assert "touches nothing" in ended["message"]
    assert 1.5 < ended["duration_s"] < 2.5
    assert (await lesson.call("/teach/list")) == {"names": ["wave"]}
    got = (await lesson.call("/teach/get", name="wave"))["trajectory"]
    assert (got["joint_names"], len(got["points"])) == (list(JOINTS), ended["points"])
    assert got["points"][-1]["positions"][0] == pytest.approx(0.7, abs=0.02)


async def test_motions_are_shown_one_after_the_other(lesson: Lesson, monkeypatch: pytest.MonkeyPatch) -> None:
    await lesson.teach("wave")
    motions, in_progress, most = lesson.teaching._motions, 0, 0
    load = motions.load

    async def counted(name: str) -> TaughtMotion:
        nonlocal in_progress, most
        in_progress += 1
        most = max(most, in_progress)
        motion = await load(name)
        in_progress -= 1
        return motion

    monkeypatch.setattr(motions, "load", counted)
    shown = await asyncio.gather(*(lesson.call("/teach/get", name="wave") for _ in range(4)))
    assert [each["success"] for each in shown] == [True] * 4
    assert most == 1


async def test_a_check_tells_how_long_a_replay_would_take_at_a_speed_or_what_it_would_touch(lesson: Lesson) -> None:
    await lesson.teach("wave")
    whole, half = [await lesson.done("check", name="wave", speed=speed) for speed in (0.0, 0.5)]
    assert half["duration_s"] == pytest.approx(2.0 * whole["duration_s"], rel=0.05)
    assert "speed: must be above 0 and at most 2, not 3" in await lesson.refused("check", name="wave", speed=3.0)
    await lesson.put_crate_at_the_end("wave")
    said = await lesson.refused("check", name="wave")
    assert "s of the motion would touch" in said
    assert "crate" in said


async def test_a_recording_without_a_place_or_beside_another_does_not_begin(lesson: Lesson) -> None:
    for place, says in ({"name": "../x"}, "name: must be"), ({"name": "a", "group": "leg"}, "gripper, not 'leg'"):
        assert says in await lesson.refused("begin", **place)
    assert not any(state["recording"] for state in lesson.states)
    both = await asyncio.gather(*(lesson.call("/teach/begin", name=name) for name in ("a", "b")))
    assert sorted(answer["success"] for answer in both) == [False, True]
    assert "is being recorded" in next(answer["message"] for answer in both if not answer["success"])


async def test_a_recording_that_could_not_be_saved_does_not_begin(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    lesson = Lesson(tmp_path / "file")
    assert "the motion 'wave' cannot be recorded: " in await lesson.refused("begin", name="wave")
    assert not any(state["recording"] for state in lesson.states)


async def test_a_recording_that_is_discarded_or_without_a_motion_leaves_nothing(lesson: Lesson) -> None:
    await lesson.begin()
    assert lesson.teaching.observes_states
    await lesson.done("discard")
    assert not lesson.teaching.observes_states
    for service in ("end", "discard"):
        assert "discarded" in await lesson.refused(service)
    await lesson.done("begin", name="wave")
    lesson.hand()
    assert "nothing has moved" in await lesson.refused("end")
    assert (await lesson.call("/teach/list")) == {"names": []}


async def test_a_lost_arm_and_a_server_that_ends_end_the_recording_which_is_kept(lesson: Lesson) -> None:
    await lesson.begin()
    lost = replace(lesson.state, mode=Mode.DISCONNECTED, reason="unplugged", position_rad=None)
    lesson.teaching.on_state("", lost)
    await until(lambda: "unplugged; the motion 'wave' is saved" in lesson.states[-1]["message"])
    assert "not connected" in await lesson.refused("begin", name="greet")
    lesson.teaching.on_state("", lesson.state)
    lesson.state = replace(RELAXED, clock_s=lesson.state.clock_s + 1.0)
    await lesson.begin("greet")
    await lesson.teaching.stop()
    assert await lesson.motions.names() == ["greet", "wave"]


async def test_a_recording_that_would_collide_is_kept_and_says_where(lesson: Lesson) -> None:
    await lesson.teach("free")
    await lesson.put_crate_at_the_end("free")
    lesson.state = replace(RELAXED, clock_s=lesson.state.clock_s + 1.0)
    said = (await lesson.teach("blocked"))["message"]
    assert "cannot be replayed: at " in said
    assert "crate" in said
    assert (await lesson.call("/teach/list")) == {"names": ["blocked", "free"]}


async def test_a_trimmed_motion_is_the_part(lesson: Lesson) -> None:
    await lesson.teach("wave")
    part = {"name": "wave", "from_s": 0.5, "to_s": 1.5}
    assert (await lesson.done("trim", **part))["duration_s"] == pytest.approx(1.0)
    points = (await lesson.call("/teach/get", name="wave"))["trajectory"]["points"]
    assert points[-1]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert "must be 0 to 1 s" in await lesson.refused("trim", **part)


async def test_a_motion_comes_back_edited_from_a_client_and_motions_are_renamed_and_deleted(lesson: Lesson) -> None:
    await lesson.teach("wave")
    trajectory = (await lesson.call("/teach/get", name="wave"))["trajectory"]
    trajectory["points"][-1]["positions"][0] = 0.65
    await lesson.done("save", name="mine", trajectory=trajectory)
    await lesson.done("delete", name="wave")
    await lesson.done("rename", name="mine", new_name="greet")
    again = (await lesson.call("/teach/get", name="greet"))["trajectory"]
    assert again["points"][-1]["positions"][0] == 0.65
    for service, more in (("get", {}), ("delete", {}), ("rename", {"new_name": "mine"})):
        assert "saved are: greet" in await lesson.refused(service, name="wave", **more)
    await lesson.done("delete", name="greet")
    assert "no motion is saved" in await lesson.refused("delete", name="greet")
    trajectory["joint_names"][0] = "knee"
    assert "knee" in await lesson.refused("save", name="mine", trajectory=trajectory)


def test_replays_drive_the_arm_and_changes_of_motions_configure() -> None:
    services, _, actions = server_rules()
    assert actions["/replay_motion"].drives
    of_role = {Role.VIEW: "list get", Role.OPERATE: "begin end discard", Role.ADMIN: "save delete rename trim"}
    for role, names in of_role.items():
        assert {services[f"/teach/{name}"].role for name in names.split()} == {role}


MEASURED = ArmState(1.0, Mode.RELAXED, JOINTS, position_rad=np.arange(6.0), goal_rad=np.arange(6.0) + 9.0)


def test_a_relaxed_arm_is_recorded_once_where_it_is_measured_and_a_driven_one_where_it_is_commanded() -> None:
    recorder = TeachingRecorder("wave", ("elbow_flex", "gripper"))
    # States that come twice count once.
    for clock_s in (5.0, 5.0, 5.001, 5.02, 5.04):
        assert recorder.take_state(replace(MEASURED, clock_s=clock_s)) == ""
    time_s, positions_rad = recorder.samples
    assert time_s.tolist() == [5.0, 5.02, 5.04]
    assert positions_rad.tolist() == [[2.0, 5.0]] * 3
    assert (recorder.points, recorder.duration_s) == (3, pytest.approx(0.04))
    recorder.take_state(replace(MEASURED, clock_s=5.06, goal_rad=np.arange(6.0) + 0.5, torque_enabled=True))
    assert recorder.samples[1].tolist()[-1] == [2.5, 5.5]


def test_a_recording_that_cannot_go_on_ends_with_the_reason() -> None:
    for changes, says in (
        ({"clock_s": 1.0 + MAX_DURATION_S + 0.1}, "600 s at most"),
        ({"clock_s": 0.5}, "started again"),
        ({"clock_s": 2.0, "mode": Mode.DISCONNECTED, "reason": "unplugged"}, "not connected: unplugged"),
        ({"clock_s": 2.0, "position_rad": None}, "not connected"),
    ):
        recorder = TeachingRecorder("wave", JOINTS)
        recorder.take_state(replace(MEASURED, clock_s=1.0))
        assert says in recorder.take_state(replace(MEASURED, **changes))
        assert recorder.points == 1, changes


def test_the_arm_and_its_gripper_are_recorded_unless_a_group_is_named() -> None:
    assert joints_to_teach(ROBOT, "") == JOINTS
    assert joints_to_teach(ROBOT, "gripper") == ("gripper",)
    assert joints_to_teach(SEVEN, "") == SEVEN.groups[SEVEN.default_group].joints
