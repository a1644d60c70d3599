"""Camera on a link of a simulated arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot.errors import RobotError
from robot.physics.bodies import Point
from robot.trajectory import Vector


class RenderingError(RobotError):
    """Machine that cannot render, or camera that sees nothing; the text is one sentence."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera in the frame of a link, its image upright as far as the frame's z axis allows."""

    link: str
    position_m: Point
    target_m: Point  # point in the middle of the image
    width: int  # pixels
    height: int  # pixels
    field_of_view_deg: float = 50.0  # vertical

    @property
    def axes(self) -> Vector:
        """Directions in the link's frame: right in the image, up in it, and against the view, columns of (3, 3)."""
        back = np.subtract(self.position_m, self.target_m)
        length = float(np.linalg.norm(back))
        if length < 1e-6:
            raise RenderingError(f"the camera at {self.position_m} must look at another point")
        back /= length
        up = np.array([1.0, 0.0, 0.0]) if abs(back[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        return np.column_stack((right, np.cross(back, right), back))

    @property
    def focal_px(self) -> float:
        """Focal length, equal in both directions [pixels]."""
        return 0.5 * self.height / math.tan(0.5 * math.radians(self.field_of_view_deg))
