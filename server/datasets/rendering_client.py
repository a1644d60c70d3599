"""Client that renders the arm and the scene of a server elsewhere: ``armbridge camera physics``."""

import json
import time
from collections.abc import Callable
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from robot.description import robot_folder
from robot.description.model import RobotModel
from server.datasets.rendered import NS_PER_S, PublishedCamera, RenderedCameras, SeenScene, color_of, read_camera
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import read_collision_object
from server.moveit.scene.physical_bodies import body_of
from server.publishing_client import complaint_of

ANSWER_TIMEOUT_S = 10.0
RETRY_S = 1.0
MAX_ANSWER_BYTES = 64 << 20  # a scene of meshes

# moveit_msgs/PlanningSceneComponents: attached objects, geometry and colours. The scene's state has the joints' goals.
COMPONENTS = 4 | 16 | 512
STATE_TOPIC = "/joint_states"


def open_camera(name_or_folder: str, topic: str, quality: int, **settings: Any) -> tuple[RobotModel, PublishedCamera]:
    """Return an arm and a camera on it by the keys of :class:`Camera`; raises CameraError for a wrong value."""
    robot = robot_folder.resolve(name_or_folder).model
    return robot, PublishedCamera(read_camera(robot, settings), topic, quality)


class RenderingClient:
    """Client that renders the arm and the scene of a server, and publishes the images there.

    The token belongs to a client that may publish; None without one.
    """

    def __init__(
        self, url: str, token: str | None, robot: RobotModel, published: PublishedCamera, tell: Callable[[str], None]
    ) -> None:
        self.published = 0
        self._url, self._token, self._camera, self._tell = url, token, published, tell
        self._cameras = RenderedCameras(robot, [published])
        self._told = ""

    def run(self) -> None:
        """Publish images until SIGINT, and connect again after each end of a connection, or a refusal."""
        while True:
            try:
                with connect(self._url, max_size=MAX_ANSWER_BYTES, open_timeout=ANSWER_TIMEOUT_S) as connection:
                    self._announce(connection)
                    self._publish(connection)
            except (OSError, TimeoutError, WebSocketException, KeyError, TypeError) as error:
                self._tell_once(f"{str(error) or type(error).__name__}; trying again every {RETRY_S:g} s")
                time.sleep(RETRY_S)

    def _announce(self, connection: ClientConnection) -> None:
        if self._token is not None:
            connection.send(json.dumps({"op": "auth", "token": self._token}))
        for topic, type_name in self._camera.topics.items():
            connection.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name}))
        # A state is dropped for the next one while an image is rendered.
        states = {"topic": STATE_TOPIC, "type": "sensor_msgs/JointState", "queue_length": 1}
        connection.send(json.dumps({"op": "subscribe", **states}))

    def _publish(self, connection: ClientConnection) -> None:
        due_s, period_s = time.monotonic(), 1.0 / self._camera.camera.rate_hz
        state: Message | None = None
        while True:
            # The server has taken an image when it answers the next call: a slow network gets fewer.
            before, (state, scene) = state, self._seen(connection, state)
            if state is not None and state is not before:
                for topic, message in self._cameras.messages(_read_scene(state, scene), self._camera.topics):
                    connection.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))
                self.published += 1
            due_s = max(due_s + period_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _seen(self, connection: ClientConnection, state: Message | None) -> tuple[Message | None, Message]:
        """Return the newest sensor_msgs/JointState, which may be the one given, and the moveit_msgs/PlanningScene."""
        request = {"components": {"components": COMPONENTS}}
        call = {"op": "call_service", "service": "/get_planning_scene", "args": request, "id": "camera"}
        connection.send(json.dumps(call))
        while (answer := json.loads(connection.recv(ANSWER_TIMEOUT_S))).get("id") != "camera":
            if answer["op"] == "publish":
                state = answer["msg"]
            elif complaint := complaint_of(answer):
                self._tell_once(complaint)
        return state, answer["values"]["scene"]

    def _tell_once(self, sentence: str) -> None:
        if sentence != self._told:
            self._told = sentence
            self._tell(f"{self._url}: {sentence}")


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
