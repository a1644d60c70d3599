"""Camera of an arm's description: a pinhole camera in the frame of a link."""

import math
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from robot.trajectory import Vector

MAX_CAMERAS = 8
CAMERA_NAME = r"^[a-z][a-z0-9_]{0,30}$"  # first part of names of topics

# Rendering and sending take time by the number of pixels; the server's loop copies each image.
MAX_WIDTH_PX, MAX_HEIGHT_PX = 1280, 960
MAX_RATE_HZ = 60.0

Coordinate: TypeAlias = Annotated[float, Field(ge=-100.0, le=100.0)]


class Camera(BaseModel):
    """Table ``[cameras.NAME]``: camera in the frame of a link, its image upright as far as the frame's z axis allows.

    Sides of images are even, as H.264 in datasets needs them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    frame: Annotated[str, Field(max_length=200)] = ""  # link that carries it; the root link without this key
    # Place of the camera, and the point in the middle of its images, in the frame [m].
    view: tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
    width: Annotated[int, Field(ge=16, le=MAX_WIDTH_PX, multiple_of=2)] = 320  # [pixels]
    height: Annotated[int, Field(ge=16, le=MAX_HEIGHT_PX, multiple_of=2)] = 240  # [pixels]
    rate_hz: Annotated[float, Field(ge=0.1, le=MAX_RATE_HZ)] = 15.0  # images a second [Hz]
    field_of_view_deg: Annotated[float, Field(ge=5.0, le=150.0)] = 50.0  # vertical [deg]
    depth: bool = False  # true for depth images too

    @field_validator("view")
    @classmethod
    def _looks_somewhere(cls, view: tuple[float, ...]) -> tuple[float, ...]:
        if math.dist(view[:3], view[3:]) < 1e-6:
            raise ValueError("the camera must look at another point than its own place")
        return view

    @property
    def axes(self) -> Vector:
        """Directions in the frame: right in the image, up in it, and against the view, columns of shape (3, 3)."""
        back = np.subtract(self.view[:3], self.view[3:])
        back /= np.linalg.norm(back)
        up = np.array([1.0, 0.0, 0.0]) if abs(back[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        return np.column_stack((right, np.cross(back, right), back))

    @property
    def transform_optical_to_frame(self) -> Vector:
        """Pose of the optical frame, shape (4, 4): z along the view, x right and y down in the image (REP 103)."""
        transform = np.eye(4)
        transform[:3, :3] = self.axes * (1.0, -1.0, -1.0)
        transform[:3, 3] = self.view[:3]
        return transform

    @property
    def intrinsic_matrix(self) -> Vector:
        """Matrix K of sensor_msgs/CameraInfo [pixels], shape (3, 3); (0, 0) is the middle of the first pixel."""
        focal_px = 0.5 * self.height / math.tan(0.5 * math.radians(self.field_of_view_deg))
        middle_px = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
        return np.array([[focal_px, 0.0, middle_px[0]], [0.0, focal_px, middle_px[1]], [0.0, 0.0, 1.0]])
