"""Images of a simulated arm and the bodies around it, by MuJoCo's renderer off screen."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from robot.description.camera import Camera
from robot.description.model import RobotModel
from robot.errors import RobotError
from robot.physics.bodies import Body, Point, Quaternion, SetBodies
from robot.physics.world import World

NO_RENDERER = "images need OpenGL off screen: EGL (Debian: libegl1), or OSMesa (libosmesa6) and MUJOCO_GL=osmesa"


class RenderingError(RobotError):
    """Machine that cannot render; the text is one sentence."""


class ArmRenderer:
    """Cameras that see one arm at given positions; raises RenderingError on a machine without OpenGL.

    It belongs to the thread that makes it, as OpenGL's contexts do.
    """

    def __init__(self, robot: RobotModel, cameras: Mapping[str, Camera]) -> None:
        self.cameras = cameras
        self._joint_names = tuple(joint.name for joint in robot.movable_joints)
        self._world = World(robot, self._joint_names, np.zeros(len(self._joint_names)), cameras)
        self._bodies: tuple[Body, ...] = ()
        # By width and height: cameras of one size share a frame buffer.
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}
        for camera in cameras.values():
            self._renderer(camera)

    def link_pose(self, link: str) -> tuple[Point, Quaternion]:
        """Return position [m] and orientation of a link where the joints are."""
        return self._world.pose(link)

    def place(self, positions_rad: Mapping[str, float]) -> None:
        """Move the joints [rad or m]; a joint without a position goes to zero."""
        self._world.place(np.array([positions_rad.get(name, 0.0) for name in self._joint_names]))

    def set_bodies(self, bodies: tuple[Body, ...], colors: Mapping[str, Sequence[float]]) -> None:
        """Put bodies around the arm, with colours by name as red, green, blue, alpha."""
        if bodies != self._bodies:
            before, self._bodies = self._world.model, bodies
            self._world.set_bodies(SetBodies(0, bodies))
            if self._world.model is not before:
                self.close()
        self._world.color(colors)

    def image(self, camera: str) -> NDArray[np.uint8]:
        """Return a camera's image: red, green and blue, shape (height, width, 3)."""
        renderer = self._renderer(self.cameras[camera])
        renderer.update_scene(self._world.data, camera)
        pixels: NDArray[np.uint8] = renderer.render()
        return pixels

    def depth_m(self, camera: str) -> NDArray[np.float32]:
        """Return the distances along a camera's view [m], shape (height, width); infinite where it sees nothing."""
        renderer = self._renderer(self.cameras[camera])
        renderer.enable_depth_rendering()
        try:
            renderer.update_scene(self._world.data, camera)
            depth_m: NDArray[np.float32] = renderer.render()
        finally:
            renderer.disable_depth_rendering()
        far_m = self._world.model.vis.map.zfar * self._world.model.stat.extent
        return np.where(depth_m < 0.999 * far_m, depth_m, np.float32(np.inf))

    def close(self) -> None:
        """Give the OpenGL contexts back."""
        while self._renderers:
            self._renderers.popitem()[1].close()

    def _renderer(self, camera: Camera) -> mujoco.Renderer:
        size = camera.width, camera.height
        if size not in self._renderers:
            try:
                self._renderers[size] = mujoco.Renderer(self._world.model, camera.height, camera.width)
            except Exception as error:  # OpenGL's libraries raise AttributeError, ImportError, RuntimeError and others
                raise RenderingError(f"{NO_RENDERER} ({error})") from error
        return self._renderers[size]
