"""Following in progress: from a leader's samples to a follower's ramp, joints and gripper, tick by tick."""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.servo.question import JointVelocities, ServoAnswer, ServoQuestion, ServoStatus
from server.arrival import arrival_epoch, is_stopped
from server.errors import RefusedError
from server.execution.goal import Answer, Goal, GoTo
from server.execution.monitors import check_ready
from server.lifecycle import end_task
from server.moveit.actions.gripper import Gripper
from server.moveit.requests.planning_context import GoalContext
from server.moveit.servo.servo_loop import LATE, ServoSession, ServoSetup
from server.teleop.following import STALE_S, FollowerAct, Following, FollowingPhase, TrackingLimits, tracking_velocity
from server.teleop.gripper_following import GripperFollowing
from server.teleop.leader import FollowingJoints, JitterBuffer, LeaderPose

log = logging.getLogger("armbridge.teleop")

# A step for each tick of the arm process, whose goals the next one sets [s].
PERIOD_S = 0.01

# Share of the limits on the way to the leader: somebody holds the leader and watches.
RAMP_SCALING = 0.3

# A way to the leader that does not begin, because planners are slow or another motion is in the way, is given up [s].
RAMP_BEGINS_WITHIN_S = 2.0

# Nearer to its leader a follower comes after it by itself; from further away it goes by a planned motion [rad].
MAX_LAG_RAD = 1.2

# States are published as often as people read them [s].
SHOWN_EVERY_S = 0.2


@dataclass(frozen=True)
class Follower:
    """Arm that can follow; the names of its joints begin with the prefix, which is empty for an arm that is alone."""

    name: str
    prefix: str
    context: GoalContext
    setup: ServoSetup
    gripper: Gripper | None
    go_to: GoTo

    @property
    def limits(self) -> dict[str, TrackingLimits]:
        """Limits of the joints that are steered, and of the gripper's."""
        scaling = self.setup.limits.velocity_scaling
        fingers = () if self.gripper is None else self.gripper.joints
        joints = [*(self.context.robot.joints[name] for name in self.setup.joints), *fingers]
        return {joint.name: TrackingLimits(scaling * joint.max_velocity, joint.max_acceleration) for joint in joints}


@dataclass(frozen=True)
class FollowingState:
    """State of a following."""

    phase: FollowingPhase
    message: str
    # From the leader's reading until the arm process has the velocities that follow from it, which its next tick
    # carries out [s].
    latency_s: float
    lag_rad: float  # greatest distance of a joint's goal from its target [rad]
    speed_scale: float  # share of the wanted speed that limits and obstacles leave, 0 to 1


class FollowingSession:
    """Following of one follower, until it ends; shows its state, and its targets at every tick [rad]."""

    def __init__(
        self,
        follower: Follower,
        joints: FollowingJoints,
        samples: JitterBuffer,
        show: Callable[[FollowingState], None],
        show_targets: Callable[[Mapping[str, float]], None],
    ) -> None:
        context, planning = follower.context, follower.context.planning
        self.following = Following()
        self._follower, self._joints, self._samples = follower, joints, samples
        self._queue, self._go_to, self._ask = context.queue, follower.go_to, planning.ask
        self._show, self._show_targets, self._clock = show, show_targets, planning.clock
        self._servo = ServoSession(
            context.arm,
            replace(follower.setup, period_s=PERIOD_S, at_once=True),
            planning,
            self._take_status,
            self._take_interruption,
            self._asked,
        )
        self._limits = follower.limits
        self._epoch = arrival_epoch()
        self._interrupted = ""
        self._warning = ""
        self._ramp: Goal | None = None
        self._ramp_moved_s = 0.0
        # Position [rad or m] and velocity of the gripper's leader.
        self._gripper_lead = 0.0, 0.0
        gripper = follower.gripper
        self._gripper: GripperFollowing | None = None
        if gripper is not None:
            limits = self._limits[gripper.joints[0].name]
            self._gripper = GripperFollowing(gripper, limits, lambda: self._gripper_lead)
        self._read_at_s = self._clock()
        self._latency_s = self._lag_rad = 0.0
        # Set by a sample that is followed at once.
        self._came = asyncio.Event()
        self._period_s = (LATE if samples.at_once else 1.0) * PERIOD_S
        self._speed_scale = 1.0
        self._shown: tuple[FollowingPhase, str] | None = None
        self._shown_at_s = 0.0
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin with the ramp; the state shows it at once, before the client is answered that it begins."""
        self._step()
        self._task = asyncio.create_task(self._run(), name="teleoperation")

    def take_sample(self) -> None:
        """Follow the leader's latest sample now, not with the next period."""
        self._came.set()

    def set_clutch(self, *, closed: bool) -> None:
        self._carry_out(self.following.set_clutch(closed=closed), self._clock())
        self._show_state()

    def end(self, reason: str) -> None:
        """Brake softly and follow no more."""
        self._carry_out(self.following.end(reason), self._clock())
        self._show_state()

    async def close(self) -> None:
        """End at once; the arm comes to rest by itself."""
        self.end("the server is ending")
        await end_task(self._task)
        if self._gripper is not None:
            await self._gripper.close()
        await self._servo.close()

    async def _run(self) -> None:
        try:
            due_s = self._clock() + self._period_s
            while not self.following.ended:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(max(due_s - self._clock(), 0.0)):
                        await self._came.wait()
                due_s = self._clock() + self._period_s
                if not self.following.ended:
                    self._step()
        except Exception:  # a bug must not leave the arm steered by a following that has ended
            log.exception("teleoperation failed")
            self.end("teleoperation failed inside the server")

    def _step(self) -> None:
        self._came.clear()
        now_s = self._clock()
        pose = self._samples.pose(now_s)
        obstacle = self._obstacle(now_s, pose)
        if self._interrupted and not obstacle and self.following.phase is FollowingPhase.FOLLOWING:
            # The planners were late and the arm has come to rest by itself, or the leader is far away.
            self._carry_out(self.following.interrupt(now_s, self._interrupted), now_s)
        self._interrupted = ""
        age_s, jump = self._samples.age_s(now_s), self._samples.take_jump()
        self._carry_out(self.following.tick(now_s, age_s, jump=jump, obstacle=obstacle), now_s, pose)
        if (self.following.phase, self._message) != self._shown or now_s - self._shown_at_s >= SHOWN_EVERY_S:
            self._show_state()

    def _obstacle(self, now_s: float, pose: LeaderPose | None) -> str:
        """Return the reason for which the follower cannot go on; empty if there is none."""
        follower = self._follower
        if is_stopped(follower.context.arm.last_stop, self._epoch):
            return "the arm was stopped"
        try:
            check_ready(follower.context.arm)
        except RefusedError as error:
            return str(error)
        if self.following.phase is FollowingPhase.FOLLOWING and (busy := self._queue.busy(follower.context.joints)):
            return f"the arm is in use: {busy}"
        if self._ramp is not None and self._ramp.remaining_s is not None:
            self._ramp_moved_s = now_s
        if self._ramp is not None and now_s - self._ramp_moved_s > RAMP_BEGINS_WITHIN_S:
            waits = "" if self._ramp.progress is None else f": {self._ramp.progress.message}"
            return f"the follower has not set out for the leader within {RAMP_BEGINS_WITHIN_S:g} s{waits}"
        return "" if pose is None else self._joints.beyond_range(pose.positions_rad)

    def _carry_out(self, act: FollowerAct, now_s: float, pose: LeaderPose | None = None) -> None:
        match act:
            case FollowerAct.RAMP if pose is not None:
                self._begin_ramp(pose, now_s)
            case FollowerAct.FOLLOW if pose is not None:
                self._follow(pose, now_s)
            case FollowerAct.BRAKE:
                self._servo.release()
                if self._ramp is not None:
                    ramp, self._ramp = self._ramp, None
                    self._queue.cancel(ramp.goal_id, self.following.message)
                if self._gripper is not None:
                    self._gripper.end(self.following.message)
                self._speed_scale, self._lag_rad, self._warning = 1.0, 0.0, ""

    def _begin_ramp(self, pose: LeaderPose, now_s: float) -> None:
        targets = self._joints.targets_rad(pose.positions_rad)
        steered = {name: target for name, target in targets.items() if name in self._follower.setup.joints}
        if not steered:
            self.following.take_ramp_end("")
            return
        try:
            ramp = self._ramp = self._go_to(steered, RAMP_SCALING)
            self._ramp_moved_s = now_s
        except RefusedError as error:
            self.following.take_ramp_end(str(error))
            return

        def take(answer: asyncio.Future[Answer]) -> None:
            # The end of a ramp that was given up does not count for the next ramp.
            if self._ramp is ramp:
                self._ramp = None
                reached = answer.result().code is MoveItErrorCode.SUCCESS
                self.following.take_ramp_end("" if reached else answer.result().message)
                # A following that has ended makes no further step that would show it.
                self._show_state()

        ramp.answered.add_done_callback(take)

    def _follow(self, pose: LeaderPose, now_s: float) -> None:
        targets = self._joints.targets_rad(pose.positions_rad)
        steered = {name: target for name, target in targets.items() if name in self._follower.setup.joints}
        goals = self._servo.positions_rad()
        if not goals:
            return
        lags_rad = {name: abs(target - goals[name]) for name, target in steered.items()}
        behind = max(lags_rad, key=lambda name: lags_rad[name], default="")
        self._lag_rad = lags_rad.get(behind, 0.0)
        if self._lag_rad > MAX_LAG_RAD:
            # Taken by the next tick: the follower brakes, and goes to the leader.
            self._interrupted = (
                f"{behind} is {self._lag_rad:.2f} rad behind the leader (limit {MAX_LAG_RAD:g} rad): the follower goes "
                "there by a planned motion"
            )
            return
        leader_rad_s = {}
        for link in self._joints.links:
            target_rad = link.scale * pose.positions_rad.get(link.leader, 0.0)
            # A target that a limit holds has no velocity.
            held = not link.lower_rad < target_rad < link.upper_rad
            leader_rad_s[link.follower] = 0.0 if held else link.scale * pose.velocity_rad_s.get(link.leader, 0.0)
        latency_s = self._servo.latency_s
        velocities = {
            name: tracking_velocity(target - goals[name], leader_rad_s[name], self._limits[name], latency_s)
            for name, target in steered.items()
        }
        self._servo.set_command(JointVelocities(velocities), STALE_S)
        gripper = self._follower.gripper
        if self._gripper is not None and gripper is not None and (joint := gripper.joints[0].name) in targets:
            self._gripper_lead = targets[joint], leader_rad_s[joint]
            self._gripper.start()
        self._read_at_s = now_s - pose.latency_s
        self._show_targets(targets)

    async def _asked(self, question: ServoQuestion) -> ServoAnswer | PlanningFailure:
        read_at_s = self._read_at_s
        answer = await self._ask(question)
        self._latency_s = self._clock() - read_at_s
        self._speed_scale = 0.0 if isinstance(answer, PlanningFailure) else answer.share
        return answer

    def _take_status(self, status: ServoStatus, message: str) -> None:
        self._warning = "" if status is ServoStatus.NO_WARNING else message

    def _take_interruption(self, reason: str) -> None:
        self._interrupted = reason

    @property
    def _message(self) -> str:
        return self.following.message or self._warning

    def _show_state(self) -> None:
        self._shown, self._shown_at_s = (self.following.phase, self._message), self._clock()
        self._show(
            FollowingState(self.following.phase, self._message, self._latency_s, self._lag_rad, self._speed_scale)
        )
