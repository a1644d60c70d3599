"""Cameras of ``robot.toml``: images of an arm with physics, rendered by a process of its own for subscribers."""

import asyncio
import logging
import math
import re
import time
from collections.abc import Collection, Sequence
from dataclasses import replace

from robot.description.camera import CAMERA_NAME, MAX_CAMERAS
from robot.messages import ArmState
from robot.physics.bodies import Body
from robot.processes import Child, RestartDelay, StartedChild
from server.datasets.camera import CameraError
from server.datasets.rendered import (
    INFO_TYPE,
    NS_PER_S,
    CannotRender,
    LoadCameras,
    PublishedCamera,
    Render,
    Rendered,
    SeenScene,
    camera_info,
    color_of,
    read_camera,
)
from server.errors import GraphError
from server.features.context import ServerContext
from server.features.physics import Physics, body_of
from server.graph.permissions import WORKING
from server.graph.topics import LocalNode
from server.lifecycle import Feature, end_task
from server.moveit.messages import Message, pose_of, write_transform
from server.moveit.scene.collision_objects import CollisionObject
from server.moveit.services.description import STATIC_TRANSFORMS_TOPIC

MODULE = "server.datasets.rendering_process"
NICENESS = 5  # rendering gives way to the servo loop and the server

# A process loads in a second and renders an image in 20 ms, on a busy machine in seconds.
SILENT_S = 30.0

# Time without a subscriber of images after which the process ends: a page that is loaded again finds it running.
IDLE_S = 30.0

MAX_FAILURES = 5  # ends of the process in a row without an image, after which it is not started again

log = logging.getLogger("armbridge.cameras")


def cameras_of(context: ServerContext, physics: Sequence[Feature]) -> list[Feature]:
    """Return the cameras of a server whose arm has physics."""
    cameras = [
        PublishedCamera(camera, f"{each.graph.resolve('')}/{name}/image/compressed")
        for each, _ in context.single_arms
        for name, camera in each.served.description.cameras.items()
    ]
    return [Cameras(context, each, cameras) for each in physics if isinstance(each, Physics)]


class Cameras(Feature):
    """Cameras that see the measured arm and the objects of the scene, at their rates by the arm's clock.

    Their process runs while images have subscribers, or may be recorded: the arm and OpenGL take 200 MB there.
    """

    name = "the cameras"
    deadline_s = 0.3

    def __init__(self, context: ServerContext, physics: Physics, cameras: Sequence[PublishedCamera]) -> None:
        self._robot = context.whole.robot
        self._scene = context.planning.scene_state
        self._graph = context.graph
        self._physics = physics
        # An episode that is recorded must not wait for its first images.
        self._recorded = context.settings.recording.file is not None
        self._cameras: dict[str, PublishedCamera] = {}  # by name
        self._node = context.graph.node("cameras")
        self._nodes: dict[str, LocalNode] = {}  # publishers of the cameras, by name
        self._due_s: dict[str, float] = {}  # by name
        self._bodies: dict[str, tuple[CollisionObject, Body]] = {}
        self._child: Child | None = None
        self._loaded: Sequence[PublishedCamera] = ()  # cameras that the process has
        self._ready = False  # True while the process waits for a scene
        self._ordered_at_s = self._watched_at_s = 0.0
        self._failures = 0
        self._over = False  # True from the stop on, and after a failure
        self._failure = ""  # reason for which no image can come; empty for none
        self._process: asyncio.Task[None] | None = None
        self._ended = asyncio.Event()
        self._restart_delay = RestartDelay()
        for each in cameras:
            self._put(each.namespace.strip("/"), each)
        self._node.offer("/simulation/set_camera", "armbridge_msgs/srv/SetCamera", self._set, rule=WORKING)

    async def start(self) -> None:
        self._publish_frames(())

    async def stop(self) -> None:
        self._over = True
        await end_task(self._process)

    @property
    def observes_states(self) -> bool:
        return any(any(map(self._graph.subscribers, each.topics)) for each in self._cameras.values())

    def on_state(self, arm: str, state: ArmState) -> None:
        """Publish the infos that are due, and order their images."""
        if arm or state.position_rad is None or self._over:
            return
        watched = {name: self._watched_images(each) for name, each in self._cameras.items()}
        self._keep_process(watched=self._recorded or any(watched.values()))
        sec, nanosec = divmod(round(state.stamp_s * NS_PER_S), NS_PER_S)
        ordered: list[str] = []
        for name, each in self._cameras.items():
            # An image that waits for the process is due when the process is ready.
            waits = bool(watched[name]) and not self._ready
            if not waits and (watched[name] or self._graph.subscribers(each.info_topic)) and self._is_due(name, state):
                # The info goes along with an image, since users of a recording need it.
                header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": each.optical_frame}
                self._nodes[name].publish(each.info_topic, {"header": header, **camera_info(each.camera)})
                ordered += watched[name]
        if ordered:
            self._send(Render(ordered, self._seen(state, state.position_rad.tolist())))

    def _watched_images(self, camera: PublishedCamera) -> list[str]:
        return [name for name, kind in camera.topics.items() if kind != INFO_TYPE and self._graph.subscribers(name)]

    def _keep_process(self, *, watched: bool) -> None:
        """Start the process for the first subscriber, load its cameras, and end it when it is silent or idle."""
        now_s = time.monotonic()
        if watched:
            self._watched_at_s = now_s
            if self._process is None or self._process.done():
                self._process = asyncio.create_task(self._render(), name="cameras")
        if self._child is None:
            return
        cameras = tuple(self._cameras.values())
        if self._ready and self._loaded != cameras:
            self._loaded = cameras
            self._send(LoadCameras(self._robot, cameras))
        if self._is_idle():
            self._ended.set()
        elif not self._ready and now_s - self._ordered_at_s > SILENT_S:
            log.warning("the process of the cameras has been silent for %g s and is ended", SILENT_S)
            self._ended.set()

    def _is_idle(self) -> bool:
        return time.monotonic() - self._watched_at_s > IDLE_S

    def _is_due(self, name: str, state: ArmState) -> bool:
        """Return True for an image that is due, and set the time of the next one."""
        clock_s, due_s, period_s = state.clock_s, self._due_s[name], 1.0 / self._cameras[name].camera.rate_hz
        # The clock of an arm process that has started again may be behind.
        if due_s - period_s <= clock_s < due_s:
            return False
        # States come at their own rate: the mean of the intervals is the period.
        self._due_s[name] = (due_s if due_s <= clock_s < due_s + period_s else clock_s) + period_s
        return True

    def _seen(self, state: ArmState, positions: list[float]) -> SeenScene:
        contents = self._scene.contents
        objects = {**contents.objects, **{name: each.collision_object for name, each in contents.attached.items()}}
        self._bodies = {name: self._body_of(each) for name, each in objects.items()}
        links = {name: each.link for name, each in contents.attached.items()}
        seen = []
        for name, (_, body) in self._bodies.items():
            if moved := self._physics.body_states.get(name):
                seen.append((replace(body, position_m=moved.position_m, orientation=moved.orientation), ""))
            else:
                seen.append((body, links.get(name, "")))
        colors = {name: color_of(color) for name, color in contents.colors.items()}
        positions_rad = dict(zip(state.joint_names, positions, strict=True))
        return SeenScene(round(state.stamp_s * NS_PER_S), positions_rad, seen, colors)

    def _body_of(self, each: CollisionObject) -> tuple[CollisionObject, Body]:
        """Return an object with its body, whose shapes are converted once."""
        before = self._bodies.get(each.name)
        if before is None or before[0].shapes is not each.shapes:
            return each, body_of(each)
        if before[0] is each:
            return before
        pose = each.pose
        return each, replace(before[1], position_m=pose.position_m, orientation=pose.orientation)

    def _set(self, request: Message) -> str:
        name = request["name"]
        if self._failure:
            raise CameraError(self._failure)
        if name not in self._cameras and not re.fullmatch(CAMERA_NAME, name):
            raise CameraError(f"name must be at most 31 lower-case letters, digits and _, a letter first, not {name!r}")
        if name not in self._cameras and len(self._cameras) >= MAX_CAMERAS:
            raise CameraError(f"there are {MAX_CAMERAS} cameras at most: replace one, by its name")
        settings = {key: value for key, value in request.items() if value and key != "name"}
        camera = PublishedCamera(read_camera(self._robot, settings), f"/{name}/image/compressed")
        frames, replaced = {each.optical_frame for each in self._cameras.values()}, self._nodes.get(name)
        self._put(name, camera)
        if replaced is not None:
            self._graph.remove(replaced)
        self._publish_frames(frames)
        return f"{name} is on {', '.join(camera.topics)}"

    def _put(self, name: str, camera: PublishedCamera) -> None:
        """Offer the topics of a camera; raises GraphError where a client has given one of them another type."""
        node = self._graph.node(f"camera {name}")
        try:
            for topic, type_name in camera.topics.items():
                node.advertise(topic, type_name)
        except GraphError:
            self._graph.remove(node)
            raise
        self._cameras[name], self._nodes[name], self._due_s[name] = camera, node, -math.inf

    def _publish_frames(self, before: Collection[str]) -> None:
        """Publish the optical frames in place of the ones before, in the message that has the arm's fixed frames."""
        latched = self._graph.latched(STATIC_TRANSFORMS_TOPIC)
        known = [] if latched is None else latched.msg["transforms"]
        own = [
            {
                "header": {"stamp": self._graph.message_types.now().as_message(), "frame_id": each.camera.frame},
                "child_frame_id": each.optical_frame,
                "transform": write_transform(pose_of(each.camera.transform_optical_to_frame)),
            }
            for each in self._cameras.values()
        ]
        transforms = [each for each in known if each["child_frame_id"] not in before] + own
        self._node.publish(STATIC_TRANSFORMS_TOPIC, {"transforms": transforms}, latch=True)

    def _send(self, message: object) -> None:
        self._ready, self._ordered_at_s = False, time.monotonic()
        if self._child is not None:
            self._child.send(message)

    def _received(self, message: CannotRender | Rendered) -> None:
        if isinstance(message, CannotRender):
            self._give_up(message.reason)
            return
        for topic, each in message.messages:
            self._failures = 0
            # Its camera may have been replaced meanwhile by a camera without depth.
            if node := next((self._nodes[name] for name, now in self._cameras.items() if topic in now.topics), None):
                node.publish(topic, each)
        self._ready = True

    def _give_up(self, reason: str) -> None:
        self._over, self._failure = True, f"the cameras show nothing: {reason}"
        log.error(self._failure)

    async def _render(self) -> None:
        """Run the process while someone watches; start it again where it fails, a few times."""
        while True:
            started_at_s = time.monotonic()
            try:
                ending = await self._run_process()
            except OSError as error:
                ending = str(error)
            if self._over or self._is_idle():
                return
            self._failures += 1
            if self._failures >= MAX_FAILURES:
                self._give_up(f"their process has ended {MAX_FAILURES} times in a row")
                return
            log.warning("the process of the cameras ended (%s); starting it again", ending)
            await asyncio.sleep(self._restart_delay.after(time.monotonic() - started_at_s))

    async def _run_process(self) -> str:
        """Run the process to its end, or until it is to end; return how it ended."""
        self._ended.clear()
        child = Child(StartedChild(MODULE), self._received, self._ended.set, niceness=NICENESS)
        try:
            await child.connect()
            self._child, self._loaded = child, tuple(self._cameras.values())
            self._send(LoadCameras(self._robot, self._loaded))
            await self._ended.wait()
        finally:
            self._child, self._ready = None, False
            await child.kill()
        return child.ending
