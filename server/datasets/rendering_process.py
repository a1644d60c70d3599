"""Process that renders cameras: it takes scenes, and sends the messages of their images back."""

import logging

from robot.channel import Channel, channel_of_child
from robot.errors import RobotError
from server.datasets.rendered import CannotRender, Render, Rendered, RenderedCameras
from server.errors import ServerError


def serve(channel: Channel) -> None:
    """Render until the server closes its end."""
    cameras: RenderedCameras | None = None
    while not channel.closed:
        for order in channel.receive(None):
            if cameras is not None and isinstance(order, Render):
                channel.send(Rendered(cameras.messages(order.scene, order.topics)))
                continue
            try:
                if cameras is not None:
                    cameras.close()
                cameras = RenderedCameras(order.robot, order.cameras)
            except (RobotError, ServerError) as error:
                channel.send(CannotRender(str(error)))
                return
            channel.send(Rendered())


if __name__ == "__main__":
    # The lines of OpenGL are about optional modules; the arm process has logged the warnings of the physics.
    for name, level in (("OpenGL", logging.WARNING), ("armbridge.physics", logging.ERROR)):
        logging.getLogger(name).setLevel(level)
    serve(channel_of_child())
