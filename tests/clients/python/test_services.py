"""x"""

import contextlib
import itertools
import sys
import threading
from collections.abc import Iterator

import pytest

from armbridge_client import Arm, ControlledByOther, GoalRefused, RequestRefused, WaitingGoal, connect, pose
from armbridge_client.messages import CompressedImage, JointState, MoveitGoalFeedback, TriggerRequest
from harness.server import ROOT, RunningServer
from harness.waiting import join, wait_until
from tests.helpers.programs import run

TABLE = pose(0.3, 0.0, 0.05)


@pytest.fixture
def in_empty_scene(arm: Arm) -> Iterator[Arm]:
    yield arm
    arm.scene.clear()


def test_an_object_in_the_way_refuses_a_goal_until_it_is_removed(in_empty_scene: Arm) -> None:
    arm = in_empty_scene
    arm.move_named("ready")
    arm.scene.add_box("crate", (0.1, 0.1, 0.1), pose(0.25, 0.0, 0.1))
    arm.scene.add_sphere("ball", 0.02, pose(0.0, 0.4, 0.1))
    arm.scene.add_cylinder("can", 0.1, 0.03, pose(0.0, -0.4, 0.1))
    arm.scene.add_mesh(
        "wedge",
        [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)],
        [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)],
        pose(-0.4, 0.0, 0.1),
    )
    assert sorted(arm.scene.objects()) == ["ball", "can", "crate", "wedge"]
    with pytest.raises(GoalRefused) as caught:
        arm.move_to(0.25, 0.0, 0.12)
    assert caught.value.code == -12
    assert "crate" in str(caught.value.details["pairs"])
    arm.scene.remove("crate")
    arm.move_to(0.25, 0.0, 0.12)


def test_an_object_that_is_held_moves_with_the_tip(in_empty_scene: Arm) -> None:
    arm = in_empty_scene
    arm.move_to(0.25, 0.0, 0.15)
    arm.scene.add_sphere("ball", 0.01, pose(0.25, 0.0, 0.15))
    arm.scene.allow_contact("ball", "gripper_link", "moving_jaw_so101_v1_link")
    arm.scene.attach("ball", touch_links=["gripper_link", "moving_jaw_so101_v1_link"])
    assert list(arm.scene.held()) == ["ball"]
    arm.move_to(0.25, 0.1, 0.15)
    arm.scene.detach("ball")
    assert arm.scene.objects()["ball"].pose.position.y == pytest.approx(0.1, abs=0.02)


def test_a_change_that_is_refused_has_the_servers_sentence(arm: Arm) -> None:
    with pytest.raises(RequestRefused, match=r"(?s)crate.*-0\.1"):
        arm.scene.add_box("crate", (-0.1, 0.1, 0.1), TABLE)


def test_a_server_without_physics_says_so(arm: Arm) -> None:
    for asked in (arm.scene.reset_physics, lambda: arm.scene.make_movable("crate")):
        with pytest.raises(RequestRefused, match="this server has no physics"):
            asked()


def test_scenes_are_saved_and_loaded_by_name(in_empty_scene: Arm) -> None:
    scene = in_empty_scene.scene
    scene.add_box("crate", (0.1, 0.1, 0.1), pose(0.0, 0.4, 0.1))
    scene.save("lab")
    scene.clear()
    assert scene.objects() == {}
    scene.load("lab")
    assert list(scene.objects()) == ["crate"]
    scene.delete("lab")
    assert scene.saved() == []


def test_a_position_is_saved_under_a_name_and_found_again(arm: Arm) -> None:
    arm.move_joints({"shoulder_pan": 0.3})
    arm.named_states.save("here")
    assert arm.named_states.all()["here"]["shoulder_pan"] == pytest.approx(0.3, abs=0.02)
    arm.move_named("home")
    arm.plan("here").execute()
    arm.named_states.delete("here")
    assert "here" not in arm.named_states.all()


def test_a_motion_is_taught_and_replayed(arm: Arm) -> None:
    arm.move_named("home")
    arm.teaching.begin("wave")
    arm.move_joints({"shoulder_pan": 0.3})
    arm.move_joints({"shoulder_pan": 0.0})
    assert arm.teaching.end().duration_s > 0.0
    assert arm.teaching.names() == ["wave"]
    assert arm.teaching.check("wave").success
    arm.teaching.replay("wave", speed=2.0)
    with pytest.raises(RequestRefused, match="speed"):
        arm.teaching.replay("wave", speed=9.0)
    arm.teaching.rename("wave", "greet")
    arm.teaching.trim("greet", 0.0, 0.3)
    arm.teaching.delete("greet")
    with pytest.raises(RequestRefused):
        arm.teaching.discard()


def test_a_path_of_straight_lines_is_planned_and_followed(arm: Arm) -> None:
    arm.move_named("ready")
    at = arm.tip().pose.position
    corners = [pose(at.x, at.y + dy, at.z + dz) for dy, dz in ((0.04, 0.0), (0.04, 0.04), (0.0, 0.0))]
    plan = arm.plan_path(corners)
    assert plan.execute().duration_s == plan.duration_s
    with pytest.raises(GoalRefused, match="of the path can be followed") as caught:
        arm.plan_path([pose(at.x + 0.5, at.y, at.z)])
    assert 0.0 <= caught.value.details["fraction"] < 1.0


def test_steering_moves_the_tip_and_letting_go_stops_it(arm: Arm) -> None:
    arm.move_named("ready")
    y = arm.tip().pose.position.y
    with arm.jog() as jog:
        for _ in arm.states(rate_hz=25):
            jog.tip((0.0, 0.1, 0.0))
            if arm.tip().pose.position.y > y + 0.02:
                break
        with pytest.raises(ValueError, match=r"linear_m_s must be from -0\.2 to 0\.2, not 3"):
            jog.tip((3.0, 0.0, 0.0))
        for state in arm.states(rate_hz=25):
            jog.joints({"wrist_roll": 0.3})
            if state.position_rad["wrist_roll"] > 0.05:
                break
    wait_until(lambda: arm.state().mode == "holding")


def steer(arm: Arm) -> None:
    with arm.jog() as jog:
        for _ in itertools.islice(arm.states(), 30):
            jog.tip((0.0, 0.1, 0.0))


def test_one_client_drives_at_a_time(server: RunningServer, arm: Arm) -> None:
    arm.take_control()
    assert arm.control().holder == arm.server.name
    with connect(server.url) as other:
        for refusing in (lambda: other.move_named("home"), other.enable, other.take_control, other.gripper.open):
            with pytest.raises(ControlledByOther):
                refusing()
        with pytest.raises(ControlledByOther):
            steer(other)
        assert other.plan("home").duration_s >= 0.0
        other.stop()
        arm.release_control()
        assert other.control().holder == ""
        other.move_named("home")


def decided(person: Arm, client: Arm, *, approves: bool) -> WaitingGoal:
    """Have a person approve or discard the goal of a client that waits; return that goal as the person sees it."""
    assert person.waiting_goal() is None
    seen: list[WaitingGoal] = []

    def answer() -> None:
        waiting = person.waiting_goal()
        assert waiting is not None
        seen.append(waiting)
        (person.approve if approves else person.discard)(waiting.goal_id)

    answering = threading.Thread(target=answer)

    def on_progress(progress: MoveitGoalFeedback) -> None:
        if progress.state == "planned" and answering.ident is None:
            answering.start()

    with contextlib.nullcontext() if approves else pytest.raises(GoalRefused, match="PREEMPTED"):
        client.move("ready", on_progress=on_progress)
    join(answering)
    return seen[0]


@pytest.mark.parametrize("approves", [True, False])
def test_a_goal_waits_for_its_confirmation(server: RunningServer, arm: Arm, approves: bool) -> None:
    arm.move_named("home")
    arm.set_confirm_mode(on=True)
    with connect(server.url) as person:
        assert not decided(person, arm, approves=approves).proposed
    arm.set_confirm_mode(on=False)


@pytest.mark.parametrize("approves", [True, False])
def test_a_proposed_goal_waits_for_the_answer_of_another_client(guarded: RunningServer, approves: bool) -> None:
    with connect(guarded.url, token="o" * 24) as person, connect(guarded.url, token="p" * 24) as model:
        seen = decided(person, model, approves=approves)
        assert seen.proposed
        assert "MODEL" in seen.client.upper()


def test_speed_limit_pause_and_parking(arm: Arm) -> None:
    assert "50%" in arm.set_speed_limit(0.5)
    arm.set_speed_limit(1.0)
    with pytest.raises(RequestRefused):
        arm.set_speed_limit(7.0)
    with pytest.raises(RequestRefused):
        arm.pause()
    arm.park()
    assert arm.state().mode == "relaxed"
    arm.enable()


def test_any_topic_and_any_service_can_be_used_and_images_come_as_bytes(arm: Arm) -> None:
    names = [message.name for message in itertools.islice(arm.messages("/joint_states", JointState), 2)]
    assert names[0] == names[1]
    assert arm.call("/arm/who_am_i", TriggerRequest()).success
    image = CompressedImage(format="jpeg", data=bytes(range(256)))
    arm.publish("/camera/image/compressed", image)
    assert next(arm.messages("/camera/image/compressed", CompressedImage)).data == image.data


def test_an_episode_is_marked(arm: Arm) -> None:
    assert "episode 1 has begun" in arm.episodes.start("pick up the cube")
    arm.episodes.stop()
    arm.episodes.discard()
    with pytest.raises(RequestRefused):
        arm.episodes.stop()


def test_a_topic_whose_name_looks_like_another_one_is_published_on(arm: Arm) -> None:
    connection = arm.asynchronous.connection
    for _ in range(3):
        arm.loop.run(connection.publish("/leader/joint_states", JointState(name=["shoulder_pan"], position=[0.0])))
        arm.state()


JOINTS = ("shoulder_pan", "wrist_roll", "gripper")


def test_chunks_of_a_policy_are_followed_and_refused_with_the_servers_sentence(arm: Arm) -> None:
    arm.move_named("ready")
    here = [arm.state().position_rad[name] for name in JOINTS]
    times_s = [each / 30.0 for each in range(1, 31)]
    onward = [[value + 0.2 * time_s for value in here] for time_s in times_s]
    with arm.chunks() as chunks:
        answer = chunks.send(JOINTS, times_s, onward)
        assert answer.refused_from == -1, answer.error_code.message
        with pytest.raises(RequestRefused, match="the first target takes joint shoulder_pan to"):
            chunks.send(JOINTS, times_s, [[value + 0.6 for value in row] for row in onward])
        # The refusal of one chunk is no refusal of the next.
        chunks.send(JOINTS, times_s, onward, blend="real_time")
        wait_until(lambda: abs(arm.state().position_rad["shoulder_pan"] - onward[-1][0]) < 0.05)
    arm.stop()


def test_the_state_is_there_also_while_the_same_client_goes_over_the_states(arm: Arm) -> None:
    states = arm.states()
    first = next(states)
    assert arm.state(timeout_s=5.0).position_rad.keys() == first.position_rad.keys()
    states.close()


CLIENT = ROOT / "clients" / "python"


def test_the_committed_message_types_are_generated_from_the_servers_tables() -> None:
    program = "import generate_messages; print(generate_messages.generated(), end='')"
    done = run(sys.executable, "-c", program, env={"PYTHONPATH": f"{CLIENT}:{ROOT}"})
    assert done.stdout == (CLIENT / "armbridge_client" / "messages.py").read_text(), (
        f"run PYTHONPATH=. python clients/python/generate_messages.py\n{done.stderr}"
    )
