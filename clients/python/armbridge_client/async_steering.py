"""Steering: velocities that the arm follows at once, following a leader arm, and chunks of a learned policy."""

from __future__ import annotations

import itertools
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from types import TracebackType

from armbridge_client.connection import CALL_TIMEOUT_S, Connection, Stream
from armbridge_client.errors import DeadlineExceeded, refusal
from armbridge_client.messages import (
    ActionChunk,
    ActionChunkAnswer,
    Float64,
    Header,
    JointJog,
    JointTrajectory,
    JointTrajectoryPoint,
    ServoStatus,
    SetBoolRequest,
    StartTeleopRequest,
    String,
    TeleopState,
    TriggerRequest,
    Twist,
    TwistStamped,
    Vector3,
)
from armbridge_client.motion import duration, stamp

# The server's time after which a command expires (docs/teleoperation.md); a client may choose a shorter one.
COMMAND_TIMEOUT_S = 0.25


class AsyncJog:
    """Steering with a dead-man's switch, for the length of an ``async with``.

    Repeat the command while the person holds the stick: ``command_timeout_s`` after the last command the arm brakes,
    also if this program hangs or the network fails. Leaving the ``async with`` brakes at once.

    Args:
        prefix: the arm's name behind a slash; empty for the only arm.
    """

    def __init__(self, connection: Connection, prefix: str, command_timeout_s: float) -> None:
        self._connection = connection
        self._prefix = f"{prefix}/servo_node"
        self._command_timeout_s = command_timeout_s
        self._statuses = connection.subscribe(f"{self._prefix}/status", ServoStatus)
        self._status: Stream[ServoStatus] | None = None
        # Largest velocities, and their values in a command: linear [m/s], rotational [rad/s], joint [rad/s].
        self._scales: Mapping[str, float] = {}
        self._unitless = True
        self._release: TwistStamped | JointJog = TwistStamped()

    async def __aenter__(self) -> AsyncJog:
        async with self._connection.subscribe(f"{self._prefix}/parameters", String) as texts:
            parameters = json.loads((await texts.__anext__()).data)
        self._unitless = parameters["command_in_type"] == "unitless"
        self._scales = {each: float(parameters[f"{each}_scale"]) for each in ("linear", "rotational", "joint")}
        self._status = await self._statuses.__aenter__()
        # A new press: without it the server would not steer again after a goal, a stop or a fault.
        await self._connection.publish(f"{self._prefix}/command_timeout", Float64(self._command_timeout_s))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.release()
        await self._statuses.__aexit__(kind, error, trace)

    async def tip(
        self,
        linear_m_s: Sequence[float] = (0.0, 0.0, 0.0),
        angular_rad_s: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        frame: str = "",
    ) -> ServoStatus | None:
        """Move and turn the tip along the axes of a frame; empty for the planning frame.

        Returns the server's latest status, whose message names what limits the arm; None before the first.

        Raises:
            ValueError: a velocity exceeds the server's scale.
            NotPermitted, ControlledByOther: the command before was refused.
        """
        linear = self._scaled("linear", "linear_m_s", linear_m_s)
        angular = self._scaled("rotational", "angular_rad_s", angular_rad_s)
        header = Header(frame_id=frame)
        self._release = TwistStamped(header)
        return await self._command("delta_twist_cmds", TwistStamped(header, Twist(Vector3(*linear), Vector3(*angular))))

    async def joints(self, velocity_rad_s: Mapping[str, float]) -> ServoStatus | None:
        """Turn joints at velocities; the other joints rest. As :meth:`tip`."""
        velocities = self._scaled("joint", "velocity_rad_s", list(velocity_rad_s.values()))
        names = list(velocity_rad_s)
        self._release = JointJog(joint_names=names, velocities=[0.0] * len(names))
        return await self._command("delta_joint_cmds", JointJog(joint_names=names, velocities=velocities))

    async def release(self) -> None:
        """Brake at once, as after letting go of the stick."""
        topic = "delta_joint_cmds" if isinstance(self._release, JointJog) else "delta_twist_cmds"
        await self._command(topic, self._release)

    async def _command(self, topic: str, message: TwistStamped | JointJog) -> ServoStatus | None:
        await self._connection.publish(f"{self._prefix}/{topic}", message)
        return None if self._status is None else self._status.newest()

    def _scaled(self, kind: str, name: str, velocities: Sequence[float]) -> list[float]:
        most = self._scales[kind]
        for value in velocities:
            if not abs(value) <= most:
                raise ValueError(f"{name} must be from {-most:g} to {most:g}, not {value:g}")
        return [value / most if self._unitless else float(value) for value in velocities]


# Value of error_code for a chunk that is followed.
_SUCCESS = 1


class AsyncChunks:
    """Chunks of joint targets that a learned policy sends, for the length of an ``async with``.

    The arm follows each chunk until the next one takes over; without a next one it brakes to the last target and holds.

    Args:
        prefix: the arm's name behind a slash; empty for the only arm.
    """

    def __init__(self, connection: Connection, prefix: str) -> None:
        self._connection = connection
        self._topic = f"{prefix}/arm/chunks"
        self._answers = connection.subscribe(f"{self._topic}/answer", ActionChunkAnswer, length=100)
        self._stream: Stream[ActionChunkAnswer] | None = None
        self._ids = itertools.count(1)

    async def __aenter__(self) -> AsyncChunks:
        self._stream = await self._answers.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._answers.__aexit__(kind, error, trace)

    async def send(
        self,
        joint_names: Sequence[str],
        times_s: Sequence[float],
        positions: Sequence[Sequence[float]],
        *,
        observed_at_s: float = 0.0,
        blend: str = "replace",
        weight: float = 0.0,
    ) -> ActionChunkAnswer:
        """Send a chunk, and return the server's answer: how far the arm follows it.

        Args:
            times_s: of each target, from the observation on [s].
            positions: of each target, in the order of the joints [rad, or m for joints that slide].
            observed_at_s: time of the observation [s since the epoch]; 0 for the time of arrival.
            blend: where chunks overlap: ``replace``, ``ensemble`` or ``real_time``.
            weight: share of this chunk in an ensemble, 0 to 1.

        Raises:
            RequestRefused: no target of the chunk is followed.
        """
        if self._stream is None:
            raise RuntimeError("send: only within `async with`")
        points = [
            JointTrajectoryPoint(positions=list(row), time_from_start=duration(time_s))
            for time_s, row in zip(times_s, positions, strict=True)
        ]
        # Answers on the topic are to the chunks of all clients.
        number = f"{id(self)}-{next(self._ids)}"
        trajectory = JointTrajectory(Header(stamp(observed_at_s)), list(joint_names), points)
        # The sentence about an earlier chunk was raised with its answer.
        self._connection.complaint(self._topic)
        await self._connection.publish(self._topic, ActionChunk(number, trajectory, blend, weight))
        try:
            answer = await anext(answer async for answer in self._stream if answer.id == number)
        except DeadlineExceeded:
            # A client that may not move the arm has no answer, but a sentence.
            if complaint := self._connection.complaint(self._topic):
                raise refusal(complaint) from None
            raise
        if answer.error_code.val != _SUCCESS:
            raise refusal(answer.message)
        return answer

    async def pause(self) -> str:
        """Have the arm brake, and refuse chunks until :meth:`resume`; meanwhile any client may take control."""
        return await self._carry_out("pause")

    async def resume(self) -> str:
        """Have the arm follow the policy again, and give up this client's control."""
        return await self._carry_out("resume")

    async def stop(self) -> str:
        """Have the arm brake, and end the policy: its chunks are refused until none came for 5 s."""
        return await self._carry_out("stop")

    async def _carry_out(self, service: str) -> str:
        return (await self._connection.carry_out(f"{self._topic}/{service}", TriggerRequest())).message


class AsyncTeleop:
    """Following of a leader arm, or of a topic of joint states.

    Args:
        prefix: the follower's name behind a slash; empty for the only arm.
    """

    def __init__(self, connection: Connection, prefix: str) -> None:
        self._connection = connection
        self._prefix = f"{prefix}/teleop"

    async def start(
        self, leader: str = "leader", *, follower: str = "", mirror: bool = False, scale: float = 1.0
    ) -> str:
        """Follow a leader: the follower first goes to where the leader is.

        Args:
            leader: name of an arm with the role leader, or a topic of joint states.
            follower: name of the arm that follows; may be empty where there is one.
            mirror: follow as a mirror would show the leader.
            scale: factor of the leader's positions, above 0 to 2.
        """
        request = StartTeleopRequest(follower, leader, scale, mirror)
        return (await self._connection.carry_out(f"{self._prefix}/start", request)).message

    async def stop(self, timeout_s: float = CALL_TIMEOUT_S) -> str:
        """Brake softly, and end the following."""
        return (await self._connection.carry_out(f"{self._prefix}/stop", TriggerRequest(), timeout_s)).message

    async def clutch(self, *, closed: bool) -> str:
        """Open the clutch, so that the leader moves freely while the follower holds; or close it again."""
        return (await self._connection.carry_out(f"{self._prefix}/clutch", SetBoolRequest(closed))).message

    async def states(self, *, timeout_s: float = 3600.0) -> AsyncIterator[TeleopState]:
        """Go over the states of the following; the first is the present one."""
        async with self._connection.subscribe(
            f"{self._prefix}/state", TeleopState, length=100, timeout_s=timeout_s
        ) as states:
            async for state in states:
                yield state
