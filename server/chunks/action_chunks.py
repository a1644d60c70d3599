"""The topic and the action ``/arm/chunks``, the answers to chunks, and the services that pause or stop a policy.

A chunk is the joint targets that a learned policy sends for the next second or so. Its motion is checked whole before
it begins, is followed up to the first contact, and takes the place of the chunk before it without a stop. A person's
stick or leader takes over at any moment; the policy goes on when it is resumed.
"""

import functools
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.messages import ListLimits, Stamp
from protocol.publication import PublishedMessage
from robot.description.limits import JointBounds, motion_limits
from robot.description.model import Group, RobotModel
from robot.stop_epochs import STOP_EPOCHS
from robot.trajectory import Trajectory, Vector, refusal
from server.access.control_lease import ControlLease
from server.arrival import arrival_epoch, arrived_in
from server.chunks.targets import SAMPLE_S, Blend, Targets, blended, deviation_rad, follow
from server.diagnostic_values import LEVEL_OK, diagnostic_status
from server.errors import GraphError, RefusedError, invalid_plan, refused
from server.execution.goal import Answer, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import ExternalTrajectory, Positions, SplicePoint, start_of
from server.execution.streams import MessageStream
from server.graph.actions import ActionGoal
from server.graph.permissions import GOAL, STOPPING, WORKING, Node
from server.graph.services import Call
from server.moveit.actions.goal_bridge import cancel_with_goal, goal_status
from server.moveit.actions.gripper import Gripper
from server.moveit.messages import Message, error_code
from server.moveit.requests.planning_context import GoalContext
from server.moveit.trajectories import read_points, read_seconds, smallest_group
from server.teleop.following import TrackingLimits
from server.teleop.gripper_following import LATENCY_S, GripperFollowing

NAME = "/arm/chunks"
TYPE = "armbridge_msgs/ActionChunk"
ACTION_TYPE = "armbridge_msgs/action/FollowActionChunk"
ANSWER = "/arm/chunks/answer"
ANSWER_TYPE = "armbridge_msgs/ActionChunkAnswer"
STATE, STATE_TYPE = "/arm/chunks/state", "diagnostic_msgs/DiagnosticStatus"
PAUSE, RESUME, STOP = "/arm/chunks/pause", "/arm/chunks/resume", "/arm/chunks/stop"

log = logging.getLogger("armbridge.chunks")

# A policy that was stopped has ended when it sends nothing for this time: slow ones send a chunk every two seconds [s].
PAUSE_S = 5.0

# The gripper has come to its last target by then, or holds something [s].
SETTLES_S = 1.0

# Policies send 50 to 100 targets. With positions and velocities of eight joints.
MAX_POINTS = 500
CHUNK_LIMITS = ListLimits({"trajectory_msgs/msg/JointTrajectory.points": MAX_POINTS}, 24 * MAX_POINTS)

# Greatest distance of a target from where the arm will be at its time: at 2 rad/s and 10 Hz targets are 0.2 rad apart
# [rad].
MAX_JUMP_RAD = 0.3

# Distance of the target that is offered in place of a farther one: in motion the arm is elsewhere by then [rad].
NEAREST_RAD = 0.25

# Targets beyond a joint's limits by at most this are moved to the limit; the chunk ends before others [rad].
MOVED_TO_LIMIT_RAD = 0.1

# Clocks of two machines that are synchronised differ by less [s].
MAX_AHEAD_S = 0.1

# Times by which a motion that would touch something ends earlier, for each attempt [s].
CUTS_S = (0.1, 0.2, 0.4)


@dataclass(frozen=True)
class Chunk:
    """Chunk as it came.

    Attributes:
        observed_s: monotonic time of its trajectory's stamp, or of its arrival without one [s].
        targets: targets of all named joints, within the joints' limits.
        moved_rad: greatest distance by which a target was moved to a limit [rad].
        end: index of the first target that is not followed, and the reason; None where all are.
    """

    chunk_id: str
    observed_s: float
    targets: Targets
    blend: Blend
    weight: float
    moved_rad: float
    end: tuple[int, str] | None


def read_chunk(message: Message, robot: RobotModel, joints: frozenset[str], now_s: float, wall_s: float) -> Chunk:
    """Read an armbridge_msgs/ActionChunk; raises RefusedError.

    Args:
        joints: joints that it may name.
        now_s: present time, monotonic [s].
        wall_s: present time [s since the epoch].
    """
    trajectory = message["trajectory"]
    blends = [each.value for each in Blend]
    if (blend := message["blend"] or Blend.REPLACE.value) not in blends:
        raise invalid_plan(f"blend must be one of {', '.join(blends)}, not {blend[:80]!r}")
    if not 0.0 <= (weight := message["weight"]) <= 1.0:
        raise invalid_plan(f"weight must be 0 to 1, not {weight:g}")
    names, times_s, positions, _, _ = read_points(trajectory, robot)
    if others := sorted(set(names) - joints):
        raise invalid_plan(f"trajectory.joint_names has {others[0]!r}, which is no joint of this arm: {sorted(joints)}")
    stamp_s = read_seconds(trajectory["header"]["stamp"], "trajectory.header.stamp")
    age_s = wall_s - stamp_s if stamp_s else 0.0
    if age_s < -MAX_AHEAD_S:
        text = (
            f"trajectory.header.stamp is {-age_s:.3g} s in the future (limit {MAX_AHEAD_S} s): set both clocks by NTP"
        )
        raise invalid_plan(text)
    if times_s[-1] <= age_s:
        text = f"the last target was due {age_s - times_s[-1]:.3g} s ago: trajectory.header.stamp is {age_s:.3g} s old"
        raise invalid_plan(text)
    bounds = JointBounds.of(robot, names)
    within = np.clip(positions, bounds.lower_rad, bounds.upper_rad)
    moved = np.abs(positions - within)
    beyond = np.flatnonzero((moved > MOVED_TO_LIMIT_RAD).any(axis=1))
    end = None
    if beyond.size:
        first = int(beyond[0])
        column = int(np.argmax(moved[first]))
        unit = robot.joints[names[column]].unit
        reason = (
            f"it takes {names[column]} to {positions[first, column]:.3f} {unit}, beyond its limits "
            f"{bounds.lower_rad[column]:.3f} to {bounds.upper_rad[column]:.3f} {unit}"
        )
        if first == 0 or times_s[first - 1] <= age_s:
            raise invalid_plan(f"target {first}: {reason}")
        end = first, reason
        times_s, within, moved = times_s[:first], within[:first], moved[:first]
    targets = Targets(names, now_s - age_s + times_s, within)
    return Chunk(message["id"], now_s - age_s, targets, Blend(blend), weight, float(moved.max()), end)


class ChunkMotion:
    """Motion of the arm's joints of a chunk, from targets that are blended with the targets of the chunk before.

    Attributes:
        made: latest motion that was made, and the time of its start [s]; None before the first.
        joints: joints of the group that it moves.
        end: index of the chunk's first target that is not followed, and the reason; None where all are.
        until_s: monotonic time of the last target that is followed [s].
    """

    def __init__(self, chunk: Chunk, targets: Targets, group: Group, robot: RobotModel, speed_limit: float) -> None:
        self.chunk, self._targets, self._robot = chunk, targets, robot
        self.joints, self._bounds = group.joints, JointBounds.of(robot, group.joints)
        self._limits = motion_limits(robot, group.joints, speed_limit)
        self._begins_s = 0.0
        self._cuts = list(CUTS_S)
        self.made: tuple[Trajectory, float] | None = None
        self.end = chunk.end
        self.until_s = targets.end_s

    @property
    def targets(self) -> Targets:
        """Targets that are followed, up to a contact."""
        return self._targets if self.until_s >= self._targets.end_s else self._targets.until(self.until_s)

    @property
    def change_rad(self) -> float:
        """Greatest distance of the motion from the chunk's targets [rad]."""
        if self.made is None:
            return self.chunk.moved_rad
        motion, at_s = self.made
        names = tuple(name for name in self.joints if name in self.chunk.targets.joint_names)
        away_rad = deviation_rad(self.chunk.targets.of_joints(names), motion.of_joints(names), at_s)
        return max(self.chunk.moved_rad, float(away_rad.max(initial=0.0)))

    def first_after(self, at_s: float) -> int:
        """Return the index of the chunk's first target after a time [s]; -1 where there is none."""
        times_s = self.chunk.targets.time_s
        return int(np.searchsorted(times_s, at_s, side="right")) if at_s < times_s[-1] else -1

    @property
    def motion(self) -> ExternalTrajectory:
        return ExternalTrajectory(self._make, frozenset(self.joints), cut=self._cut)

    def _make(self, held_rad: Positions, at_s: float, point: SplicePoint | None) -> Trajectory:
        start = start_of(self.joints, held_rad, point)
        if self.until_s <= at_s:
            late = f"the last target was due {at_s - self.until_s:.3g} s ago"
            raise invalid_plan(late if self.end is None else self.end[1])
        targets = self._of_all_joints(start[0])
        check_jump(targets, dict(zip(self.joints, start[0].tolist(), strict=True)), at_s, self._robot)
        # A chunk that begins at rest has its history where the arm stands.
        if point is None:
            later = targets.time_s > at_s
            targets = replace(
                targets,
                time_s=np.concatenate(([at_s], targets.time_s[later])),
                positions_rad=np.vstack((start[0], targets.positions_rad[later])),
            )
        motion = follow(targets, start, at_s, self._limits)
        if reason := refusal(motion, self.joints, self._bounds, start[0], in_motion=True):
            raise invalid_plan(reason)
        self._begins_s = at_s - (0.0 if point is None else point.lead.duration_s)
        self.made = motion, at_s
        return motion

    def _of_all_joints(self, start_rad: Vector) -> Targets:
        """Return targets of all joints of the group; joints that the chunk does not name stand still."""
        targets = self.targets
        columns = [
            targets.positions_rad[:, targets.joint_names.index(name)]
            if name in targets.joint_names
            else np.full(len(targets.time_s), start_rad[index])
            for index, name in enumerate(self.joints)
        ]
        return Targets(self.joints, targets.time_s, np.stack(columns, axis=-1))

    def _cut(self, failure: PlanningFailure) -> ExternalTrajectory | None:
        """Return the motion that ends before a contact; None where the failure is another, or no target is left."""
        if "contact_s" not in failure.details or not self._cuts:
            return None
        # A later attempt may find the same contact a little earlier.
        contact_s = self._begins_s + failure.details["contact_s"]
        self.until_s = min(self.until_s, contact_s) - self._cuts.pop(0)
        self.end = self.first_after(self.until_s), failure.message
        return self.motion if self.until_s > self._begins_s else None


def check_jump(targets: Targets, present_rad: Positions, at_s: float, robot: RobotModel) -> None:
    """Refuse targets that are far from where the joints are at a time."""
    wanted = _first(targets, at_s)
    present = np.array([present_rad[name] for name in targets.joint_names])
    away = np.abs(wanted - present)
    worst = int(np.argmax(away))
    if away[worst] > MAX_JUMP_RAD:
        name = targets.joint_names[worst]
        unit = robot.joints[name].unit
        text = (
            f"the first target takes joint {name} to {wanted[worst]:.3f} {unit}, {away[worst]:.2f} {unit} from where "
            f"it is (limit {MAX_JUMP_RAD} {unit}): move the arm there by a goal first"
        )
        nearest = present + np.clip(wanted - present, -NEAREST_RAD, NEAREST_RAD)
        raise invalid_plan(text, nearest_rad=dict(zip(targets.joint_names, nearest.tolist(), strict=True)))


def _first(targets: Targets, at_s: float) -> Vector:
    """Return the targets at a time, or the first ones after it, shape (joints,)."""
    first: Vector = targets.at(np.array([max(at_s, float(targets.time_s[0]))]))[0]
    return first


class PolicyPhase(StrEnum):
    """Phases of an arm's policy."""

    IDLE = "idle"
    FOLLOWING = "following"
    PAUSED = "paused"
    TAKEN_OVER = "taken_over"


# Phases in which chunks are refused until the policy is resumed.
HALTED = (PolicyPhase.PAUSED, PolicyPhase.TAKEN_OVER)


@dataclass
class _Followed:
    """Chunk that is followed, or waits for its turn; ``goal`` is the action's, ``begun_until_s`` the answered end."""

    publisher: object
    motion: ChunkMotion
    epoch: int
    goal: ActionGoal | None
    number: str = ""
    begun_until_s: float = math.nan
    over: bool = False


class ActionChunks:
    """The topics, the action and the services of one arm."""

    def __init__(self, context: GoalContext, gripper: Gripper | None, lease: ControlLease) -> None:
        self._arm, self._joints, self._lease = context.arm, context.joints, lease
        planning = self._planning = context.planning
        self._queue, self._robot, self._clock = context.queue, planning.robot, planning.clock
        self._followed: _Followed | None = None
        self._gripper: GripperFollowing | None = None
        self._finger_targets: Targets | None = None
        if gripper is not None:
            limits = TrackingLimits(gripper.joints[0].max_velocity, gripper.joints[0].max_acceleration)
            self._gripper = GripperFollowing(gripper, limits, self._gripper_lead)
        self._fingers = () if gripper is None else tuple(joint.name for joint in gripper.joints)
        self._stream = MessageStream(context.graph.resolve(NAME), PAUSE_S)
        node = self._node = context.graph.node("chunks")
        node.advertise(ANSWER, ANSWER_TYPE)
        node.offer_action(NAME, ACTION_TYPE, self._start, CHUNK_LIMITS, rule=GOAL)
        node.subscribe(NAME, TYPE, self._take, limits=CHUNK_LIMITS, rule=GOAL)
        # Times of the last followed chunk and of the last resumption [s], and stop epoch of the policy's last stop.
        self._heard_s, self._resumed_s, self._last_stop = -math.inf, -math.inf, 0
        # The last stick or leader in words, and a function that returns True while it moves the arm.
        self._hand: tuple[str, Callable[[], bool]] | None = None
        self._phase, self._message = PolicyPhase.IDLE, ""
        node.advertise(STATE, STATE_TYPE, latch=True)
        self._show(PolicyPhase.IDLE, "no chunk is followed")
        self._queue.give_way(context.joints.difference(self._fingers), self._take_over)
        node.offer(PAUSE, "std_srvs/Trigger", self._pause, rule=WORKING)
        node.offer_calls(RESUME, "std_srvs/Trigger", self._resume, rule=WORKING)
        node.offer(STOP, "std_srvs/Trigger", self._stop, rule=STOPPING)
        context.graph.graph.on_leave(self._leave)

    def _leave(self, client: Node) -> None:
        """Brake on the path of a chunk whose client has left, if it takes its goals along."""
        if client.takes_goals_along and self._followed is not None and self._followed.publisher is client:
            self._brake(self._followed, f"{client} has left")

    async def close(self) -> None:
        if self._gripper is not None:
            self._gripper.end("the server is ending")
            await self._gripper.close()

    def _take(self, published: PublishedMessage) -> None:
        message = published.msg
        try:
            self._submit(NAME, message, published.publisher)
        except RefusedError as error:
            self._node.publish(ANSWER, refused_answer(message, error))
            raise GraphError("topic", self._node.resolve(NAME), error.failure.message) from error

    def _start(self, goal: ActionGoal) -> None:
        message = goal.request["chunk"]
        try:
            number = self._submit(goal.action, message, goal.sender, goal)
        except RefusedError as error:
            answer = refused_answer(message, error)
            self._node.publish(ANSWER, answer)
            goal.finish(goal_status(error.failure.code), {"answer": answer})
        else:
            cancel_with_goal(goal, functools.partial(self._queue.cancel, number))

    def _submit(self, source: str, message: Message, publisher: object, goal: ActionGoal | None = None) -> str:
        """Queue the motion of a chunk; return the number of its goal, or raise RefusedError."""
        now_s, former = self._clock(), self._followed
        self._stream.check(max(self._arm.last_stop, self._last_stop))
        if self._hand is not None and self._hand[1]():
            self._halt(PolicyPhase.TAKEN_OVER, f"{self._hand[0]} has taken over")
        if self._phase in HALTED:
            # The request has given its client control, which the person may need.
            self._leave_control(publisher)
            resume = self._node.resolve(RESUME)
            raise refused(MoveItErrorCode.CONTROL_FAILED, f"{self._message}: the policy goes on after {resume}")
        if self._arm.rate != 1.0:
            text = f"targets of a policy have real times: simulation.rate must be 1 for them, not {self._arm.rate:g}"
            raise refused(MoveItErrorCode.CONTROL_FAILED, text)
        chunk = read_chunk(message, self._robot, self._joints, now_s, time.time())
        if chunk.observed_s < self._resumed_s:
            text = "trajectory.header.stamp is from before the policy was resumed: send a chunk of a later observation"
            raise invalid_plan(text)
        if former is not None and not former.over and former.publisher is not publisher:
            raise refused(
                MoveItErrorCode.CONTROL_FAILED,
                f"the arm follows the chunks of {former.publisher}: they must end before another client's are followed",
            )
        motion = self._motion(chunk, None if former is None or former.over else former.motion.targets, now_s)
        followed = self._followed = _Followed(publisher, motion, arrival_epoch(), goal)
        self._heard_s = now_s
        queued = self._queue.submit(
            GoalRequest(
                source,
                motion.motion,
                client=publisher,
                policy=GoalPolicy.PREEMPT,
                on_progress=functools.partial(self._take_progress, followed),
                on_answer=functools.partial(self._take_answer, followed),
                streamed=True,
            )
        )
        followed.number = queued.goal_id
        return queued.goal_id

    # Pause, take-over and stop.

    def _take_over(self, hand: str, moves: Callable[[], bool]) -> None:
        """Give way to a person; a policy that has been silent for `PAUSE_S` gives way with its next chunk."""
        self._hand = hand, moves
        recent = self._clock() - self._heard_s <= PAUSE_S
        if self._phase is PolicyPhase.PAUSED or (self._phase is not PolicyPhase.TAKEN_OVER and recent):
            self._halt(PolicyPhase.TAKEN_OVER, f"{hand} has taken over")

    def _pause(self, _request: Message) -> str:
        if self._phase is not PolicyPhase.TAKEN_OVER:
            self._halt(PolicyPhase.PAUSED, "the policy is paused")
        return self._message

    def _resume(self, call: Call) -> None:
        self._leave_control(call.caller)
        self._resumed_s, self._hand = self._clock(), None
        self._show(PolicyPhase.IDLE, "the next chunk is followed")
        call.succeed({"success": True, "message": self._message})

    def _stop(self, _request: Message) -> str:
        self._last_stop, self._heard_s = STOP_EPOCHS.begin(), -math.inf
        self._halt(PolicyPhase.IDLE, "the policy is stopped")
        return self._message

    def _halt(self, phase: PolicyPhase, message: str) -> None:
        """Brake on the path of the chunk that is followed, and hold; another client may take control."""
        self._show(phase, message)
        if self._followed is not None:
            self._leave_control(self._followed.publisher)
            self._brake(self._followed, message)

    def _brake(self, followed: _Followed, reason: str) -> None:
        self._queue.cancel(followed.number, reason)
        if self._gripper is not None:
            # Its fingers may be on their way when the arm has come to its last target.
            self._gripper.end(reason)

    def _leave_control(self, client: object) -> None:
        if isinstance(client, Node):
            self._lease.leave(client)

    def _show(self, phase: PolicyPhase, message: str) -> None:
        if (phase, message) == (self._phase, self._message):
            return
        if phase in HALTED or self._phase in HALTED:
            log.info("%s: %s", self._node.resolve(NAME), message)
        self._phase, self._message = phase, message
        client = "" if self._followed is None else str(self._followed.publisher)
        values = {"phase": phase.value, "client": client}
        self._node.publish(STATE, diagnostic_status(LEVEL_OK, "policy", message, values))

    # Progress and answers.

    def _take_progress(self, followed: _Followed, progress: Progress) -> None:
        motion = followed.motion
        # A motion that is sent to the arm again has its answer already; a motion that was cut gets another.
        if progress.state is not GoalState.EXECUTING or motion.until_s == followed.begun_until_s:
            return
        followed.begun_until_s = motion.until_s
        first = self._fingers[:1]
        if self._gripper is not None and first[0] in motion.chunk.targets.joint_names:
            self._finger_targets = motion.chunk.targets.of_joints(first).until(motion.until_s)
            # A stop that came after the chunk keeps its gripper still, too.
            with arrived_in(followed.epoch):
                self._gripper.start()
        self._show(PolicyPhase.FOLLOWING, f"{followed.publisher} moves the arm")
        answer = self._answer(followed, Answer(MoveItErrorCode.SUCCESS, begun_message(motion)))
        self._node.publish(ANSWER, answer)
        if followed.goal is not None:
            followed.goal.feedback({"answer": answer})

    def _take_answer(self, followed: _Followed, answer: Answer) -> None:
        followed.over = True
        joined = answer.code is MoveItErrorCode.PREEMPTED and self._followed is not followed
        if joined and followed.begun_until_s > 0.0 and followed.goal is None:
            # It has its answer, and the next chunk waits.
            return
        end, failed = self._answer(followed, answer), answer.code is not MoveItErrorCode.SUCCESS
        if failed and not joined and self._gripper is not None:
            # The arm holds, and so does its gripper.
            self._gripper.end(answer.message)
        # A chunk that another has joined has its answer, unless the other came before it began.
        if failed and not (joined and followed.begun_until_s > 0.0):
            self._node.publish(ANSWER, end)
        if followed is self._followed and self._phase is PolicyPhase.FOLLOWING:
            self._show(PolicyPhase.IDLE, "no chunk is followed")
        if followed.goal is not None:
            followed.goal.finish(goal_status(answer.code), {"answer": end})

    def _gripper_lead(self) -> tuple[float, float] | None:
        """Return position [rad or m] and velocity of the first finger's target, None some time after the last one."""
        targets, at_s = self._finger_targets, self._clock() + LATENCY_S
        if targets is None or at_s > targets.end_s + SETTLES_S:
            return None
        position, ahead = targets.at(np.array([at_s, at_s + SAMPLE_S]))[:, 0].tolist()
        return position, (ahead - position) / SAMPLE_S

    def _motion(self, chunk: Chunk, former: Targets | None, now_s: float) -> ChunkMotion:
        """Make the motion of the arm's joints, blended with the targets that it follows now; may raise RefusedError."""
        current = self._planning.current
        names = tuple(name for name in chunk.targets.joint_names if name not in self._fingers)
        group = smallest_group(self._robot, names)
        if not names or group is None:
            raise invalid_plan(f"trajectory.joint_names {list(names)} must be of one group, beside the gripper's")
        targets = chunk.targets.of_joints(names)
        if former is not None and former.joint_names != names:
            former = None
        # An arm that begins to move, or moves at a speed limit, is behind the former targets: near either is enough.
        away_rad = math.inf if former is None else np.abs(_first(targets, now_s) - _first(former, now_s)).max()
        if away_rad > MAX_JUMP_RAD and (present_rad := current.positions_rad()) is not None:
            check_jump(targets, present_rad, now_s, self._robot)
        field = "the time to the last target"
        self._planning.time_limits.check_duration(targets.end_s - now_s, field, MoveItErrorCode.INVALID_MOTION_PLAN)
        targets = blended(former, targets, chunk.blend, chunk.weight, now_s)
        return ChunkMotion(chunk, targets, group, self._robot, current.speed_limit(group.joints))

    def _answer(self, followed: _Followed, answer: Answer) -> Message:
        """Return the answer to a chunk: how far it is followed, or that it ends now where the arm holds."""
        motion, now_s = followed.motion, self._clock()
        until_s, index, nearest = motion.until_s, -1 if motion.end is None else motion.end[0], {}
        if answer.code is MoveItErrorCode.SUCCESS:
            if motion.end is not None and motion.made is not None:
                nearest = dict(zip(motion.made[0].joint_names, motion.made[0].positions_rad[-1].tolist(), strict=True))
        else:
            until_s = min(until_s, now_s) if followed.begun_until_s > 0.0 else -math.inf
            index = after if (after := motion.first_after(until_s)) >= 0 else index
            held_rad = self._planning.current.positions_rad()
            if held_rad is not None and self._followed is followed:
                nearest = answer.details.get("nearest_rad") or {name: held_rad[name] for name in motion.joints}
        return {
            "id": motion.chunk.chunk_id,
            "error_code": error_code(answer.code),
            "message": answer.message,
            "followed_until": Stamp.from_seconds(max(time.time() + until_s - now_s, 0.0)).as_message(),
            "change": motion.change_rad,
            "refused_from": index,
            "joint_names": list(nearest),
            "nearest": list(nearest.values()),
        }


def begun_message(motion: ChunkMotion) -> str:
    """Describe in words how far a chunk is followed."""
    parts = [f"followed, changed by at most {motion.change_rad:.3f} rad"]
    if motion.end is not None:
        index, reason = motion.end
        parts.append(f"refused from target {index}: {reason}; the arm holds before it")
    return "; ".join(parts)


def refused_answer(message: Message, error: RefusedError) -> Message:
    """Return the answer to a refused chunk."""
    failure, nearest = error.failure, error.failure.details.get("nearest_rad", {})
    answer = {"id": message["id"], "error_code": error_code(failure.code), "message": failure.message}
    return {**answer, "joint_names": list(nearest), "nearest": list(nearest.values())}
