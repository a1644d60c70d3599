"""Images of a simulated arm and the bodies around it, by MuJoCo's renderer off screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from robot.description.model import RobotModel
from robot.physics.arm_model import CAMERA
from robot.physics.bodies import Body, Point, Quaternion, SetBodies
from robot.physics.camera import Camera, RenderingError
from robot.physics.world import World
from robot.trajectory import Vector

NO_RENDERER = "images need OpenGL off screen: EGL (Debian: libegl1), or OSMesa (libosmesa6) and MUJOCO_GL=osmesa"


class ArmRenderer:
    """Renderer of one arm at given positions; raises RenderingError on a machine without OpenGL."""

    def __init__(self, robot: RobotModel, camera: Camera) -> None:
        self.camera = camera
        self.joint_names = tuple(joint.name for joint in robot.movable_joints)
        self._world = World(robot, self.joint_names, np.zeros(len(self.joint_names)), camera)
        self._bodies: tuple[Body, ...] = ()
        # Of the thread that renders: OpenGL's contexts belong to threads. Made once here, so that an error comes now.
        self._renderer: mujoco.Renderer | None = None
        self._prepared().close()

    def link_pose(self, link: str) -> tuple[Point, Quaternion]:
        """Return position [m] and orientation of a link where the joints are."""
        return self._world.link_pose(link)

    def place(self, position_rad: Vector) -> None:
        """Move the joints, in the order of ``joint_names`` [rad or m]."""
        self._world.place(position_rad)

    def render(self, bodies: tuple[Body, ...], colors: Mapping[str, Sequence[float]]) -> NDArray[np.uint8]:
        """Return the image, shape (height, width, 3), with colours of bodies by name as red, green, blue, alpha."""
        if bodies != self._bodies:
            before, self._bodies = self._world.model, bodies
            self._world.set_bodies(SetBodies(0, bodies))
            if self._world.model is not before:
                self.close()
        self._renderer = self._renderer or self._prepared()
        self._world.color(colors)
        self._renderer.update_scene(self._world.data, CAMERA)
        return self._renderer.render()

    def close(self) -> None:
        """Give the OpenGL context back, in the thread that renders."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None

    def _prepared(self) -> mujoco.Renderer:
        try:
            return mujoco.Renderer(self._world.model, self.camera.height, self.camera.width)
        except Exception as error:  # OpenGL's libraries raise AttributeError, ImportError, RuntimeError and others
            raise RenderingError(f"{NO_RENDERER} ({error})") from error
