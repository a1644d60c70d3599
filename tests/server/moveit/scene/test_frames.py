import pytest

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from server.moveit.scene import frames
from server.moveit.scene.frames import MAX_NAME_LENGTH, Frames
from tests.helpers.moveit import BENT, FORWARD, box, collision_object, diff, pose, rejection, scene_state

STATE = scene_state(
    collision_object(
        **box("table", at=pose(0.3, 0.1)),
        subframe_names=["corner", "leg/foot"],
        subframe_poses=[pose(0.0, 0.2), pose(0.1)],
    ),
    collision_object(**box("cup", at=pose(0.2))),
)
TOOL = box("tool", at=pose(0.1), frame="gripper_link")
HANDLE = {"subframe_names": ["handle"], "subframe_poses": [pose(0.0, 0.0, 0.5)]}
HELD = {"link_name": "gripper_link", "object": {**TOOL, **HANDLE}}
STATE.apply_diff(diff(robot_state={"attached_collision_objects": [HELD]}), BENT)
FRAMES = Frames(STATE)
GRIPPER = FORWARD.transforms(BENT)["gripper_link"]


@pytest.mark.parametrize("name", ["", "/", "base_link", "/base_link", "world", "/world"])
def test_the_root_link_has_many_names(name):
    assert FRAMES.resolve(name, BENT) == Pose()


def test_objects_and_their_subframes_are_found():
    for name, position_m in (
        ("table", (0.3, 0.1, 0.0)),
        ("/table/corner", (0.3, 0.3, 0.0)),
        ("table/leg/foot", (0.4, 0.1, 0.0)),
        # An attached object moves with its link.
        ("tool", (GRIPPER @ (0.1, 0.0, 0.0, 1.0))[:3]),
        ("tool/handle", (GRIPPER @ (0.1, 0.0, 0.5, 1.0))[:3]),
    ):
        assert FRAMES.resolve(name, BENT).position_m == pytest.approx(position_m, abs=1e-12)


@pytest.mark.parametrize("name", ["nowhere", "table/nowhere", "nowhere/corner", "x" * (MAX_NAME_LENGTH + 1)])
def test_an_unknown_frame_is_refused_by_its_name(name):
    refusal = rejection(FRAMES.resolve, name, BENT)
    assert refusal.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert refusal.details["frame"] == name[:MAX_NAME_LENGTH]


@pytest.mark.parametrize("name", ["gripper_link", "tool"])
def test_frames_that_move_are_not_found_while_the_arms_position_is_unknown(name):
    assert "arm is not connected" in rejection(FRAMES.resolve, name, None).message
    assert FRAMES.resolve("table", None).position_m == (0.3, 0.1, 0.0)


def test_a_thread_that_asks_for_other_positions_meanwhile_changes_no_answer(monkeypatch):
    look_up = Frames(scene_state())
    turned = {**BENT, "shoulder_pan": 1.0}
    expected = look_up.resolve("gripper_link", turned)

    def interrupted(*arguments):
        monkeypatch.undo()
        assert look_up.resolve("gripper_link", turned) == expected
        return frames.find_frame(*arguments)

    monkeypatch.setattr(frames, "find_frame", interrupted)
    assert look_up.resolve("gripper_link", BENT) != expected
    assert look_up.resolve("gripper_link", turned) == expected
