"""Rendered cameras: messages with images of a simulated arm and the objects of its planning scene."""

import base64
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from planners.scene import Pose
from robot.description.camera import Camera
from robot.description.model import RobotModel
from robot.physics.bodies import MAX_BODIES, Body
from server.datasets.camera import IMAGE_TYPE, CameraError, to_jpeg
from server.errors import sentence_of
from server.moveit.messages import Message
from server.moveit.scene.frames import in_root

DEPTH_TYPE, INFO_TYPE = "sensor_msgs/Image", "sensor_msgs/CameraInfo"

QUALITY = 80  # of JPEG

MM_PER_M = 1000.0
MAX_DEPTH_MM = 65_535  # largest value of an image with 16 bits

NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class PublishedCamera:
    """Camera, and the topic of its JPEG images, such as ``/wrist/image/compressed``."""

    camera: Camera
    topic: str

    @property
    def namespace(self) -> str:
        """Namespace of its topics, such as ``/wrist``."""
        return self.topic.removesuffix("/compressed").rpartition("/")[0]

    @property
    def info_topic(self) -> str:
        return f"{self.namespace}/camera_info"

    @property
    def topics(self) -> dict[str, str]:
        """Types of its topics by name: images, their sensor_msgs/CameraInfo, and depth images if it has them."""
        topics = {self.topic: IMAGE_TYPE, self.info_topic: INFO_TYPE}
        return topics | ({f"{self.namespace}/depth/image": DEPTH_TYPE} if self.camera.depth else {})

    @property
    def optical_frame(self) -> str:
        """Name of its frame with z along the view, x right and y down in the image (REP 103)."""
        return f"{self.namespace.strip('/').replace('/', '_') or 'camera'}_optical_frame"


def read_camera(robot: RobotModel, settings: Mapping[str, object]) -> Camera:
    """Return a camera on an arm by the keys of :class:`Camera`; raises CameraError for a wrong value."""
    frame = settings.get("frame") or robot.root_link
    if frame not in robot.links:
        raise CameraError(f"frame: the arm has no link {frame!r}")
    try:
        return Camera.model_validate({**settings, "frame": frame})
    except ValidationError as error:
        flaw = error.errors(include_url=False)[0]
    raise CameraError(f"{flaw['loc'][0]}: {sentence_of(flaw)}, not {flaw['input']}")


@dataclass(frozen=True)
class SeenScene:
    """Arm and objects at one time; an object is at its pose in a link, and in the root link for an empty name."""

    stamp_ns: int  # [ns since the epoch]
    positions_rad: Mapping[str, float]
    bodies: Sequence[tuple[Body, str]]
    colors: Mapping[str, Sequence[float]]  # red, green, blue, alpha by object


@dataclass(frozen=True)
class LoadCameras:
    """First message to the process, and its cameras later; :class:`Rendered` or :class:`CannotRender` answers it."""

    robot: RobotModel
    cameras: Sequence[PublishedCamera]


@dataclass(frozen=True)
class Render:
    """Order to make the messages of some topics; :class:`Rendered` answers it."""

    topics: Sequence[str]
    scene: SeenScene


@dataclass(frozen=True)
class Rendered:
    """Messages by topic; the process is ready for the next order."""

    messages: Sequence[tuple[str, Message]] = ()


@dataclass(frozen=True)
class CannotRender:
    """Reason for which this machine can never render these cameras, as a sentence; the process ends."""

    reason: str


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
        """Return the messages of some topics, each with its topic and the scene's stamp."""
        self._renderer.place(scene.positions_rad)
        bodies = tuple(self._in_root(*each) for each in scene.bodies[:MAX_BODIES])
        self._renderer.set_bodies(bodies, scene.colors)
        sec, nanosec = divmod(scene.stamp_ns, NS_PER_S)
        messages: list[tuple[str, Message]] = []
        for camera in self._cameras.values():
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": camera.optical_frame}
            for topic, type_name in camera.topics.items():
                if topic in topics:
                    messages.append((topic, {"header": header, **self._contents(camera, type_name)}))
        return messages

    def close(self) -> None:
        """Give the OpenGL contexts back."""
        self._renderer.close()

    def _in_root(self, body: Body, link: str) -> Body:
        if not link:
            return body
        pose = in_root(Pose(*self._renderer.link_pose(link)), Pose(body.position_m, body.orientation))
        return replace(body, position_m=pose.position_m, orientation=pose.orientation)

    def _contents(self, published: PublishedCamera, type_name: str) -> Message:
        if type_name == INFO_TYPE:
            return camera_info(published.camera)
        if type_name == DEPTH_TYPE:
            return _depth_image(self._renderer.depth_m(published.topic))
        jpeg = to_jpeg(self._renderer.image(published.topic), None, QUALITY)
        return {"format": "jpeg", "data": base64.b64encode(jpeg).decode()}


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
    return {**size, "encoding": "16UC1", "is_bigendian": 0, "data": base64.b64encode(pixels.tobytes()).decode()}


def color_of(message: Message) -> tuple[float, ...]:
    """Return red, green, blue and alpha of a std_msgs/ColorRGBA."""
    return tuple(message[part] for part in "rgba")
