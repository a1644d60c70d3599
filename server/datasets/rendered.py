"""Rendered cameras: messages with images of a simulated arm and the objects of its planning scene."""

from __future__ import annotations

import base64
import json
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from planners.scene import Pose
from robot.description import robot_folder
from robot.description.camera import Camera
from robot.description.model import RobotModel
from robot.physics.bodies import MAX_BODIES, Body
from server.datasets.camera import IMAGE_TYPE, CameraError, to_jpeg
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import read_collision_object
from server.moveit.scene.frames import in_root
from server.moveit.scene.physical_bodies import body_of
from server.publishing_client import complaint_of

DEPTH_TYPE, INFO_TYPE = "sensor_msgs/Image", "sensor_msgs/CameraInfo"

DEFAULT_QUALITY = 80  # of JPEG

MM_PER_M = 1000.0
MAX_DEPTH_MM = 65_535  # largest value of an image with 16 bits

NS_PER_S = 1_000_000_000

ANSWER_TIMEOUT_S = 10.0
RETRY_S = 1.0
MAX_ANSWER_BYTES = 64 << 20  # a scene of meshes

# moveit_msgs/PlanningSceneComponents: attached objects, geometry and colours. The scene's state has the joints' goals.
COMPONENTS = 4 | 16 | 512
STATE_TOPIC = "/joint_states"


@dataclass(frozen=True)
class PublishedCamera:
    """Camera, the topic of its JPEG images, such as ``/wrist/image/compressed``, and their quality from 1 to 95."""

    camera: Camera
    topic: str
    quality: int = DEFAULT_QUALITY

    @property
    def namespace(self) -> str:
        """Namespace of its topics, such as ``/wrist``."""
        return self.topic.removesuffix("/compressed").rpartition("/")[0]

    @property
    def topics(self) -> dict[str, str]:
        """Types of its topics by name: images, their sensor_msgs/CameraInfo, and depth images if it has them."""
        topics = {self.topic: IMAGE_TYPE, f"{self.namespace}/camera_info": INFO_TYPE}
        return topics | ({f"{self.namespace}/depth/image": DEPTH_TYPE} if self.camera.depth else {})

    @property
    def optical_frame(self) -> str:
        """Name of its frame with z along the view, x right and y down in the image (REP 103)."""
        return f"{self.namespace.strip('/').replace('/', '_') or 'camera'}_optical_frame"


@dataclass(frozen=True)
class SeenScene:
    """Arm and objects at one time; an object is at its pose in a link, and in the root link for an empty name."""

    stamp_ns: int  # [ns since the epoch]
    positions_rad: Mapping[str, float]
    bodies: Sequence[tuple[Body, str]]
    colors: Mapping[str, Sequence[float]]  # red, green, blue, alpha by object


class RenderedCameras:
    """Cameras that see a scene; raises CameraError, or another RobotError, where they cannot be rendered."""

    def __init__(self, robot: RobotModel, cameras: Sequence[PublishedCamera]) -> None:
        # MuJoCo reads it when it is imported, which is here for a command that need not have it.
        os.environ.setdefault("MUJOCO_GL", "egl")
        try:
            from robot.physics.renderer import ArmRenderer
        except (ImportError, AttributeError) as error:
            wanted = "rendering needs MuJoCo, pip install 'armbridge[physics]', and OpenGL off screen"
            raise CameraError(f"{wanted} ({error})") from error
        self._cameras = {each.topic: each for each in cameras}
        self._renderer = ArmRenderer(robot, {topic: each.camera for topic, each in self._cameras.items()})

    def messages(self, scene: SeenScene, topics: Collection[str]) -> list[tuple[str, Message]]:
        """Return the messages of cameras, by the topics of their images, each with its topic and the scene's stamp."""
        self._renderer.place(scene.positions_rad)
        bodies = tuple(self._in_root(*each) for each in scene.bodies[:MAX_BODIES])
        self._renderer.set_bodies(bodies, scene.colors)
        return [message for topic in topics for message in self._of_camera(self._cameras[topic], scene.stamp_ns)]

    def close(self) -> None:
        """Give the OpenGL contexts back."""
        self._renderer.close()

    def _in_root(self, body: Body, link: str) -> Body:
        """Return an object at its pose; as a movable one it can be placed without compiling the world again."""
        if link:
            pose = in_root(Pose(*self._renderer.link_pose(link)), Pose(body.position_m, body.orientation))
            body = replace(body, position_m=pose.position_m, orientation=pose.orientation)
        # MuJoCo has planes in bodies that stay where they are alone.
        return replace(body, movable=all(shape.kind != "plane" for shape in body.shapes))

    def _of_camera(self, published: PublishedCamera, stamp_ns: int) -> list[tuple[str, Message]]:
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": published.optical_frame}
        image = to_jpeg(self._renderer.image(published.topic), None, published.quality)
        messages: list[Message] = [
            {"header": header, "format": "jpeg", "data": image},
            {"header": header, **camera_info(published.camera)},
        ]
        if published.camera.depth:
            messages.append({"header": header, **_depth_image(self._renderer.depth_m(published.topic))})
        return list(zip(published.topics, messages, strict=True))


def camera_info(camera: Camera) -> Message:
    """Return the calibration of a camera without distortion as fields of a sensor_msgs/CameraInfo."""
    matrix = camera.intrinsic_matrix
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": matrix.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.column_stack((matrix, np.zeros(3))).ravel().tolist(),
    }


def _depth_image(depth_m: np.ndarray) -> Message:
    """Return fields of a sensor_msgs/Image of encoding 16UC1 in mm, 0 for no distance (REP 118)."""
    depth_mm = np.rint(np.where(np.isfinite(depth_m), MM_PER_M * depth_m, 0.0))
    pixels = np.where(depth_mm <= MAX_DEPTH_MM, depth_mm, 0.0).astype("<u2")
    height, width = pixels.shape
    size = {"height": height, "width": width, "step": pixels.itemsize * width}
    return {**size, "encoding": "16UC1", "is_bigendian": 0, "data": pixels.tobytes()}


def open_camera(name_or_folder: str, topic: str, quality: int, **settings: Any) -> tuple[RobotModel, PublishedCamera]:
    """Return an arm and a camera on it by the keys of :class:`Camera`; raises CameraError for a wrong value."""
    robot = robot_folder.resolve(name_or_folder).model
    try:
        camera = Camera(**{**settings, "frame": settings["frame"] or robot.root_link})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise CameraError(f"{first['loc'][0]}: {first['msg']}, not {first['input']}") from error
    return robot, PublishedCamera(camera, topic, quality)


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
                for topic, message in self._cameras.messages(_read_scene(state, scene), [self._camera.topic]):
                    operation = {"op": "publish", "topic": topic, "msg": message}
                    connection.send(json.dumps(operation, default=lambda octets: base64.b64encode(octets).decode()))
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


def color_of(message: Message) -> tuple[float, ...]:
    """Return red, green, blue and alpha of a std_msgs/ColorRGBA."""
    return tuple(message[part] for part in "rgba")
