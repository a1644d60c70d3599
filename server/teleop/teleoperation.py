"""Teleoperation by clients: the services and topics below ``/teleop/``, and where leaders' samples come from."""

import asyncio
import functools
import logging
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from protocol.errors import MessageError
from protocol.publication import PublishedMessage
from robot.logs import LogLimiter
from robot.messages import ArmState
from robot.stop_epochs import STOP_EPOCHS
from server.arrival import is_stopped
from server.errors import RefusedError, ServiceError
from server.execution.monitors import check_ready, joint_state_message
from server.graph.permissions import STOPPING, SWITCHING, Node
from server.graph.topics import Graph, LocalNode, Subscriber
from server.lifecycle import Feature
from server.moveit.messages import Message
from server.teleop.following import STALE_S, FollowingPhase
from server.teleop.leader import MAX_DELAY_S, JitterBuffer, LeaderSample, joint_map
from server.teleop.session import Follower, FollowingSession, FollowingState

log = logging.getLogger("armbridge.teleop")

START, STOP, CLUTCH = "/teleop/start", "/teleop/stop", "/teleop/clutch"
STATE_TOPIC = "/teleop/state"
TARGETS_TOPIC = "/teleop/leader_joint_states"
JOINT_STATE = "sensor_msgs/JointState"

# A leader of 10 Hz, in a network that has to be woken up.
FIRST_SAMPLE_S = 1.0
POLL_S = 0.02

# A way to the leader that is broken off takes this time to brake; goals of others are not waited for longer [s].
BRAKING_S = 1.0

# Two arms of seven joints with fingers have less.
MAX_JOINTS = 32

# A leader's message that cannot be read is repeated many times a second.
LOGGED_AGAIN_S = 5.0


def read_sample(message: Message, received_s: float) -> LeaderSample:
    """Read a sensor_msgs/JointState; the time of its receipt stands for the stamp of a message without one [s]."""
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
    """Leader of a following: an arm of this server, or a topic, whose name begins with a slash.

    Its samples are checked with the greatest velocities of joints, by their names without the arm's own.
    """

    def __init__(self, name: str, max_velocity_rad_s: Mapping[str, float], clock: Callable[[], float]) -> None:
        self.name, self.is_topic = name, name.startswith("/")
        # Beginning of its joints' names.
        self.prefix = "" if self.is_topic else f"{name}_"
        velocities = {self.prefix + joint: limit for joint, limit in max_velocity_rad_s.items()}
        self.samples = JitterBuffer(velocities, MAX_DELAY_S if self.is_topic else 0.0)
        self.joint_names: tuple[str, ...] = ()
        self._clock = clock
        self._publisher: object = None
        self._log = LogLimiter(1, 1.0 / LOGGED_AGAIN_S)

    def take_state(self, state: ArmState) -> None:
        # What an arm with a fault reads may be old.
        if state.position_rad is not None and state.fault is None:
            self._take(
                LeaderSample(state.stamp_s, dict(zip(state.joint_names, state.position_rad.tolist(), strict=True)))
            )

    def take_message(self, published: PublishedMessage) -> None:
        """Take a message of the topic; while one client sends, messages of others are not followed."""
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
        """Log a fault of the topic, once in `LOGGED_AGAIN_S`."""
        self._log.write(log, logging.WARNING, f"{self.name}: {text}", self.name, self._clock())

    def _take(self, sample: LeaderSample) -> None:
        self.samples.add(sample, self._clock())
        self.joint_names = tuple(sample.positions_rad)


@dataclass
class _Following:
    """One follower and its leader, from the call that starts it to its end; no session before the first sample."""

    follower: Follower
    leader: Leader
    node: Node
    session: FollowingSession | None = None
    phase: FollowingPhase = FollowingPhase.IDLE
    targets_rad: Mapping[str, float] = field(default_factory=dict)


class Teleoperation(Feature):
    """Has arms follow leaders, each follower one."""

    name = "teleoperation"
    deadline_s = 0.5

    def __init__(self, graph: Graph, followers: Iterable[Follower], leaders: Iterable[str]) -> None:
        self._graph, self._clock = graph, graph.clock
        # Its own node, and below the name of each of several followers one.
        self._node = graph.node("teleop")
        self._followers = {follower.name: follower for follower in followers}
        self._leaders = frozenset(leaders)
        self._followings: dict[str, _Following] = {}
        # The stop epoch that the last stop of each following began.
        self._last_stops: dict[str, int] = {}
        self._node.advertise(TARGETS_TOPIC, JOINT_STATE)
        self._offer_below(self._node, list(self._followers))
        several = [name for name, each in self._followers.items() if each.prefix]
        self._nodes = {name: LocalNode(graph, "teleop", f"/{name}") for name in several}
        for name, node in self._nodes.items():
            self._offer_below(node, [name])

    def _offer_below(self, node: LocalNode, names: Sequence[str]) -> None:
        async def start(request: Message) -> str:
            follower = self._chosen_follower(request["follower"], names)
            if (other := self._followings.get(follower.name)) is not None:
                does = "is starting to follow" if other.session is None else f"follows {other.leader.name}"
                raise ServiceError(f"{follower.name} {does}: call {STOP} first")
            try:
                check_ready(follower.context.arm)
            except RefusedError as error:
                raise ServiceError(f"{follower.name} cannot follow: {error}") from error
            leader, node = self._leader(follower, request["leader"]), Node(f"teleop of {follower.name}")
            following = self._followings[follower.name] = _Following(follower, leader, node)
            try:
                return await self._begin(request, following)
            except BaseException:
                self._forget(following)
                raise

        def stop(_request: Message) -> str:
            epoch = STOP_EPOCHS.begin()
            self._last_stops.update((name, epoch) for name in names)
            # A start in progress looks for the stop by itself.
            ended = [name for name in self._followings if name in names]
            for session in self._sessions(names).values() if ended else self._running(names).values():
                session.end("stopped by a client")
            return f"{' and '.join(ended)} {_verb(ended, 'follow')} no more"

        def set_clutch(request: Message) -> str:
            followings = self._running(names)
            for following in followings.values():
                following.set_clutch(closed=request["data"])
            does = f"{_verb(followings, 'go')} to where the leader is" if request["data"] else _verb(followings, "hold")
            return f"{' and '.join(followings)} {does}"

        node.advertise(STATE_TOPIC, "armbridge_msgs/TeleopState", latch=True)
        node.offer(START, "armbridge_msgs/srv/StartTeleop", start, rule=SWITCHING)
        node.offer(STOP, "std_srvs/srv/Trigger", stop, rule=STOPPING)
        node.offer(CLUTCH, "std_srvs/srv/SetBool", set_clutch, rule=SWITCHING)
        idle = {"phase": "idle", "message": f"no arm follows: call {node.resolve(START)}", "speed_scale": 1.0}
        node.publish(STATE_TOPIC, idle)

    @property
    def observes_states(self) -> bool:
        return bool(self._followings)

    def on_state(self, arm: str, state: ArmState) -> None:
        """Follow the latest state of a leader, without waiting for the states of other arms."""
        for following in self._followings.values():
            if following.leader.name == arm:
                following.leader.take_state(state)
                if following.session is not None:
                    following.session.take_sample()

    async def stop(self) -> None:
        """End every following; the arms come to rest by themselves."""
        sessions = [each.session for each in self._followings.values() if each.session is not None]
        await asyncio.gather(*(session.close() for session in sessions))

    # Services.

    def _leader(self, follower: Follower, name: str) -> Leader:
        if not name.startswith("/") and name not in self._leaders:
            known = ", ".join(sorted(self._leaders)) or "none"
            raise ServiceError(
                f"leader: must be an arm that leads ({known}) or a topic that begins with /, not {name[:80]!r}"
            )
        below = ["", *(f"/{each.name}" for each in self._followers.values() if each.prefix)]
        if name in {TARGETS_TOPIC, *(f"{each}/joint_states" for each in below)}:
            raise ServiceError(f"leader: must not be {name}, which has the positions of this server's arms")
        joints = follower.context.robot.movable_joints
        return Leader(
            name, {joint.name.removeprefix(follower.prefix): joint.max_velocity for joint in joints}, self._clock
        )

    async def _begin(self, request: Message, following: _Following) -> str:
        follower, leader = following.follower, following.leader
        self._check_not_stopped(follower)
        follower.context.queue.take_over(
            follower.context.joints,
            f"the leader {leader.name[:80]}",
            lambda: self._followings.get(follower.name) is following,
        )
        # The way to the leader of a following that has just ended may brake.
        await self._wait(follower, BRAKING_S, lambda: self._in_use(follower))
        if leader.is_topic:
            subscriber = Subscriber(leader.take_message, lambda error: leader.complain(str(error)))
            try:
                self._graph.subscribe(following.node, leader.name, JOINT_STATE, subscriber)
            except MessageError as error:
                raise ServiceError(f"leader: {error}") from error
        silence = f"leader: {leader.name} has sent nothing for {FIRST_SAMPLE_S:g} s"
        await self._wait(follower, FIRST_SAMPLE_S, lambda: "" if leader.joint_names else silence)
        joints = joint_map(
            follower.context.robot,
            follower.prefix,
            leader.joint_names,
            leader.prefix,
            scale=request["scale"] or 1.0,
            mirror=request["mirror"],
            pairs=(request["leader_joints"], request["follower_joints"]),
        )
        following.session = FollowingSession(
            follower,
            joints,
            leader.samples,
            functools.partial(self._show, following),
            functools.partial(self._show_targets, following),
        )
        following.session.start()
        followed = ", ".join(f"{link.follower} follows {link.leader}" for link in joints.links)
        log.info("%s follows %s", follower.name, leader.name)
        return f"{follower.name} goes to where {leader.name} is, then {followed}"

    def _check_not_stopped(self, follower: Follower) -> None:
        """Refuse a start that a stop of the arm, or of its following, has overtaken."""
        if is_stopped(max(follower.context.arm.last_stop, self._last_stops.get(follower.name, 0))):
            raise ServiceError(f"{follower.name} does not follow: a stop came after {START} was called")

    def _in_use(self, follower: Follower) -> str:
        busy = follower.context.queue.busy(follower.context.joints)
        return f"{follower.name} cannot follow: it is in use: {busy}" if busy else ""

    async def _wait(self, follower: Follower, limit_s: float, obstacle: Callable[[], str]) -> None:
        """Wait until a start has no obstacle any more, or raise ServiceError with it after the limit [s]."""
        until_s = self._clock() + limit_s
        while text := obstacle():
            if self._clock() > until_s:
                raise ServiceError(text)
            await asyncio.sleep(POLL_S)
            self._check_not_stopped(follower)

    def _running(self, names: Sequence[str]) -> dict[str, FollowingSession]:
        if not (running := self._sessions(names)):
            raise ServiceError(f"no arm follows: call {START}")
        return running

    def _sessions(self, names: Sequence[str]) -> dict[str, FollowingSession]:
        found = {name: each.session for name, each in self._followings.items() if name in names}
        return {name: session for name, session in found.items() if session is not None}

    def _chosen_follower(self, name: str, names: Sequence[str]) -> Follower:
        if name in names:
            return self._followers[name]
        if not name and len(names) == 1:
            return self._followers[names[0]]
        raise ServiceError(f"follower: must be one of {', '.join(names) or 'none'}, not {name[:80]!r}")

    def _forget(self, following: _Following) -> None:
        if self._followings.get(following.follower.name) is not following:
            return
        del self._followings[following.follower.name]
        if following.leader.is_topic:
            self._graph.unsubscribe(following.node, following.leader.name)

    # Messages.

    def _show(self, following: _Following, state: FollowingState) -> None:
        follower = following.follower
        if state.phase is not following.phase:
            following.phase = state.phase
            log.info("teleoperation of %s: %s", follower.name, state.message or state.phase.value)
        names = {"follower": follower.name, "leader": following.leader.name}
        message = {**names, **asdict(state), "phase": state.phase.value}
        self._node.publish(STATE_TOPIC, message)
        if follower.prefix:
            self._nodes[follower.name].publish(STATE_TOPIC, message)
        if state.phase is FollowingPhase.IDLE:
            self._forget(following)

    def _show_targets(self, following: _Following, targets_rad: Mapping[str, float]) -> None:
        """Publish the targets of all followers in one message, as ``/joint_states`` has all joints."""
        following.targets_rad = targets_rad
        present = {name: target for each in self._followings.values() for name, target in each.targets_rad.items()}
        self._node.publish(TARGETS_TOPIC, joint_state_message(present, self._node.message_types.wall_clock()))


def _verb(names: Collection[str], verb: str) -> str:
    one = f"{verb}es" if verb.endswith("o") else f"{verb}s"
    return one if len(names) == 1 else verb
