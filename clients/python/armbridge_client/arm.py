"""An arm on an armbridge server, for programs without an event loop."""

from __future__ import annotations

import contextlib
import ssl
from collections.abc import Iterator
from types import TracebackType
from typing import Literal, TypeVar

from armbridge_client.async_arm import AsyncArm, connect_async
from armbridge_client.async_gripper import AsyncGripper
from armbridge_client.async_library import AsyncEpisodes, AsyncNamedStates, AsyncTeaching
from armbridge_client.async_scene import AsyncScene
from armbridge_client.async_steering import COMMAND_TIMEOUT_S, AsyncChunks, AsyncJog, AsyncTeleop
from armbridge_client.blocking import ContextFace, Face, LoopThread, blocking, iterate, iterating, making
from armbridge_client.connection import CALL_TIMEOUT_S, ServerInfo
from armbridge_client.errors import ConnectionLost
from armbridge_client.interface import ArmInfo
from armbridge_client.messages import RobotTrajectory
from armbridge_client.motion import AsyncPlan
from armbridge_client.wire import Message, Response, Service

M = TypeVar("M", bound=Message)


def connect(
    url: str = "ws://127.0.0.1:9090",
    *,
    token: str | None = None,
    arm: str = "",
    tls: ssl.SSLContext | None = None,
    on_disconnect: Literal["stop", "finish"] = "stop",
    timeout_s: float = CALL_TIMEOUT_S,
) -> Arm:
    """Connect to a server; to be used with ``with``.

    Args:
        url: ``ws://HOST:PORT``, or ``wss://`` for TLS.
        token: authentication token; None for that in the environment variable ARMBRIDGE_TOKEN, if any.
        arm: name of one of several arms; empty for the only arm.
        tls: context that trusts a certificate of your own: ``ssl.create_default_context(cafile="arm.pem")``.
        on_disconnect: ``stop`` ends the motions of this program when its connection ends, ``finish`` lets them go on.

    Raises:
        ServerUnreachable: nothing listens at the address.
        NotArmbridge: the server is another program.
        WrongVersion: the server's message types differ from the client's.
        ArmError: the server has no arm of this name.
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


class Scene(Face[AsyncScene]):
    """Planning scene, as :class:`AsyncScene`."""

    add_box = blocking(AsyncScene.add_box)
    add_sphere = blocking(AsyncScene.add_sphere)
    add_cylinder = blocking(AsyncScene.add_cylinder)
    add_mesh = blocking(AsyncScene.add_mesh)
    remove = blocking(AsyncScene.remove)
    clear = blocking(AsyncScene.clear)
    attach = blocking(AsyncScene.attach)
    detach = blocking(AsyncScene.detach)
    allow_contact = blocking(AsyncScene.allow_contact)
    make_movable = blocking(AsyncScene.make_movable)
    reset_physics = blocking(AsyncScene.reset_physics)
    objects = blocking(AsyncScene.objects)
    held = blocking(AsyncScene.held)
    save = blocking(AsyncScene.save)
    load = blocking(AsyncScene.load)
    delete = blocking(AsyncScene.delete)
    saved = blocking(AsyncScene.saved)


class NamedStates(Face[AsyncNamedStates]):
    """Named states: targets of ``move_named``, of the robot's description or saved."""

    all = blocking(AsyncNamedStates.all)
    save = blocking(AsyncNamedStates.save)
    delete = blocking(AsyncNamedStates.delete)


class Teaching(Face[AsyncTeaching]):
    """Motions taught by hand: relax the arm, hold it, ``begin``, lead it, ``end``."""

    begin = blocking(AsyncTeaching.begin)
    end = blocking(AsyncTeaching.end)
    discard = blocking(AsyncTeaching.discard)
    names = blocking(AsyncTeaching.names)
    check = blocking(AsyncTeaching.check)
    replay = blocking(AsyncTeaching.replay)
    trim = blocking(AsyncTeaching.trim)
    rename = blocking(AsyncTeaching.rename)
    delete = blocking(AsyncTeaching.delete)


class Teleop(Face[AsyncTeleop]):
    """Following of a leader arm, or of a topic of joint states."""

    start = blocking(AsyncTeleop.start)
    stop = blocking(AsyncTeleop.stop)
    clutch = blocking(AsyncTeleop.clutch)
    states = iterating(AsyncTeleop.states)


class Episodes(Face[AsyncEpisodes]):
    """Episodes of the server's recording, from which datasets are made (``armbridge serve --record``)."""

    start = blocking(AsyncEpisodes.start)
    stop = blocking(AsyncEpisodes.stop)
    discard = blocking(AsyncEpisodes.discard)


class Jog(ContextFace[AsyncJog]):
    """Steering with a dead-man's switch, for the length of a ``with``; as :class:`AsyncJog`."""

    tip = blocking(AsyncJog.tip)
    joints = blocking(AsyncJog.joints)
    release = blocking(AsyncJog.release)


class Chunks(ContextFace[AsyncChunks]):
    """Chunks of joint targets of a learned policy, for the length of a ``with``; as :class:`AsyncChunks`."""

    send = blocking(AsyncChunks.send)
    pause = blocking(AsyncChunks.pause)
    resume = blocking(AsyncChunks.resume)
    stop = blocking(AsyncChunks.stop)


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
    """

    def __init__(self, asynchronous: AsyncArm, loop: LoopThread) -> None:
        super().__init__(asynchronous, loop)
        self.gripper = Gripper(asynchronous.gripper, loop)
        self.scene = Scene(asynchronous.scene, loop)
        self.named_states = NamedStates(asynchronous.named_states, loop)
        self.teaching = Teaching(asynchronous.teaching, loop)
        self.teleop = Teleop(asynchronous.teleop, loop)
        self.episodes = Episodes(asynchronous.episodes, loop)

    def __enter__(self) -> Arm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; motions in progress are stopped, unless ``on_disconnect="finish"``."""
        with contextlib.suppress(ConnectionLost):  # closed before
            self.loop.run(self.asynchronous.close())
        self.loop.end()

    @property
    def name(self) -> str:
        """Name of the arm, on a server with several."""
        return self.asynchronous.name

    @property
    def info(self) -> ArmInfo:
        """Groups, frame and links of the arm."""
        return self.asynchronous.info

    @property
    def server(self) -> ServerInfo:
        """This client as the server knows it, and the server's version."""
        return self.asynchronous.server

    def other(self, name: str) -> Arm:
        """Return another arm of the same server, over the same connection."""
        return Arm(self.asynchronous.other(name), self.loop)

    def jog(self, command_timeout_s: float = COMMAND_TIMEOUT_S) -> Jog:
        """Steer with velocities, as :meth:`AsyncArm.jog`: ``with arm.jog() as jog``."""
        return Jog(self.asynchronous.jog(command_timeout_s), self.loop)

    def chunks(self) -> Chunks:
        """Follow the joint targets of a policy, as :meth:`AsyncArm.chunks`: ``with arm.chunks() as chunks``."""
        return Chunks(self.asynchronous.chunks(), self.loop)

    def call(self, service: str, request: Service[Response], timeout_s: float = CALL_TIMEOUT_S) -> Response:
        """Call any service, as :meth:`AsyncArm.call`."""
        return self.loop.run(self.asynchronous.call(service, request, timeout_s))

    def messages(
        self, topic: str, message_class: type[M], rate_hz: float = 0.0, *, length: int = 10, timeout_s: float = 5.0
    ) -> Iterator[M]:
        """Go over the messages of any topic, as :meth:`AsyncArm.messages`."""
        messages = self.asynchronous.messages(topic, message_class, rate_hz, length=length, timeout_s=timeout_s)
        return iterate(self.loop, messages)

    wait_connected = blocking(AsyncArm.wait_connected)
    move_to = blocking(AsyncArm.move_to)
    move_joints = blocking(AsyncArm.move_joints)
    move_named = blocking(AsyncArm.move_named)
    move = blocking(AsyncArm.move)
    plan = making(AsyncArm.plan, Plan)
    plan_path = making(AsyncArm.plan_path, Plan)
    check = blocking(AsyncArm.check)
    states = iterating(AsyncArm.states)
    state = blocking(AsyncArm.state)
    stops = blocking(AsyncArm.stops)
    link_poses = blocking(AsyncArm.link_poses)
    tip = blocking(AsyncArm.tip)
    stop = blocking(AsyncArm.stop)
    emergency_stop = blocking(AsyncArm.emergency_stop)
    enable = blocking(AsyncArm.enable)
    relax = blocking(AsyncArm.relax)
    park = blocking(AsyncArm.park)
    reset_fault = blocking(AsyncArm.reset_fault)
    set_speed_limit = blocking(AsyncArm.set_speed_limit)
    pause = blocking(AsyncArm.pause)
    resume = blocking(AsyncArm.resume)
    step_back = blocking(AsyncArm.step_back)
    take_control = blocking(AsyncArm.take_control)
    release_control = blocking(AsyncArm.release_control)
    control = blocking(AsyncArm.control)
    publish = blocking(AsyncArm.publish)
    waiting_goal = blocking(AsyncArm.waiting_goal)
    approve = blocking(AsyncArm.approve)
    discard = blocking(AsyncArm.discard)
    set_confirm_mode = blocking(AsyncArm.set_confirm_mode)
