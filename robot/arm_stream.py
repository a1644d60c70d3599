"""A stream of velocities to the arm, as the server steers it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from robot.messages import Commanded, MotionEnded, Setpoint
from robot.trajectory import Vector


class ArmStream:
    """One stream, from its beginning to its one end.

    Args:
        motion_id: its number.
        joint_names: the joints that follow.
        ended: its one end.
        send: takes setpoints.

    Attributes:
        joint_names: as given.
        ended: as given.
        commanded: where the joints are told to be now; None until the arm has begun.
    """

    def __init__(
        self,
        motion_id: int,
        joint_names: tuple[str, ...],
        ended: asyncio.Future[MotionEnded],
        send: Callable[[Setpoint], None],
    ) -> None:
        self._motion_id = motion_id
        self._send = send
        self.joint_names = joint_names
        self.ended = ended
        self.commanded: Commanded | None = None

    def steer(self, velocity_rad_s: Vector) -> None:
        """Have the joints move so until the next setpoint, which must come soon.

        Args:
            velocity_rad_s: in the order of ``joint_names`` [rad/s].
        """
        if not self.ended.done():
            self._send(Setpoint(self._motion_id, velocity_rad_s))
