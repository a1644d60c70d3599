"""The services of teaching, on a fake arm and with a planner in the process."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.waiting import until
from robot.messages import ArmState, Mode
from server.graph.permissions import Role
from server.teaching.services import Teaching, TeachingRecorder, joints_to_teach
from server.teaching.taught_motion import MAX_DURATION_S, MotionFiles
from tests.helpers.fake_arm import JOINTS
from tests.helpers.moveit import BENT, ROBOT, SEVEN, ServiceRig, box, diff, pose
from tests.helpers.rules import server_rules

START = np.array(list(BENT.values()))
RELAXED = ArmState(1.0, Mode.RELAXED, JOINTS, position_rad=START)


class Lesson(ServiceRig):
    """Teaching on a graph of its own, and a hand."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.motions = MotionFiles(folder, ROBOT)
        self.teaching = Teaching(self.graph, ROBOT, self.motions, self.pool, self.scene_state, self.current)
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

    async def begin(self) -> None:
        """Begin a recording, and lead the arm."""
        assert (await self.call("/teach/begin", name="wave"))["success"]
        self.hand(shoulder_pan=0.7)

    async def teach(self, name: str) -> dict[str, Any]:
        assert (await self.call("/teach/begin", name=name))["success"]
        self.hand(shoulder_pan=0.7, gripper=0.6)
        answer: dict[str, Any] = await self.call("/teach/end")
        return answer


@pytest.fixture
async def lesson(tmp_path: Path) -> AsyncIterator[Lesson]:
    made = Lesson(tmp_path / "motions")
    yield made
    await made.teaching.stop()


async def refused(lesson: Lesson, service: str, **request: Any) -> str:
    answer = await lesson.call(f"/teach/{service}", **request)
    assert not answer["success"]
    return str(answer["message"])


async def put_crate_at_the_end(lesson: Lesson, name: str) -> None:
    """Put a crate where the tip is at the end of a motion."""
    end = (await lesson.call("/teach/get", name=name))["trajectory"]["points"][-1]["positions"]
    state = {"joint_state": {"name": list(JOINTS), "position": end}}
    tip = await lesson.call("/compute_fk", fk_link_names=["gripper_frame_link"], robot_state=state)
    at = tip["pose_stamped"][0]["pose"]["position"]
    crate = box("crate", at=pose(at["x"], at["y"], at["z"]))
    lesson.scene_state.apply_diff(diff(world={"collision_objects": [crate]}), BENT)


async def test_a_taught_motion_is_saved_with_its_gripper_and_found_by_its_name(lesson: Lesson) -> None:
    ended = await lesson.teach("wave")
    assert ended["success"]
    assert "touches nothing" in ended["message"]
    assert 1.5 < ended["duration_s"] < 2.5
    assert (await lesson.call("/teach/list")) == {"names": ["wave"]}
    got = await lesson.call("/teach/get", name="wave")
    assert got["trajectory"]["joint_names"] == list(JOINTS)
    assert len(got["trajectory"]["points"]) == ended["points"]
    assert got["trajectory"]["points"][-1]["positions"][0] == pytest.approx(0.7, abs=0.02)


async def test_a_check_tells_how_long_a_replay_would_take_at_a_speed(lesson: Lesson) -> None:
    await lesson.teach("wave")
    whole, half = [await lesson.call("/teach/check", name="wave", speed=speed) for speed in (0.0, 0.5)]
    assert whole["success"]
    assert half["success"]
    assert half["duration_s"] == pytest.approx(2.0 * whole["duration_s"], rel=0.05)


async def test_a_check_refuses_a_motion_that_would_touch_something_and_a_speed_out_of_range(lesson: Lesson) -> None:
    await lesson.teach("wave")
    assert "speed: must be above 0 and at most 2, not 3" in await refused(lesson, "check", name="wave", speed=3.0)
    await put_crate_at_the_end(lesson, "wave")
    said = await refused(lesson, "check", name="wave")
    assert "s of the motion would touch" in said
    assert "crate" in said


async def test_one_motion_is_recorded_at_a_time_whoever_asks(lesson: Lesson) -> None:
    both = await asyncio.gather(*(lesson.call("/teach/begin", name=name) for name in ("a", "b")))
    assert sorted(answer["success"] for answer in both) == [False, True]
    assert "is being recorded" in next(answer["message"] for answer in both if not answer["success"])


async def test_a_discarded_recording_leaves_nothing(lesson: Lesson) -> None:
    await lesson.begin()
    assert lesson.teaching.observes_states
    assert (await lesson.call("/teach/discard"))["success"]
    assert not lesson.teaching.observes_states
    assert (await lesson.call("/teach/list")) == {"names": []}
    assert "discarded" in await refused(lesson, "end")
    assert "discarded" in await refused(lesson, "discard")


async def test_a_recording_without_a_motion_is_not_saved(lesson: Lesson) -> None:
    assert (await lesson.call("/teach/begin", name="wave"))["success"]
    lesson.hand()
    assert "nothing has moved" in await refused(lesson, "end")
    assert (await lesson.call("/teach/list")) == {"names": []}


async def test_a_lost_arm_ends_the_recording_which_is_kept_and_the_state_says_so(lesson: Lesson) -> None:
    await lesson.begin()
    lesson.teaching.on_state("", replace(lesson.state, mode=Mode.DISCONNECTED, reason="unplugged"))
    await until(lambda: "unplugged; the motion 'wave' is saved" in lesson.states[-1]["message"])
    assert (await lesson.call("/teach/list")) == {"names": ["wave"]}


async def test_a_server_that_ends_saves_what_is_being_recorded(lesson: Lesson) -> None:
    await lesson.begin()
    await lesson.teaching.stop()
    assert await lesson.motions.names() == ["wave"]


async def test_a_recording_that_would_collide_is_kept_and_says_where(lesson: Lesson) -> None:
    await lesson.teach("free")
    await put_crate_at_the_end(lesson, "free")
    lesson.state = replace(RELAXED, clock_s=lesson.state.clock_s + 1.0)
    ended = await lesson.teach("blocked")
    assert ended["success"]
    assert "cannot be replayed: at " in ended["message"]
    assert "crate" in ended["message"]
    assert (await lesson.call("/teach/list")) == {"names": ["blocked", "free"]}


async def test_a_trimmed_motion_is_the_part(lesson: Lesson) -> None:
    await lesson.teach("wave")
    trimmed = await lesson.call("/teach/trim", name="wave", from_s=0.5, to_s=1.5)
    assert trimmed["success"]
    assert trimmed["duration_s"] == pytest.approx(1.0)
    points = (await lesson.call("/teach/get", name="wave"))["trajectory"]["points"]
    assert points[-1]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert "must be 0 to 1 s" in await refused(lesson, "trim", name="wave", from_s=0.5, to_s=1.5)


async def test_a_motion_goes_to_a_client_and_comes_back_edited(lesson: Lesson) -> None:
    await lesson.teach("wave")
    trajectory = (await lesson.call("/teach/get", name="wave"))["trajectory"]
    trajectory["points"][-1]["positions"][0] = 0.65
    assert (await lesson.call("/teach/save", name="mine", trajectory=trajectory))["success"]
    again = (await lesson.call("/teach/get", name="mine"))["trajectory"]
    assert again["points"][-1]["positions"][0] == 0.65
    trajectory["joint_names"][0] = "knee"
    assert "knee" in await refused(lesson, "save", name="mine", trajectory=trajectory)


async def test_motions_are_renamed_and_deleted(lesson: Lesson) -> None:
    await lesson.teach("wave")
    assert (await lesson.call("/teach/rename", name="wave", new_name="greet"))["success"]
    for service, more in (("get", {}), ("delete", {}), ("rename", {"new_name": "mine"})):
        assert "saved are: greet" in await refused(lesson, service, name="wave", **more)
    assert (await lesson.call("/teach/delete", name="greet"))["success"]
    assert "no motion is saved" in await refused(lesson, "delete", name="greet")


@pytest.mark.parametrize(
    ("request_", "says"), [({"name": "../x"}, "name: must be"), ({"name": "a", "group": "leg"}, "gripper, not 'leg'")]
)
async def test_a_recording_without_a_place_does_not_begin(lesson: Lesson, request_: dict[str, str], says: str) -> None:
    assert says in await refused(lesson, "begin", **request_)
    assert not any(state["recording"] for state in lesson.states)


async def test_an_arm_that_is_not_connected_is_not_recorded(lesson: Lesson) -> None:
    lesson.teaching.on_state("", ArmState(1.0, Mode.DISCONNECTED, JOINTS))
    assert "not connected" in await refused(lesson, "begin", name="wave")


def test_replays_drive_the_arm_and_changes_of_motions_configure() -> None:
    services, _, actions = server_rules()
    assert actions["/replay_motion"].drives
    assert {services[f"/teach/{name}"].role for name in ("list", "get")} == {Role.VIEW}
    assert {services[f"/teach/{name}"].role for name in ("begin", "end", "discard")} == {Role.OPERATE}
    changes = ("save", "delete", "rename", "trim")
    assert {services[f"/teach/{name}"].role for name in changes} == {Role.ADMIN}


MEASURED = ArmState(1.0, Mode.RELAXED, JOINTS, position_rad=np.arange(6.0), goal_rad=np.arange(6.0) + 9.0)


def test_a_relaxed_arm_is_recorded_where_it_is_measured_and_a_driven_one_where_it_is_commanded() -> None:
    recorder = TeachingRecorder("wave", ("elbow_flex", "gripper"))
    for clock_s in (5.0, 5.02, 5.04):
        assert recorder.take_state(replace(MEASURED, clock_s=clock_s)) == ""
    time_s, positions_rad = recorder.samples
    assert time_s.tolist() == [5.0, 5.02, 5.04]
    assert positions_rad.tolist() == [[2.0, 5.0]] * 3
    assert recorder.duration_s == pytest.approx(0.04)
    recorder.take_state(replace(MEASURED, clock_s=5.06, goal_rad=np.arange(6.0) + 0.5, torque_enabled=True))
    assert recorder.samples[1].tolist()[-1] == [2.5, 5.5]


def test_states_that_come_twice_count_once() -> None:
    recorder = TeachingRecorder("wave", JOINTS)
    for clock_s in (1.0, 1.0, 1.001, 1.02):
        recorder.take_state(replace(MEASURED, clock_s=clock_s))
    assert recorder.points == 2


@pytest.mark.parametrize(
    ("state", "says"),
    [
        (replace(MEASURED, clock_s=1.0 + MAX_DURATION_S + 0.1), "600 s at most"),
        (replace(MEASURED, clock_s=0.5), "started again"),
        (replace(MEASURED, clock_s=2.0, mode=Mode.DISCONNECTED, reason="unplugged"), "not connected: unplugged"),
        (replace(MEASURED, clock_s=2.0, position_rad=None), "not connected"),
    ],
)
def test_a_recording_that_cannot_go_on_ends_with_the_reason(state: ArmState, says: str) -> None:
    recorder = TeachingRecorder("wave", JOINTS)
    recorder.take_state(replace(MEASURED, clock_s=1.0))
    assert says in recorder.take_state(state)
    assert recorder.points == 1


def test_the_arm_and_its_gripper_are_recorded_unless_a_group_is_named() -> None:
    assert joints_to_teach(ROBOT, "") == JOINTS
    assert joints_to_teach(ROBOT, "gripper") == ("gripper",)
    assert joints_to_teach(SEVEN, "") == SEVEN.groups[SEVEN.default_group].joints
