"""Teleoperation by clients: the services and topics below ``/teleop/``, and where leaders' samples come from."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, TypeAlias

from planners.problem import PlanningFailure
from planners.servo.question import ServoAnswer, ServoQuestion
from protocol.errors import MessageError
from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from robot.messages import ArmState
from server.errors import RefusedError, ServiceError
from server.execution.monitors import check_ready
from server.execution.motions import Motion
from server.execution.queue import GoalQueue
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.poses import Message
from server.moveit.requests.planning_context import PlanningContext
from server.teleop.following import STALE_S, Phase
from server.teleop.joint_map import joint_map
from server.teleop.leader import MAX_DELAY_S, JitterBuffer, LeaderSample
from server.teleop.session import Follower, FollowingSession, FollowingState, GoTo

log = logging.getLogger("armbridge.teleop")

START, STOP, CLUTCH = "/teleop/start", "/teleop/stop", "/teleop/clutch"
STATE_TOPIC = "/teleop/state"
TARGETS_TOPIC = "/teleop/leader_joint_states"
JOINT_STATE = "sensor_msgs/JointState"

# A leader of 10 Hz, in a network that has to be woken up.
FIRST_SAMPLE_S = 1.0
POLL_S = 0.02

# Two arms of seven joints with fingers have less.
MAX_JOINTS = 32

# A leader's message that cannot be read is repeated many times a second.
LOGGED_AGAIN_S = 5.0

_Work: TypeAlias = Callable[[Message], Awaitable[dict[str, Any]]]


def read_sample(message: Message, received_s: float) -> LeaderSample:
    """Read a sensor_msgs/JointState.

    Args:
        message: the message.
        received_s: time that stands for the stamp of a message without one [s].

    Raises:
        ServiceError: names and positions do not fit, or a position is not finite.
    """
    names, positions = message["name"], message["position"]
    if len(names) != len(positions) or not 0 < len(names) <= MAX_JOINTS:
        raise ServiceError(
            f"name: must have 1 to {MAX_JOINTS} joints, as many as position has values, {len(positions)}, "
            f"not {len(names)}"
        )
    for name, position in zip(names, positions, strict=True):
        if not math.isfinite(position):
            raise ServiceError(f"position of {name}: must be a finite number, not {position}")
    stamp = message["header"]["stamp"]
    stamp_s = stamp["sec"] + stamp["nanosec"] * 1e-9
    return LeaderSample(stamp_s or received_s, dict(zip(names, map(float, positions), strict=True)))


class Leader:
    """Leader of a following: a topic, or an arm of this server.

    Args:
        name: of the arm, or of the topic, with which it begins with a slash.
        max_velocity_rad_s: greatest velocity of joints that are watched for jumps, by the leader's names [rad/s].
        clock: monotonic time [s].

    Attributes:
        name: as given.
        samples: its samples.
        joint_names: joints of the latest sample; empty before the first.
    """

    def __init__(self, name: str, max_velocity_rad_s: Mapping[str, float], clock: Callable[[], float]) -> None:
        self.name = name
        self.samples = JitterBuffer(max_velocity_rad_s, MAX_DELAY_S if name.startswith("/") else 0.0)
        self.joint_names: tuple[str, ...] = ()
        self._clock = clock
        self._publisher: object = None
        self._logged_at_s = -math.inf

    def take_state(self, state: ArmState) -> None:
        """Take the state of an arm of this server."""
        # What an arm with a fault reads may be old.
        if state.position_rad is not None and state.fault is None:
            self._take(
                LeaderSample(state.stamp_s, dict(zip(state.joint_names, state.position_rad.tolist(), strict=True)))
            )

    def take_message(self, published: PublishedMessage) -> None:
        """Take a message of the topic; while one client sends, those of others are not followed."""
        now_s = self._clock()
        if published.publisher is not self._publisher and self.samples.age_s(now_s) <= STALE_S:
            self.complain(f"{published.publisher} publishes as well, and is not followed")
            return
        try:
            sample = read_sample(published.msg, now_s)
        except ServiceError as error:
            self.complain(str(error))
            return
        if published.publisher is not self._publisher:
            # The clock of another client has another offset.
            self._publisher = published.publisher
            self.samples.clear()
        self._take(sample)

    def complain(self, text: str) -> None:
        """Log what is wrong with the topic, once in `LOGGED_AGAIN_S`."""
        now_s = self._clock()
        if now_s - self._logged_at_s > LOGGED_AGAIN_S:
            self._logged_at_s = now_s
            log.warning("%s: %s", self.name, text)

    def _take(self, sample: LeaderSample) -> None:
        self.samples.add(sample, self._clock())
        self.joint_names = tuple(sample.positions_rad)


class Teleoperation:
    """Has one arm follow a leader.

    Args:
        graph: where the services and topics are.
        context: scene, planners and frames.
        queue: of goals.
        go_to: queues a goal for joints.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        graph: Graph,
        context: PlanningContext,
        queue: GoalQueue[Motion],
        go_to: GoTo,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._graph, self._context, self._queue, self._go_to = graph, context, queue, go_to
        self._clock = clock
        self._node = Node("teleop")
        self._followers: dict[str, Follower] = {}
        self._leaders: set[str] = set()
        self._leader: Leader | None = None
        self._session: FollowingSession | None = None
        self._follower_name = ""
        self._phase = Phase.IDLE

    def add_follower(self, follower: Follower) -> None:
        """Add an arm that can follow, before the start."""
        self._followers[follower.name] = follower

    def add_leader(self, name: str) -> None:
        """Add an arm of this server that can lead, before the start."""
        self._leaders.add(name)

    def open(self) -> None:
        """Offer the services, and publish the state."""
        self._graph.advertise(self._node, STATE_TOPIC, "armbridge_msgs/TeleopState", latch=True)
        self._graph.advertise(self._node, TARGETS_TOPIC, JOINT_STATE)
        self._offer(START, "armbridge_msgs/srv/StartTeleop", self._start)
        self._offer(STOP, "std_srvs/srv/Trigger", self._stop)
        self._offer(CLUTCH, "std_srvs/srv/SetBool", self._set_clutch)
        self._show(FollowingState(Phase.IDLE, f"nothing follows: {START} begins", 0.0, 0.0, 1.0))

    @property
    def active(self) -> bool:
        """True while a leader is listened to, whose states are needed at their full rate."""
        return self._leader is not None

    def take_leader_state(self, name: str, state: ArmState) -> None:
        """Take the latest state of an arm of this server."""
        if self._leader is not None and self._leader.name == name:
            self._leader.take_state(state)
            if self._session is not None:
                self._session.take_sample()

    async def close(self) -> None:
        """End the following; the arm comes to rest by itself."""
        if self._session is not None:
            await self._session.close()

    # Services.

    async def _start(self, request: Message) -> dict[str, Any]:
        if self._leader is not None:
            raise ServiceError(f"{self._follower_name} follows {self._leader.name}: call {STOP} first")
        follower = self._chosen_follower(request["follower"])
        try:
            check_ready(follower.arm)
        except RefusedError as error:
            raise ServiceError(f"{follower.name} cannot follow: {error}") from error
        if busy := self._queue.busy_with(follower.joints):
            raise ServiceError(f"{follower.name} cannot follow: it is in use: {busy}")
        name = request["leader"]
        if not name.startswith("/") and name not in self._leaders:
            known = ", ".join(sorted(self._leaders)) or "none"
            raise ServiceError(
                f"leader: must be an arm that leads ({known}) or a topic that begins with /, not {name[:80]!r}"
            )
        if name.startswith("/") and self._own_topic(name):
            raise ServiceError(f"leader: must not be {name}, which tells where this server's arms are")
        self._leader = leader = Leader(name, self._watched(follower, name), self._clock)
        self._follower_name = follower.name
        try:
            self._listen(leader)
            await self._first_sample(leader)
            joints = joint_map(
                follower.robot,
                follower.prefix,
                leader.joint_names,
                "" if name.startswith("/") else f"{name}_",
                scale=request["scale"] or 1.0,
                mirror=request["mirror"],
                pairs=(request["leader_joints"], request["follower_joints"]),
            )
        except BaseException:
            self._forget_leader()
            raise
        self._session = FollowingSession(
            follower,
            joints,
            leader.samples,
            self._queue,
            self._go_to,
            self._ask,
            self._context.frames.resolve,
            self._context.current,
            self._show,
            self._show_targets,
            self._clock,
        )
        self._session.start()
        followed = ", ".join(f"{link.follower} follows {link.leader}" for link in joints.links)
        log.info("%s follows %s", follower.name, name)
        return {"success": True, "message": f"{follower.name} goes to where {name} is, then {followed}"}

    async def _stop(self, _request: Message) -> dict[str, Any]:
        self._running().end("stopped by a client")
        return {"success": True, "message": f"{self._follower_name} follows no more"}

    async def _set_clutch(self, request: Message) -> dict[str, Any]:
        self._running().set_clutch(closed=request["data"])
        message = "the follower goes to where the leader is" if request["data"] else "the follower holds"
        return {"success": True, "message": message}

    def _running(self) -> FollowingSession:
        if self._session is None:
            raise ServiceError(f"nothing follows: {START} begins")
        return self._session

    def _chosen_follower(self, name: str) -> Follower:
        if name in self._followers:
            return self._followers[name]
        if not name and len(self._followers) == 1:
            return next(iter(self._followers.values()))
        raise ServiceError(f"follower: must be one of {', '.join(self._followers) or 'none'}, not {name[:80]!r}")

    def _own_topic(self, name: str) -> bool:
        """Return True for a topic by which an arm would follow itself."""
        own = (f"{'' if not follower.prefix else '/' + follower.name}" for follower in self._followers.values())
        return name in {"/joint_states", TARGETS_TOPIC, *(f"{below}/joint_states" for below in own)}

    def _watched(self, follower: Follower, leader: str) -> dict[str, float]:
        """Return the greatest velocity of the leader's joints that are named as the follower's [rad/s]."""
        prefix = "" if leader.startswith("/") else f"{leader}_"
        return {
            prefix + joint.name.removeprefix(follower.prefix): joint.max_velocity
            for joint in follower.robot.movable_joints
        }

    # Leaders.

    def _listen(self, leader: Leader) -> None:
        if not leader.name.startswith("/"):
            return

        def refused(error: MessageError) -> None:
            leader.complain(str(error))

        try:
            self._graph.subscribe(self._node, leader.name, JOINT_STATE, Subscriber(leader.take_message, refused))
        except MessageError as error:
            raise ServiceError(f"leader: {error}") from error

    async def _first_sample(self, leader: Leader) -> None:
        until_s = self._clock() + FIRST_SAMPLE_S
        while not leader.joint_names:
            if self._clock() > until_s:
                raise ServiceError(f"leader: {leader.name} has sent nothing for {FIRST_SAMPLE_S:g} s")
            await asyncio.sleep(POLL_S)

    def _forget_leader(self) -> None:
        if self._leader is not None and self._leader.name.startswith("/"):
            self._graph.unsubscribe(self._node, self._leader.name)
        self._leader = self._session = None

    # Messages.

    def _ask(self, question: ServoQuestion) -> Coroutine[Any, Any, ServoAnswer | PlanningFailure]:
        return self._context.pool.ask(question, self._context.scene_state.scene)

    def _show(self, state: FollowingState) -> None:
        if state.phase is not self._phase:
            self._phase = state.phase
            log.info("teleoperation of %s: %s", self._follower_name, state.message or state.phase.value)
        self._graph.publish(
            self._node,
            STATE_TOPIC,
            {
                "follower": self._follower_name,
                "leader": "" if self._leader is None else self._leader.name,
                "phase": state.phase.value,
                "message": state.message,
                "latency_s": state.latency_s,
                "lag_rad": state.lag_rad,
                "speed_scale": state.speed_scale,
            },
        )
        if state.phase is Phase.IDLE:
            self._forget_leader()

    def _show_targets(self, targets_rad: Mapping[str, float]) -> None:
        self._graph.publish(
            self._node,
            TARGETS_TOPIC,
            {
                "header": {"stamp": Stamp.from_seconds(time.time()).as_message(), "frame_id": ""},
                "name": list(targets_rad),
                "position": list(targets_rad.values()),
                "velocity": [],
                "effort": [],
            },
        )

    def _offer(self, name: str, type_name: str, work: _Work) -> None:
        async def serve(request: Message) -> dict[str, Any]:
            try:
                return await work(request)
            except ServiceError as error:
                log.warning("%s: %s", name, error)
                return {"success": False, "message": str(error)}

        self._graph.services.offer(self._node, name, type_name, serve)
