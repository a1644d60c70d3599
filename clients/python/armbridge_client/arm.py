"""An arm on an armbridge server, for programs without an event loop."""

from __future__ import annotations

import contextlib
import ssl
from types import TracebackType
from typing import Literal

from armbridge_client.async_arm import AsyncArm, connect_async
from armbridge_client.async_gripper import AsyncGripper
from armbridge_client.blocking import Face, LoopThread, blocking, iterating
from armbridge_client.connection import ServerInfo
from armbridge_client.errors import ConnectionLost
from armbridge_client.messages import RobotTrajectory
from armbridge_client.motion import AsyncPlan
from armbridge_client.targets import Target


def connect(
    url: str = "ws://127.0.0.1:9090",
    *,
    token: str | None = None,
    arm: str = "",
    tls: ssl.SSLContext | None = None,
    on_disconnect: Literal["stop", "continue"] = "stop",
    timeout_s: float = 5.0,
) -> Arm:
    """Connect to a server; to be used with ``with``.

    Args:
        url: ``ws://HOST:PORT``, or ``wss://`` for TLS.
        token: authentication token, if the server requires one.
        arm: name of one of several arms; empty for the only arm.
        tls: context that trusts a certificate of your own: ``ssl.create_default_context(cafile="arm.pem")``.
        on_disconnect: ``stop`` ends the motions of this program when its connection ends, ``continue`` lets them go on.

    Raises:
        ServerUnreachable: nothing listens at the address.
        NotArmbridge: the server is another program.
        WrongVersion: the server's message types differ from the client's.
        NotAuthenticated: the token is missing or wrong.
        DeadlineExceeded: the server does not answer in time.
    """
    loop = LoopThread()
    try:
        opening = connect_async(url, token=token, arm=arm, tls=tls, on_disconnect=on_disconnect, timeout_s=timeout_s)
        return Arm(loop.run(opening), loop)
    except BaseException:
        loop.end()
        raise


class Gripper(Face[AsyncGripper]):
    """Gripper of an arm; a new motion replaces the one in progress."""

    open = blocking(AsyncGripper.open)
    close = blocking(AsyncGripper.close)
    move = blocking(AsyncGripper.move)
    range = blocking(AsyncGripper.range)


class Plan(Face[AsyncPlan]):
    """A planned motion, which has not moved anything."""

    execute = blocking(AsyncPlan.execute)

    @property
    def duration_s(self) -> float:
        """Duration of the motion at full speed [s]."""
        return self.asynchronous.duration_s

    @property
    def trajectory(self) -> RobotTrajectory:
        """Positions over time."""
        return self.asynchronous.trajectory


class Arm(Face[AsyncArm]):
    """One arm of a server. All methods may be called by several threads; :meth:`stop` also by a signal handler.

    Every method has a deadline, after which it raises DeadlineExceeded. A motion that exceeds its deadline, or is
    interrupted by Ctrl-C, is braked along its path.

    Attributes:
        gripper: the arm's gripper.
    """

    def __init__(self, asynchronous: AsyncArm, loop: LoopThread) -> None:
        super().__init__(asynchronous, loop)
        self.gripper = Gripper(asynchronous.gripper, loop)

    def __enter__(self) -> Arm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; motions in progress are stopped, unless ``on_disconnect="continue"``."""
        with contextlib.suppress(ConnectionLost):  # closed before
            self.loop.run(self.asynchronous.close())
        self.loop.end()

    @property
    def server(self) -> ServerInfo:
        """This client as the server knows it, and the server's version."""
        return self.asynchronous.server

    def other(self, name: str) -> Arm:
        """Return another arm of the same server, over the same connection."""
        return Arm(self.asynchronous.other(name), self.loop)

    def plan(self, target: Target, *, speed: float = 0.0, group: str = "") -> Plan:
        """Plan a motion to a target from where the arm is, show it to all clients, and move nothing.

        Raises:
            GoalRefused: there is no such motion.
        """
        return Plan(self.loop.run(self.asynchronous.plan(target, speed=speed, group=group)), self.loop)

    wait_connected = blocking(AsyncArm.wait_connected)
    move_to = blocking(AsyncArm.move_to)
    move_joints = blocking(AsyncArm.move_joints)
    move_named = blocking(AsyncArm.move_named)
    move = blocking(AsyncArm.move)
    check = blocking(AsyncArm.check)
    states = iterating(AsyncArm.states)
    state = blocking(AsyncArm.state)
    link_poses = blocking(AsyncArm.link_poses)
    tip = blocking(AsyncArm.tip)
    tip_link = blocking(AsyncArm.tip_link)
    stop = blocking(AsyncArm.stop)
    emergency_stop = blocking(AsyncArm.emergency_stop)
    enable = blocking(AsyncArm.enable)
    relax = blocking(AsyncArm.relax)
    park = blocking(AsyncArm.park)
    reset_fault = blocking(AsyncArm.reset_fault)
