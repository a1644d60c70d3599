"""Rendered cameras."""

from __future__ import annotations

import base64
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from robot.description.camera import Camera
from robot.physics.bodies import Body, BodyShape
from server.datasets.rendered import LoadCameras, PublishedCamera, RenderedCameras, SeenScene
from server.datasets.rendering_process import serve as serve_images
from tests.helpers.rendering import needs_egl, red_pixels
from tests.helpers.robots import so101
from tests.server.datasets.test_camera import opened

LEVEL = (0.0, 0.0, 0.0, 1.0)
HERE = (0.0, 0.0, 0.0)
BETWEEN_FINGERS = (0.0, 0.0, -0.12)
VIEW = (0.6, -0.4, 0.4, 0.15, 0.0, 0.05)
CAMERA = PublishedCamera(Camera(frame="base_link", view=VIEW, depth=True), "/front/image/compressed")
AT = (0.3, 0.15, 0.02)


def box(link: str = "") -> tuple[Body, str]:
    shape = BodyShape("box", (0.02, 0.02, 0.02), HERE, LEVEL)
    return Body("box", (shape,), BETWEEN_FINGERS if link else AT, LEVEL), link


def red_of(image: dict[str, Any]) -> NDArray[np.int64]:
    """Return the red pixels of a sensor_msgs/CompressedImage, shape (n, 2)."""
    return red_pixels(np.asarray(opened(base64.b64decode(image["data"]))))


@needs_egl
def test_an_object_moves_with_the_link_that_holds_it_and_a_plane_hides_no_other_object() -> None:
    cameras = RenderedCameras(so101(), [CAMERA])
    ground = Body("ground", (BodyShape("plane", (), (0.0, 0.0, -0.1), LEVEL),), HERE, LEVEL), ""
    seen = []
    for angle_rad in (0.0, 0.5):
        each = SeenScene(0, {"shoulder_pan": angle_rad}, [ground, box("gripper_link")], {"box": (1.0, 0.0, 0.0, 1.0)})
        seen.append(red_of(cameras.messages(each, [CAMERA.topic])[0][1]))
    assert all(len(pixels) > 20 for pixels in seen)
    assert abs(seen[0].mean(axis=0) - seen[1].mean(axis=0)).max() > 10


@needs_egl
def test_image_info_and_depth_have_the_stamp_of_the_scene_and_the_optical_frame() -> None:
    seen = SeenScene(5_000_000_007, {}, [box()], {"box": (1.0, 0.0, 0.0, 1.0)})
    messages = dict(RenderedCameras(so101(), [CAMERA]).messages(seen, CAMERA.topics))
    topics = {"/front/image/compressed", "/front/camera_info", "/front/depth/image"}
    assert set(messages) == topics == set(CAMERA.topics)
    for message in messages.values():
        assert message["header"] == {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "front_optical_frame"}
    image, info, depth = messages.values()
    red = red_of(image)
    # The box is where K of the camera's info has it, at the distance that the depth image has there.
    transform = np.linalg.inv(CAMERA.camera.transform_optical_to_frame)
    in_camera_m = (transform @ (*AT, 1.0))[:3]
    pixel = np.reshape(info["k"], (3, 3)) @ in_camera_m / in_camera_m[2]
    assert red.mean(axis=0) == pytest.approx(pixel[:2], abs=1.0)
    assert np.reshape(info["p"], (3, 4))[:, :3] == pytest.approx(np.reshape(info["k"], (3, 3)))
    assert (info["width"], info["height"], info["distortion_model"], len(info["d"])) == (320, 240, "plumb_bob", 5)
    depth_mm = np.frombuffer(base64.b64decode(depth["data"]), "<u2").reshape(depth["height"], depth["width"])
    column, row = pixel[:2].round().astype(int)
    assert depth_mm[row, column] == pytest.approx(1000 * in_camera_m[2], abs=30)
    assert (depth["encoding"], depth["step"]) == ("16UC1", 640)
    assert depth_mm[0, 0] == 0, "the sky has no distance"


def test_without_depth_no_depth_is_published() -> None:
    plain = PublishedCamera(CAMERA.camera.model_copy(update={"depth": False}), "/camera/image/compressed")
    assert list(plain.topics) == ["/camera/image/compressed", "/camera/camera_info"]


# The process that renders.


class FakeChannel:
    """The process's end of its channel, which ends after one message."""

    def __init__(self, first: object) -> None:
        self.sent: list[Any] = []
        self.closed = first is None
        self._first = first

    def receive(self, _timeout_s: float | None) -> list[object]:
        self.closed = True
        return [self._first]

    def send(self, message: object) -> None:
        self.sent.append(message)


def test_the_process_reports_why_it_cannot_render() -> None:
    nowhere = PublishedCamera(CAMERA.camera.model_copy(update={"frame": "hand"}), CAMERA.topic)
    reason = "camera '/front/image/compressed' is on the link 'hand', which the arm does not have"
    for first, reasons in ((LoadCameras(so101(), [nowhere]), [reason]), (None, [])):
        channel = FakeChannel(first)
        serve_images(cast(Any, channel))
        assert [each.reason for each in channel.sent] == reasons
