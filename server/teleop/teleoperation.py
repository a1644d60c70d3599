"""Leader and follower for clients: the services under ``/teleop/``, and the topics that tell of the following."""

from __future__ import annotations

import asyncio
import functools
import logging
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from planners.problem import MoveItErrorCode
from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from robot.messages import ArmState
from server.errors import RefusedError, ServiceError
from server.execution.monitors import check_ready
from server.execution.queue import Answer
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.gripper import Gripper, GripperCommand
from server.moveit.poses import Message
from server.teleop.following import Ask, Follower, Following, Phase, Shown
from server.teleop.leader import LeaderTrack, MappedJoint, joint_map

log = logging.getLogger("armbridge.teleop")

START = "/teleop/start"
STOP = "/teleop/stop"
CLUTCH = "/teleop/clutch"
STATE_TOPIC = "/teleop/state"
LEADER_TOPIC = "/teleop/leader_joint_states"

# Figures are published as often as people read them; another phase or sentence at once [s].
SHOWN_EVERY_S = 0.2

# Time for the first sample of a leader on a topic [s].
FIRST_SAMPLE_S = 2.0

# Scales beyond are slips of the pen: the follower would leave its limits at once.
LEAST_SCALE, MOST_SCALE = 0.05, 5.0

# Joints of a leader; no arm comes near.
MAX_JOINTS = 100

# Share of the limits on the way to where the leader is.
APPROACH_SCALING = 0.3

# Starts a goal; returns its number and its answer to come.
GoTo = Callable[[Mapping[str, float], float], "tuple[str, asyncio.Future[Answer]]"]


class Way:
    """Planned ways of a follower, by the goal queue.

    Args:
        go_to: starts one.
        cancel: cancels one by its number, for a reason.
    """

    def __init__(self, go_to: GoTo, cancel: Callable[[str, str], None]) -> None:
        self._go_to = go_to
        self._cancel = cancel
        self._number = ""

    async def reach(self, position_rad: Mapping[str, float]) -> str:
        """Go to positions of joints; return what keeps the arm from that, empty when it is there."""
        self._number, answered = self._go_to(position_rad, APPROACH_SCALING)
        answer = await answered
        return "" if answer.code is MoveItErrorCode.SUCCESS else answer.message

    def give_up(self, reason: str) -> None:
        """End the way that is played."""
        self._cancel(self._number, reason)


class GripperFollower:
    """Gripper that goes where it is sent, the newest goal in place of the one before.

    Args:
        gripper: the gripper; its torque limit holds.
    """

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper
        self._tasks: set[asyncio.Task[None]] = set()

    def send(self, position: float) -> None:
        """Send it to a position [rad or m]."""
        task = asyncio.create_task(self._move(self._gripper.claim(), position), name="gripper of a follower")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _move(self, claim: int, position: float) -> None:
        try:
            await self._gripper.move(claim, GripperCommand(position), lambda _reading: None)
        except RefusedError as error:
            log.warning("the follower's gripper: %s", error)


@dataclass
class _Pair:
    """Following in progress."""

    leader: str
    following: Following
    track: LeaderTrack
    node: Node | None
    task: asyncio.Task[None] | None = None
    shown: Shown | None = None
    shown_at_s: float = -math.inf


class Teleoperation:
    """Following of arms, one leader each.

    Args:
        graph: where the services and topics are.
        followers: arms that may follow, by name; that of a server with one arm has an empty name.
        leaders: joints of the leaders that are arms of this server, by name.
        ask: asks the planners in the present scene.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        graph: Graph,
        followers: Mapping[str, Follower],
        leaders: Mapping[str, Sequence[str]],
        ask: Ask,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._graph = graph
        self._followers = followers
        self._leaders = leaders
        self._ask = ask
        self._clock = clock
        self._node = Node("teleop")
        self._pairs: dict[str, _Pair] = {}
        # Latest state of leaders that are arms of this server.
        self._states: dict[str, ArmState] = {}

    def open(self) -> None:
        """Offer the services, and advertise the topics."""
        self._graph.advertise(self._node, STATE_TOPIC, "armbridge_msgs/TeleopState", latch=True)
        self._graph.advertise(self._node, LEADER_TOPIC, "sensor_msgs/JointState")
        offer = self._graph.services.offer
        offer(self._node, START, "armbridge_msgs/srv/StartTeleop", lambda request: _answered(self._start(request)))
        offer(self._node, STOP, "std_srvs/Trigger", self._stop)
        offer(self._node, CLUTCH, "std_srvs/SetBool", self._switch_clutch)

    @property
    def active(self) -> bool:
        """True while an arm follows, which needs every state of its leader."""
        return bool(self._pairs)

    async def close(self) -> None:
        """End every following."""
        tasks = [pair.task for pair in self._pairs.values() if pair.task is not None]
        self.end_all("the server is ending")
        if tasks:
            await asyncio.wait(tasks, timeout=1.0)

    def end_all(self, reason: str) -> None:
        """End every following, for a reason."""
        for pair in list(self._pairs.values()):
            pair.following.stop(reason)

    def take_leader(self, name: str, state: ArmState) -> None:
        """Take the latest state of a leader that is an arm of this server."""
        self._states[name] = state
        for pair in self._pairs.values():
            if pair.leader == name:
                if state.driven or state.position_rad is None:
                    reason = "has torque" if state.driven else "is not connected"
                    pair.following.stop(f"the leader {name} {reason}: the follower holds")
                    continue
                positions = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
                pair.track.add(state.stamp_s, self._clock(), positions)
                pair.following.wake()

    # Services.

    async def _start(self, request: Message) -> str:
        leader = request["leader"]
        follower = self._follower(request["follower"])
        name = follower.name
        self._check_free(name)
        scale = request["scale"] or 1.0
        if not (math.isfinite(scale) and LEAST_SCALE <= scale <= MOST_SCALE):
            raise ServiceError(f"scale: must be {LEAST_SCALE:g} to {MOST_SCALE:g}, 0 for 1, not {scale:g}")
        check_ready(follower.arm)
        track = LeaderTrack()
        node, joints = await self._leader_joints(leader, track)
        try:
            # Another client may have begun while the first sample was waited for.
            self._check_free(name)
            names = request["leader_joints"], request["follower_joints"]
            prefixes = f"{leader}_", follower.prefix
            mapped = joint_map(joints, follower.robot, names, prefixes, scale=scale, mirror=request["mirror"])
            self._begin(name, leader, follower, track, mapped, node, relative=scale != 1.0)
        except ServiceError:
            self._forget(node, leader)
            raise
        return (
            f"{name or 'the arm'} follows {leader}, {', '.join(joint.follower for joint in mapped)}: see {STATE_TOPIC}"
        )

    def _check_free(self, name: str) -> None:
        if name in self._pairs:
            raise ServiceError(f"{name or 'the arm'} follows {self._pairs[name].leader} already: call {STOP} first")

    def _follower(self, name: str) -> Follower:
        if name not in self._followers and not name and len(self._followers) == 1:
            name = next(iter(self._followers))
        if name not in self._followers:
            known = ", ".join(repr(each) for each in self._followers) or "none"
            raise ServiceError(f"follower: there is no arm {name[:80]!r} that may follow, but {known}")
        return self._followers[name]

    async def _leader_joints(self, leader: str, track: LeaderTrack) -> tuple[Node | None, tuple[str, ...]]:
        """Return who listens to a leader, None to one of this server, and the leader's joints."""
        if leader in self._leaders:
            state = self._states.get(leader)
            if state is None or state.position_rad is None:
                raise ServiceError(f"leader: {leader} is not connected")
            if state.driven:
                raise ServiceError(f"leader: {leader} has torque, relax it by /{leader}/arm/relax")
            return None, tuple(self._leaders[leader])
        if not leader.startswith("/"):
            known = ", ".join(repr(each) for each in self._leaders) or "no leader of this server"
            raise ServiceError(f"leader: must be {known}, or a topic of sensor_msgs/JointState, not {leader[:80]!r}")
        return await self._listen(leader, track)

    async def _listen(self, topic: str, track: LeaderTrack) -> tuple[Node, tuple[str, ...]]:
        """Subscribe to a leader's topic, and wait for its first sample."""
        node = Node(f"follower of {topic}")
        heard: asyncio.Future[tuple[str, ...]] = asyncio.get_running_loop().create_future()

        def deliver(published: PublishedMessage) -> None:
            message = published.msg
            names, values = message["name"], message["position"]
            if len(names) != len(values) or not 0 < len(names) <= MAX_JOINTS:
                return
            stamp = message["header"]["stamp"]
            stamp_s = stamp["sec"] + stamp["nanosec"] * 1e-9
            track.add(stamp_s, self._clock(), dict(zip(names, map(float, values), strict=True)))
            if not heard.done():
                heard.set_result(tuple(names))
            for pair in self._pairs.values():
                if pair.track is track:
                    pair.following.wake()

        self._graph.subscribe(node, topic, "sensor_msgs/JointState", Subscriber(deliver))
        try:
            async with asyncio.timeout(FIRST_SAMPLE_S):
                return node, await heard
        except TimeoutError as error:
            self._graph.remove(node)
            raise ServiceError(f"leader: nothing comes on {topic} within {FIRST_SAMPLE_S:g} s") from error

    def _begin(
        self,
        name: str,
        leader: str,
        follower: Follower,
        track: LeaderTrack,
        mapped: Sequence[MappedJoint],
        node: Node | None,
        *,
        relative: bool,
    ) -> None:
        listener = _Listener(functools.partial(self._show, name), functools.partial(self._publish_followed, follower))
        following = Following(follower, track, mapped, self._ask, listener, self._clock, relative=relative)
        if following.unmapped:
            raise ServiceError(f"no joint of the group {follower.robot.default_group} follows")
        pair = self._pairs[name] = _Pair(leader, following, track, node)
        if leader in self._states:
            self.take_leader(leader, self._states[leader])
        pair.task = asyncio.create_task(self._run(name, pair), name=f"following of {leader}")

    async def _run(self, name: str, pair: _Pair) -> None:
        reason = "following failed; the log has the cause"
        try:
            reason = await pair.following.run()
        except Exception:  # a bug must not leave a follower without an end that is told
            log.exception("following failed")
            self._show(name, Shown(Phase.IDLE, reason))
        finally:
            log.info("%s no longer follows %s: %s", name or "the arm", pair.leader, reason)
            self._pairs.pop(name, None)
            self._forget(pair.node, pair.leader)

    def _forget(self, node: Node | None, leader: str) -> None:
        if node is not None:
            self._graph.unsubscribe(node, leader)

    def _stop(self, _request: Message) -> dict[str, Any]:
        if not self._pairs:
            return {"success": True, "message": "no arm follows"}
        self.end_all(f"stopped by {STOP}")
        return {"success": True, "message": "the followers come to rest"}

    def _switch_clutch(self, request: Message) -> dict[str, Any]:
        if not self._pairs:
            return {"success": False, "message": f"no arm follows: call {START}"}
        for pair in self._pairs.values():
            pair.following.close_clutch(closed=request["data"])
        said = "closed: the followers go to where their leaders are" if request["data"] else "open: the followers hold"
        return {"success": True, "message": f"the clutch is {said}"}

    # Topics.

    def _show(self, name: str, shown: Shown) -> None:
        pair = self._pairs.get(name)
        now_s = self._clock()
        if pair is not None:
            last = pair.shown
            same = last is not None and (last.phase, last.message) == (shown.phase, shown.message)
            if same and now_s - pair.shown_at_s < SHOWN_EVERY_S:
                return
            pair.shown, pair.shown_at_s = shown, now_s
        message = {
            "follower": name,
            "leader": "" if pair is None else pair.leader,
            "phase": shown.phase.value,
            "message": shown.message,
            "latency_s": shown.latency_s,
            "lag_rad": shown.lag_rad,
            "speed_scale": shown.speed_scale,
        }
        self._graph.publish(self._node, STATE_TOPIC, message)

    def _publish_followed(self, _follower: Follower, position_rad: Mapping[str, float]) -> None:
        stamp = Stamp.from_seconds(time.time()).as_message()
        message = {
            "header": {"stamp": stamp, "frame_id": ""},
            "name": list(position_rad),
            "position": list(position_rad.values()),
            "velocity": [],
            "effort": [],
        }
        self._graph.publish(self._node, LEADER_TOPIC, message)


@dataclass(frozen=True)
class _Listener:
    """What :class:`server.teleop.following.Following` tells, passed on."""

    show: Callable[[Shown], None]
    followed: Callable[[Mapping[str, float]], None]


async def _answered(work: Awaitable[str]) -> dict[str, Any]:
    """Return the response of a service whose work ends with a sentence, or with the reason against it."""
    try:
        return {"success": True, "message": await work}
    except (ServiceError, RefusedError) as error:
        return {"success": False, "message": str(error)}
