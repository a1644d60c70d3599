"""The process that renders cameras."""

from __future__ import annotations

from typing import Any, cast

from server.datasets.rendered import LoadCameras, PublishedCamera
from server.datasets.rendering_process import serve
from tests.helpers.robots import so101
from tests.server.datasets.test_rendered import CAMERA


class FakeChannel:
    """The process's end of its channel."""

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
    channel = FakeChannel(LoadCameras(so101(), [nowhere]))
    serve(cast(Any, channel))
    assert [each.reason for each in channel.sent] == [
        "camera '/front/image/compressed' is on the link 'hand', which the arm does not have"
    ]
    gone = FakeChannel(None)
    serve(cast(Any, gone))
    assert gone.sent == []
