"""Cameras of ``robot.toml``: images of an arm with physics, rendered by a process of its own for subscribers."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Sequence
from dataclasses import replace

from robot.messages import ArmState
from robot.physics.bodies import Body
from robot.processes import Child, RestartDelay, StartedChild
from server.datasets.rendered import (
    NS_PER_S,
    CannotRender,
    LoadCameras,
    PublishedCamera,
    Render,
    Rendered,
    SeenScene,
    color_of,
)
from server.features.context import ServerContext
from server.features.physics import Physics
from server.graph.node import Node
from server.lifecycle import Feature
from server.moveit.messages import pose_of, write_transform
from server.moveit.scene.collision_objects import CollisionObject
from server.moveit.scene.physical_bodies import body_of
from server.moveit.services.description import STATIC_TRANSFORMS_TOPIC

MODULE = "server.datasets.rendering_process"
NICENESS = 5  # rendering gives way to the servo loop and the server

# A process loads in a second and renders an image in 20 ms, on a busy machine in seconds.
SILENT_S = 30.0

MAX_FAILURES = 5  # ends of the process in a row without an image, after which it is not started again

log = logging.getLogger("armbridge.cameras")


def cameras_of(context: ServerContext, physics: Sequence[Feature]) -> list[Feature]:
    """Return the cameras of a server whose arm has physics."""
    cameras = [
        (f"{each.graph.resolve('')}/{name}/image/compressed", camera)
        for each, _ in context.single_arms
        for name, camera in each.served.description.cameras.items()
    ]
    of_physics = [each for each in physics if isinstance(each, Physics)]
    if not (cameras and of_physics):
        return []
    return [Cameras(context, of_physics[0], [PublishedCamera(camera, topic) for topic, camera in cameras])]


class Cameras(Feature):
    """Cameras that see the measured arm and the objects of the scene, at their rates by the arm's clock."""

    name = "the cameras"
    deadline_s = 0.3

    def __init__(self, context: ServerContext, physics: Physics, cameras: Sequence[PublishedCamera]) -> None:
        self._robot = context.whole.robot
        self._scene = context.planning.scene_state
        self._graph = context.graph
        self._physics = physics
        self._cameras = cameras
        self._node = Node("cameras")
        self._due_s = {each.topic: -math.inf for each in cameras}
        self._bodies: dict[str, tuple[CollisionObject, Body]] = {}
        self._child: Child | None = None
        self._ready = False  # True while the process waits for a scene
        self._ordered_at_s = 0.0
        self._failures = 0
        self._over = False  # True from the stop on, and where no image can come
        self._restart: asyncio.Task[None] | None = None
        self._restart_delay = RestartDelay()
        for camera in cameras:
            for topic, type_name in camera.topics.items():
                context.graph.advertise(self._node, topic, type_name)

    async def start(self) -> None:
        """Start the process, and publish the optical frames with the arm's fixed frames, which are latched together."""
        latched = self._graph.latched(STATIC_TRANSFORMS_TOPIC)
        known = [] if latched is None else latched.msg["transforms"]
        own = [
            {
                "header": {"stamp": self._graph.message_types.now().as_message(), "frame_id": each.camera.frame},
                "child_frame_id": each.optical_frame,
                "transform": write_transform(pose_of(each.camera.transform_optical_to_frame)),
            }
            for each in self._cameras
        ]
        self._graph.publish(self._node, STATIC_TRANSFORMS_TOPIC, {"transforms": [*known, *own]}, latch=True)
        await self._launch()

    async def stop(self) -> None:
        """End the process."""
        self._over = True
        if (restart := self._restart) is not None:
            restart.cancel()
            await asyncio.wait([restart])
        if self._child is not None:
            await self._child.kill()

    @property
    def observes_states(self) -> bool:
        return any(map(self._is_watched, self._cameras))

    def on_state(self, arm: str, state: ArmState) -> None:
        """Order the images that are due."""
        if arm or state.position_rad is None or self._child is None or self._over or self._restart is not None:
            return
        if not self._ready:
            if time.monotonic() - self._ordered_at_s > SILENT_S:
                log.warning("the process of the cameras has been silent for %g s and is ended", SILENT_S)
                self._restart = asyncio.create_task(self._start_again(self._child), name="restart cameras")
            return
        due = [each for each in self._cameras if self._is_watched(each) and self._is_due(each, state)]
        # The info goes along, since users of a recording need it.
        wanted = {each.info_topic for each in due}
        topics = [topic for each in due for topic in each.topics if topic in wanted or self._graph.subscribers(topic)]
        if topics:
            self._send(self._child, Render(topics, self._seen(state, state.position_rad.tolist())))

    def _is_watched(self, camera: PublishedCamera) -> bool:
        return any(map(self._graph.subscribers, camera.topics))

    def _is_due(self, camera: PublishedCamera, state: ArmState) -> bool:
        """Return True for an image that is due, and set the time of the next one."""
        clock_s, due_s, period_s = state.clock_s, self._due_s[camera.topic], 1.0 / camera.camera.rate_hz
        # The clock of an arm process that has started again may be behind.
        if due_s - period_s <= clock_s < due_s:
            return False
        # States come at their own rate: the mean of the intervals is the period.
        self._due_s[camera.topic] = (due_s if due_s <= clock_s < due_s + period_s else clock_s) + period_s
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

    async def _launch(self) -> None:
        self._ordered_at_s = time.monotonic()
        child = self._child = Child(StartedChild(MODULE), self._received, self._exited, niceness=NICENESS)
        await child.connect()
        self._send(child, LoadCameras(self._robot, self._cameras))

    def _send(self, child: Child, message: object) -> None:
        self._ready, self._ordered_at_s = False, time.monotonic()
        child.send(message)

    def _received(self, message: CannotRender | Rendered) -> None:
        if isinstance(message, CannotRender):
            log.error("the cameras show nothing: %s", message.reason)
            self._over = True
            return
        for topic, each in message.messages:
            self._failures = 0
            self._graph.publish(self._node, topic, each)
        self._ready = True

    def _exited(self) -> None:
        self._ready = False
        if not self._over and self._restart is None and self._child is not None:
            self._restart = asyncio.create_task(self._start_again(self._child), name="restart cameras")

    async def _start_again(self, ended: Child) -> None:
        ran_s = time.monotonic() - self._ordered_at_s
        await ended.kill()
        try:
            while True:
                self._failures += 1
                if self._failures >= MAX_FAILURES:
                    log.error("the cameras show nothing: their process has ended %d times in a row", MAX_FAILURES)
                    self._over = True
                    return
                log.warning("the process of the cameras ended (%s); starting it again", ended.ending)
                await asyncio.sleep(self._restart_delay.after(ran_s))
                try:
                    await self._launch()
                except OSError as error:
                    log.warning("the process of the cameras cannot be started: %s", error)
                    ran_s = 0.0
                else:
                    return
        finally:
            self._restart = None
