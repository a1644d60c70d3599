"""Client that renders the arm and the scene of a server elsewhere: ``armbridge camera physics``."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from websockets.asyncio.client import ClientConnection

from robot.description import robot_folder
from robot.description.model import RobotModel
from server.datasets.rendered import NS_PER_S, PublishedCamera, RenderedCameras, SeenScene, color_of, read_camera
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import read_collision_object
from server.moveit.scene.physical_bodies import body_of
from server.publishing_client import PublishedTopic, PublishingClient

ANSWER_TIMEOUT_S = 10.0

# moveit_msgs/PlanningSceneComponents: attached objects, geometry and colours. The scene's state has the joints' goals.
REQUEST = {"components": {"components": 4 | 16 | 512}}
CALL = {"op": "call_service", "service": "/get_planning_scene", "args": REQUEST, "id": "camera"}

# A state is dropped for the next one while an image is rendered.
SUBSCRIPTION = {"op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState", "queue_length": 1}


def open_camera(name_or_folder: str, topic: str, quality: int, **settings: Any) -> tuple[RobotModel, PublishedCamera]:
    """Return an arm and a camera on it by the keys of :class:`Camera`; raises CameraError for a wrong value."""
    robot = robot_folder.resolve(name_or_folder).model
    return robot, PublishedCamera(read_camera(robot, settings), topic, quality)


class RenderingClient(PublishingClient):
    """Client that renders the arm and the scene of a server, and publishes the images there."""

    max_answer_bytes = 64 << 20  # a scene of meshes

    def __init__(
        self, target: PublishedTopic, robot: RobotModel, published: PublishedCamera, tell: Callable[[str], None]
    ) -> None:
        super().__init__(target, published.topics, tell)
        self._camera = published
        self._cameras = RenderedCameras(robot, [published])

    async def announce(self, connection: ClientConnection) -> None:
        await super().announce(connection)
        await connection.send(json.dumps(SUBSCRIPTION))

    async def listen(self, connection: ClientConnection) -> None:
        """Leave the server's messages to :meth:`publish`."""

    async def publish(self, connection: ClientConnection) -> None:
        """Publish an image of each state that is the newest when the last image has been taken."""
        try:
            await self._publish(connection)
        except (KeyError, TypeError) as error:
            raise ConnectionError(f"the server's answer cannot be read: {error!r}") from error

    async def _publish(self, connection: ClientConnection) -> None:
        loop, period_s = asyncio.get_running_loop(), 1.0 / self._camera.camera.rate_hz
        due_s, state = loop.time(), None
        while True:
            # The server has taken an image when it answers the next call: a slow network gets fewer.
            before, (state, scene) = state, await self._seen(connection, state)
            if state is not None and state is not before:
                for topic, message in self._cameras.messages(_read_scene(state, scene), self._camera.topics):
                    await self.send(connection, message, topic)
                self.published += 1
            due_s = max(due_s + period_s, loop.time())
            await asyncio.sleep(due_s - loop.time())

    async def _seen(self, connection: ClientConnection, state: Message | None) -> tuple[Message | None, Message]:
        """Return the newest sensor_msgs/JointState, which may be the one given, and the moveit_msgs/PlanningScene."""
        await connection.send(json.dumps(CALL))
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            while (answer := json.loads(await connection.recv())).get("id") != CALL["id"]:
                self.complain(answer)
                state = answer.get("msg") if answer["op"] == "publish" else state
        if not answer["result"]:
            raise ConnectionError(f"the planning scene is refused: {answer['values']}")
        return state, answer["values"]["scene"]


def _read_scene(state: Message, scene: Message) -> SeenScene:
    stamp = state["header"]["stamp"]
    read = [(read_collision_object(each, "", "object"), "") for each in scene["world"]["collision_objects"]]
    held = scene["robot_state"]["attached_collision_objects"]
    read += [(read_collision_object(each["object"], each["link_name"], "object"), each["link_name"]) for each in held]
    return SeenScene(
        stamp["sec"] * NS_PER_S + stamp["nanosec"],
        dict(zip(state["name"], state["position"], strict=True)),
        [(body_of(each), link) for each, link in read],
        {each["id"]: color_of(each["color"]) for each in scene["object_colors"]},
    )
