from dataclasses import replace

import mujoco
import numpy as np
import pytest

from robot.description.camera import Camera
from robot.errors import DescriptionError
from robot.physics.bodies import Body
from robot.physics.renderer import ArmRenderer, RenderingError
from tests.helpers.rendering import needs_egl, red_pixels
from tests.helpers.robots import so101
from tests.robot.physics.test_servo_joints import BARE
from tests.robot.physics.test_world import box

RED = {"cube": (1.0, 0.0, 0.0, 1.0)}
CAMERAS = {
    "above": Camera(frame="base_link", view=(0.3, 0.4, 0.6, 0.3, 0.4, 0.0), width=160, height=120),
    "wrist": Camera(frame="gripper_link", view=(0.0, 0.2, -0.1, 0.0, 0.0, -0.1)),
}


def held_cube(renderer: ArmRenderer) -> Body:
    """A cube between the fingers."""
    position_m, (qx, qy, qz, qw) = renderer.link_pose("gripper_link")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, [qw, qx, qy, qz])
    x, y, z = (np.array(position_m) + rotation.reshape(3, 3) @ (0.0, 0.0, -0.1)).tolist()
    return replace(box("cube", (x, y, z), 0.02), orientation=(qx, qy, qz, qw))


@needs_egl
def test_a_cube_in_the_gripper_keeps_its_pixels_and_a_cube_that_stays_behind_does_not() -> None:
    renderer = ArmRenderer(so101(), CAMERAS)
    seen = []
    cube = held_cube(renderer)
    for angle_rad in (0.0, 0.2):
        renderer.place({"shoulder_pan": angle_rad, "wrist_flex": angle_rad})
        for body in (held_cube(renderer), cube):
            renderer.set_bodies((body,), RED)
            seen.append(red_pixels(renderer.image("wrist")))
    before, same, held, left = (pixels.mean(axis=0) for pixels in seen)
    assert before == pytest.approx(same)
    assert before == pytest.approx((159.5, 119.5), abs=1.0)
    assert held == pytest.approx(before, abs=0.2)
    assert abs(left - before).max() > 20


@needs_egl
def test_depth_is_the_distance_along_the_view_and_infinite_beyond_the_floor() -> None:
    # Images may be larger than MuJoCo's frame buffer by default.
    large = Camera(frame="base_link", view=(0.3, 0.0, 0.6, 0.3, 0.0, 2.0), width=1280, height=960)
    renderer = ArmRenderer(BARE, CAMERAS | {"up": large})
    renderer.set_bodies((box("cube", (0.3, 0.4, 0.05), 0.05),), {})
    depth_m = renderer.depth_m("above")
    assert depth_m.shape == (120, 160)
    assert depth_m[60, 80] == pytest.approx(0.5, abs=0.001)
    # The distance of the floor, not the way to its corners in the image, which is longer.
    assert depth_m.max() == pytest.approx(0.6, abs=0.001)
    assert np.isinf(renderer.depth_m("up")).all()
    assert [renderer.image(name).shape for name in ("above", "up")] == [(120, 160, 3), (960, 1280, 3)]


def test_a_camera_on_no_link_and_a_machine_without_opengl_get_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DescriptionError, match="camera 'top' is on the link 'hand', which the arm does not have"):
        ArmRenderer(BARE, {"top": Camera(frame="hand", view=(0.1, 0.1, 0.1, 0.0, 0.0, 0.0))})

    def refuse(*_: object) -> None:
        raise AttributeError("no EGL")

    monkeypatch.setattr(mujoco, "Renderer", refuse, raising=False)
    with pytest.raises(RenderingError, match=r"images need OpenGL off screen: .* \(no EGL\)"):
        ArmRenderer(BARE, CAMERAS)
