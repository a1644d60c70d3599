"""Rendered camera: images of a server's simulated arm and of the objects of its planning scene."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from planners.scene import Pose
from robot.description import robot_folder
from robot.description.model import RobotModel
from robot.physics.bodies import MAX_BODIES, Body
from robot.physics.camera import Camera
from server.datasets.camera import CameraError, Pixels
from server.moveit.scene.collision_objects import read_collision_object
from server.moveit.scene.frames import in_root
from server.moveit.scene.physical_bodies import body_of

DEFAULT_WIDTH = 320

ANSWER_TIMEOUT_S = 10.0
RETRY_S = 1.0
MAX_ANSWER_BYTES = 64 << 20  # a scene of meshes

# moveit_msgs/PlanningSceneComponents: state, attached objects, geometry and colours.
COMPONENTS = 2 | 4 | 16 | 512


class RenderedSource:
    """Source of rendered images of a server's arm, each with the time of the state that it shows.

    The token belongs to a client that may look; None without one. Raises CameraError on a machine that cannot render.
    """

    paced = False
    finite = False

    def __init__(self, url: str, token: str | None, robot: RobotModel, camera: Camera) -> None:
        # MuJoCo reads it when it is imported, which is here for a command that need not have it.
        os.environ.setdefault("MUJOCO_GL", "egl")
        try:
            from robot.physics.renderer import ArmRenderer
        except (ImportError, AttributeError) as error:
            wanted = "rendering needs MuJoCo, pip install 'armbridge[physics]', and OpenGL off screen"
            raise CameraError(f"{wanted} ({error})") from error
        self.camera = camera
        self.stamp_ns: int | None = None
        self._renderer = ArmRenderer(robot, camera)
        self._url, self._token = url, token
        self._open = contextlib.ExitStack()
        self._connection: ClientConnection | None = None

    def read(self) -> Pixels | None:
        """Return the next image; wait for a server that does not answer, or not to this client."""
        while True:
            try:
                return self._rendered(self._scene())
            except (OSError, TimeoutError, WebSocketException, KeyError, TypeError):
                self._disconnect()
                time.sleep(RETRY_S)

    def close(self) -> None:
        """Leave the server."""
        self._renderer.close()
        self._disconnect()

    def _disconnect(self) -> None:
        self._connection = None
        self._open.close()

    def _scene(self) -> dict[str, Any]:
        if self._connection is None:
            opened = connect(self._url, max_size=MAX_ANSWER_BYTES, open_timeout=ANSWER_TIMEOUT_S)
            self._connection = self._open.enter_context(opened)
            if self._token is not None:
                self._connection.send(json.dumps({"op": "auth", "token": self._token}))
        request = {"components": {"components": COMPONENTS}}
        call = {"op": "call_service", "service": "/get_planning_scene", "args": request, "id": "camera"}
        self._connection.send(json.dumps(call))
        while (answer := json.loads(self._connection.recv(ANSWER_TIMEOUT_S))).get("id") != "camera":
            continue
        scene: dict[str, Any] = answer["values"]["scene"]
        return scene

    def _rendered(self, scene: Mapping[str, Any]) -> Pixels:
        state = scene["robot_state"]["joint_state"]
        at = dict(zip(state["name"], state["position"], strict=True))
        self._renderer.place(np.array([at.get(name, 0.0) for name in self._renderer.joint_names]))
        stamp = state["header"]["stamp"]
        self.stamp_ns = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
        bodies = [self._body(each, "") for each in scene["world"]["collision_objects"]]
        held = scene["robot_state"]["attached_collision_objects"]
        bodies += [self._body(each["object"], each["link_name"]) for each in held]
        colors = {each["id"]: [each["color"][part] for part in "rgba"] for each in scene["object_colors"]}
        return self._renderer.render(tuple(bodies[:MAX_BODIES]), colors)

    def _body(self, message: Mapping[str, Any], link: str) -> Body:
        """Return an object at its pose; as a movable one it can be placed without compiling the world again."""
        each = read_collision_object(message, link, "object")
        if link:
            each = replace(each, pose=in_root(Pose(*self._renderer.link_pose(link)), each.pose))
        return replace(body_of(each), movable=True)


def open_rendered(
    url: str, token: str | None, robot: str, link: str, view_m: Sequence[float], width: int | None
) -> RenderedSource:
    """Open a rendered camera at the first three numbers of a view that looks at the others, in a link's frame."""
    x, y, z, *target = view_m
    width = width or DEFAULT_WIDTH
    model = robot_folder.resolve(robot).model
    camera = Camera(link or model.root_link, (x, y, z), (target[0], target[1], target[2]), width, width * 3 // 4)
    return RenderedSource(url, token, model, camera)
