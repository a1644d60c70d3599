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


async def test_a_check_tells_how_long_a_replay_would_take_at_a_speed_or_what_it_would_touch(lesson: Lesson) -> None:
    await lesson.teach("wave")
    whole, half = [await lesson.done("check", name="wave", speed=speed) for speed in (0.0, 0.5)]
    assert half["duration_s"] == pytest.approx(2.0 * whole["duration_s"], rel=0.05)
    assert "speed: must be above 0 and at most 2, not 3" in await lesson.refused("check", name="wave", speed=3.0)
    await lesson.put_crate_at_the_end("wave")
    said = await lesson.refused("check", name="wave")
    assert "s of the motion would touch" in said
    assert "crate" in said


async def test_one_motion_is_recorded_at_a_time_whoever_asks(lesson: Lesson) -> None:
    both = await asyncio.gather(*(lesson.call("/teach/begin", name=name) for name in ("a", "b")))
    assert sorted(answer["success"] for answer in both) == [False, True]
    assert "is being recorded" in next(answer["message"] for answer in both if not answer["success"])


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


@pytest.mark.parametrize(
    ("request_", "says"), [({"name": "../x"}, "name: must be"), ({"name": "a", "group": "leg"}, "gripper, not 'leg'")]
)
async def test_a_recording_without_a_place_does_not_begin(lesson: Lesson, request_: dict[str, str], says: str) -> None:
    assert says in await lesson.refused("begin", **request_)
    assert not any(state["recording"] for state in lesson.states)


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


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"clock_s": 1.0 + MAX_DURATION_S + 0.1}, "600 s at most"),
        ({"clock_s": 0.5}, "started again"),
        ({"clock_s": 2.0, "mode": Mode.DISCONNECTED, "reason": "unplugged"}, "not connected: unplugged"),
        ({"clock_s": 2.0, "position_rad": None}, "not connected"),
    ],
)
def test_a_recording_that_cannot_go_on_ends_with_the_reason(changes: dict[str, Any], says: str) -> None:
    recorder = TeachingRecorder("wave", JOINTS)
    recorder.take_state(replace(MEASURED, clock_s=1.0))
    assert says in recorder.take_state(replace(MEASURED, **changes))
    assert recorder.points == 1


def test_the_arm_and_its_gripper_are_recorded_unless_a_group_is_named() -> None:
    assert joints_to_teach(ROBOT, "") == JOINTS
    assert joints_to_teach(ROBOT, "gripper") == ("gripper",)
    assert joints_to_teach(SEVEN, "") == SEVEN.groups[SEVEN.default_group].joints
