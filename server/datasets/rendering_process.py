"""Process that renders cameras: it takes scenes, and sends the messages of their images back."""

from __future__ import annotations

import logging

from robot.channel import Channel, channel_of_child
from robot.errors import RobotError
from server.datasets.rendered import CannotRender, LoadCameras, Rendered, RenderedCameras
from server.errors import ServerError


def serve(channel: Channel) -> None:
    """Render until the server closes its end."""
    # Its lines are about optional modules.
    logging.getLogger("OpenGL").setLevel(logging.WARNING)
    load: LoadCameras | None = channel.receive_first()
    if load is None:
        return
    try:
        cameras = RenderedCameras(load.robot, load.cameras)
    except (RobotError, ServerError) as error:
        channel.send(CannotRender(str(error)))
        return
    channel.send(Rendered())
    while not channel.closed:
        for order in channel.receive(None):
            channel.send(Rendered(cameras.messages(order.scene, order.topics)))


if __name__ == "__main__":
    serve(channel_of_child())
