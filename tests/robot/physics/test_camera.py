"""The pinhole camera on a link."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from robot.physics.arm_model import add_camera, arm_model, compiled
from robot.physics.camera import Camera, RenderingError
from robot.physics.renderer import ArmRenderer
from tests.helpers.robots import so101


def test_the_image_is_upright_and_shows_its_target_in_the_middle() -> None:
    camera = Camera("base_link", (0.5, 0.0, 0.2), (0.0, 0.0, 0.2), 320, 240)
    assert camera.axes == pytest.approx(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    below = Camera("base_link", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0), 320, 240)
    assert below.axes[:, 2] == pytest.approx([0.0, 0.0, 1.0])
    assert np.linalg.det(below.axes) == pytest.approx(1.0)


def test_a_point_at_the_upper_edge_is_half_the_field_of_view_above_the_middle() -> None:
    camera = Camera("base_link", (0.5, 0.0, 0.2), (0.0, 0.0, 0.2), 320, 240, field_of_view_deg=90.0)
    assert camera.focal_px == pytest.approx(120.0)


def test_a_camera_that_looks_at_itself_or_is_on_no_link_is_refused() -> None:
    with pytest.raises(RenderingError, match="must look at another point"):
        add_camera(arm_model(so101()), Camera("base_link", (0.1, 0.1, 0.1), (0.1, 0.1, 0.1), 320, 240))
    with pytest.raises(RenderingError, match="there is no link 'hand' for the camera"):
        add_camera(arm_model(so101()), Camera("hand", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), 320, 240))


def test_a_camera_moves_with_its_link() -> None:
    spec = arm_model(so101())
    add_camera(spec, Camera("gripper_link", (0.0, 0.06, 0.0), (0.0, 0.0, -0.12), 320, 240))
    model = compiled(spec)
    assert model.ncam == 1
    assert model.body(model.cam_bodyid[0]).name == "gripper_link"


def test_a_machine_without_opengl_gets_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AttributeError("no EGL")

    monkeypatch.setattr(mujoco, "Renderer", refuse, raising=False)
    with pytest.raises(RenderingError, match=r"images need OpenGL off screen: .* \(no EGL\)"):
        ArmRenderer(so101(), Camera("base_link", (0.5, 0.0, 0.2), (0.0, 0.0, 0.2), 320, 240))
