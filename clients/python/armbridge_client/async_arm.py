"""An arm on an armbridge server, for programs with an event loop; `armbridge_client.arm` has the same without one."""

from __future__ import annotations

import os
import ssl
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, TypeVar

from armbridge_client.async_gripper import AsyncGripper
from armbridge_client.async_library import AsyncEpisodes, AsyncNamedStates, AsyncTeaching
from armbridge_client.async_scene import AsyncScene
from armbridge_client.async_steering import COMMAND_TIMEOUT_S, AsyncChunks, AsyncJog, AsyncTeleop
from armbridge_client.connection import CALL_TIMEOUT_S, Address, Connection, ServerInfo, Subscription
from armbridge_client.errors import ArmError, GoalRefused
from armbridge_client.interface import find_arm
from armbridge_client.messages import (
    CheckGoalsRequest,
    DiagnosticStatus,
    GetCartesianPathRequest,
    GetMotionPlanRequest,
    GetPositionFKRequest,
    GoalCheck,
    GoalTarget,
    Header,
    JointState,
    MotionPlanRequest,
    MoveItErrorCode,
    MoveitGoalFeedback,
    MoveitGoalGoal,
    MoveitGoalRequest,
    MoveitGoalResult,
    PoseStamped,
    SetBoolRequest,
    SetSpeedLimitRequest,
    String,
    TriggerRequest,
)
from armbridge_client.motion import MOTION_TIMEOUT_S, AsyncPlan, Motion, check_code, motion_of
from armbridge_client.targets import (
    Control,
    State,
    Target,
    WaitingGoal,
    constraints,
    goal_target,
    pose,
    state_of,
    stops_of,
)
from armbridge_client.wire import Message, Response, Service, from_wire

M = TypeVar("M", bound=Message)

PLAN_TIMEOUT_S = 30.0
# The server answers a stop when the arm stands, at the latest after 6 s (docs/goals.md); parking is a motion.
SWITCH_TIMEOUT_S = 8.0


async def connect_async(
    url: str = "ws://127.0.0.1:9090",
    *,
    token: str | None = None,
    arm: str = "",
    tls: ssl.SSLContext | None = None,
    on_disconnect: Literal["stop", "finish"] = "stop",
    timeout_s: float = CALL_TIMEOUT_S,
) -> AsyncArm:
    """Connect to a server, for programs with an event loop.

    To be used with ``async with await connect_async() as arm``; arguments and errors are `armbridge_client.connect`'s.
    """
    token = os.environ.get("ARMBRIDGE_TOKEN") if token is None else token
    connection = Connection(Address(url, token, tls, on_disconnect, timeout_s))
    await connection.open()
    try:
        return AsyncArm(connection, arm)
    except ArmError:
        await connection.close()
        raise


class AsyncArm:
    """One arm of a server. Several arms of a server share the connection (:meth:`other`).

    Every method has a deadline, after which it raises DeadlineExceeded. A motion that is cancelled, or exceeds its
    deadline, is braked along its path.

    Args:
        name: of the arm, on a server with several; empty for the only arm, or all arms together.

    Attributes:
        info: groups, frame and links of the arm.
        gripper: the arm's gripper.
        scene: objects that motions avoid.
        named_states: targets of :meth:`move_named`.
        teaching: motions taught by hand.
        teleop: following of a leader arm.
        episodes: episodes of the server's recording.
    """

    def __init__(self, connection: Connection, name: str = "") -> None:
        self.name = name
        self.connection = connection
        self.info = find_arm(connection.arms, name)
        self._prefix = f"/{name}" if name else ""
        self.gripper = AsyncGripper(connection, self._prefix, self.info.gripper)
        self.scene = AsyncScene(connection, self.info.tip)
        self.named_states = AsyncNamedStates(connection)
        self.teaching = AsyncTeaching(connection)
        self.teleop = AsyncTeleop(connection, self._prefix)
        self.episodes = AsyncEpisodes(connection)

    async def __aenter__(self) -> AsyncArm:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def server(self) -> ServerInfo:
        """This client as the server knows it, and the server's version."""
        return self.connection.server

    def other(self, name: str) -> AsyncArm:
        """Return another arm of the same server, over the same connection."""
        return AsyncArm(self.connection, name)

    async def close(self) -> None:
        """Disconnect; motions in progress are stopped, unless ``on_disconnect="finish"``."""
        await self.connection.close()

    async def wait_connected(self, timeout_s: float = CALL_TIMEOUT_S) -> None:
        """Wait until a lost connection is back."""
        await self.connection.wait_connected(timeout_s)

    # Motions.

    async def move_to(
        self,
        x: float,
        y: float,
        z: float,
        *,
        frame: str = "",
        orientation: Sequence[float] | None = None,
        speed: float = 0.0,
        timeout_s: float = MOTION_TIMEOUT_S,
    ) -> Motion:
        """Move the tip to a position [m] around the planning scene, and return when it is there.

        Args:
            frame: link, object or subframe in whose axes the position is; empty for the arm's base.
            orientation: unit quaternion x, y, z, w; only arms with six joints or more use it.
            speed: share of the velocity limits, above 0 to 1; 0 for the server's setting.

        Raises:
            GoalRefused: the motion is impossible, or ended before its goal.
            NotPermitted: the token's role is below operate.
            ControlledByOther: another client controls the arm.
        """
        return await self.move(pose(x, y, z, frame=frame, orientation=orientation), speed=speed, timeout_s=timeout_s)

    async def move_joints(
        self, position_rad: Mapping[str, float], *, speed: float = 0.0, timeout_s: float = MOTION_TIMEOUT_S
    ) -> Motion:
        """Move joints to positions [rad, or m for joints that slide]; the other joints stay. As :meth:`move_to`."""
        return await self.move(position_rad, speed=speed, timeout_s=timeout_s)

    async def move_named(self, name: str, *, speed: float = 0.0, timeout_s: float = MOTION_TIMEOUT_S) -> Motion:
        """Move to a named state, such as home, ready or a saved one. As :meth:`move_to`."""
        return await self.move(name, speed=speed, timeout_s=timeout_s)

    async def move(
        self,
        target: Target,
        *,
        speed: float = 0.0,
        group: str = "",
        on_progress: Callable[[MoveitGoalFeedback], None] | None = None,
        timeout_s: float = MOTION_TIMEOUT_S,
    ) -> Motion:
        """Move to a target of any kind, such as the suggestion of a GoalRefused. As :meth:`move_to`.

        Args:
            group: planning group; empty for the chosen one, or for joints the smallest group that has them.
            on_progress: called with each report, in the event loop's thread.
        """
        goal = self._qualified(goal_target(target))
        request = MoveitGoalGoal(
            goal.named, goal.joints, goal.pose, group, velocity_scaling=speed, acceleration_scaling=speed
        )

        def on_feedback(values: Mapping[str, Any]) -> None:
            if on_progress is not None:
                on_progress(from_wire(MoveitGoalFeedback, values))

        values = await self.connection.perform(f"{self._prefix}/moveit_goal", request, timeout_s, on_feedback)
        return motion_of(from_wire(MoveitGoalResult, values))

    async def plan(
        self, target: Target, *, speed: float = 0.0, group: str = "", timeout_s: float = PLAN_TIMEOUT_S
    ) -> AsyncPlan:
        """Plan a motion to a target from where the arm is, show it to all clients, and move nothing.

        Raises:
            GoalRefused: there is no such motion.
        """
        stops, goal = await self.stops(), self._qualified(goal_target(target))
        named = await self._named_rad(goal.named) if goal.named else {}
        wanted = constraints(goal, named, self.info.tip)
        group = group or self._group([each.joint_name for each in wanted.joint_constraints])
        request = MotionPlanRequest([wanted], group, speed, speed)
        answer = await self.connection.call("/plan_kinematic_path", GetMotionPlanRequest(request), timeout_s)
        response = answer.motion_plan_response
        if response.error_code.val != MoveItErrorCode.SUCCESS:
            # The simple goal has details and a suggestion for the same failure.
            simple = MoveitGoalRequest(goal.named, goal.joints, goal.pose, group, plan_only=True)
            simple_response = await self.connection.call(f"{self._prefix}/moveit_goal", simple, timeout_s)
            motion_of(simple_response)
            check_code(response.error_code)
        return AsyncPlan(self.connection, response.trajectory, stops)

    async def plan_path(
        self,
        poses: Sequence[PoseStamped],
        *,
        speed: float = 0.0,
        step_m: float = 0.005,
        timeout_s: float = PLAN_TIMEOUT_S,
    ) -> AsyncPlan:
        """Plan straight lines of the tip through poses, and move nothing; all poses in the frame of the first.

        Args:
            step_m: distance of the configurations along the path.

        Raises:
            GoalRefused: the path cannot be followed to its end; ``details`` has the reached ``fraction``.
        """
        stops = await self.stops()
        request = GetCartesianPathRequest(
            Header(frame_id=(poses[0].header.frame_id if poses else "") or self.info.frame),
            group_name=self.info.group if self.name else "",
            link_name=self.info.tip,
            waypoints=[each.pose for each in poses],
            max_step=step_m,
            avoid_collisions=True,
            max_velocity_scaling_factor=speed,
            max_acceleration_scaling_factor=speed,
        )
        answer = await self.connection.call("/compute_cartesian_path", request, timeout_s)
        check_code(answer.error_code)
        if answer.fraction < 1.0:
            sentence = f"only {answer.fraction:.0%} of the path can be followed: {answer.error_code.message}"
            failed = MoveItErrorCode.PLANNING_FAILED
            raise GoalRefused(failed.value, failed.name, sentence, {"fraction": answer.fraction}, None)
        return AsyncPlan(self.connection, answer.solution, stops)

    async def check(
        self, *targets: PoseStamped | Mapping[str, float], timeout_s: float = CALL_TIMEOUT_S
    ) -> list[GoalCheck]:
        """Check poses and joint positions, at most 100, without planning or moving; one result a target."""
        goals = [self._qualified(goal_target(target)) for target in targets]
        poses = [index for index, goal in enumerate(goals) if not goal.joints.name]
        if poses and self.info.group != self.connection.arms[""].group:
            raise ArmError(f"poses of the arm {self.name} cannot be checked, only planned: use plan")
        joints = [index for index, goal in enumerate(goals) if goal.joints.name]
        request = CheckGoalsRequest([goals[index].pose for index in poses], [goals[index].joints for index in joints])
        results = (await self.connection.call("/check_goals", request, timeout_s)).results
        return [result for _, result in sorted(zip((*poses, *joints), results), key=lambda pair: pair[0])]

    # State.

    async def states(self, rate_hz: float = 30.0, *, timeout_s: float = 5.0) -> AsyncIterator[State]:
        """Go over the arm's states, at most ``rate_hz`` a second; a slow reader gets the newest.

        Raises:
            DeadlineExceeded: no state for ``timeout_s``, also while the connection is lost.
        """
        async with (
            self.topic("/arm/state", DiagnosticStatus, timeout_s=timeout_s) as arms,
            self.topic("/joint_states", JointState, rate_hz, timeout_s=timeout_s) as joints,
        ):
            arm = await arms.__anext__()
            async for message in joints:
                arm = arms.newest() or arm
                yield state_of(message, arm)

    async def state(self, timeout_s: float = 5.0) -> State:
        """Return the arm's state."""
        states = self.states(timeout_s=timeout_s)
        try:
            return await states.__anext__()
        finally:
            await states.aclose()  # type: ignore[attr-defined]

    async def stops(self, timeout_s: float = 5.0) -> int:
        """Return the number of the server's last stop, for :func:`armbridge_client.after_stop`."""
        async with self.topic("/arm/state", DiagnosticStatus, timeout_s=timeout_s) as states:
            return stops_of(await states.__anext__())

    async def link_poses(self, timeout_s: float = CALL_TIMEOUT_S) -> dict[str, PoseStamped]:
        """Return the poses of all links, by link; their headers name the frame."""
        answer = await self.connection.call("/compute_fk", GetPositionFKRequest(), timeout_s)
        return dict(zip(answer.fk_link_names, answer.pose_stamped))

    async def tip(self, timeout_s: float = CALL_TIMEOUT_S) -> PoseStamped:
        """Return the pose of the tip; its header names the frame."""
        return (await self.link_poses(timeout_s))[self.info.tip]

    def messages(
        self, topic: str, message_class: type[M], rate_hz: float = 0.0, *, length: int = 10, timeout_s: float = 5.0
    ) -> AsyncIterator[M]:
        """Go over the messages of any topic, such as a camera's; a slow reader loses the oldest.

        Args:
            topic: below the arm's name.
            message_class: of :mod:`armbridge_client.messages`, such as ``CompressedImage``.
            rate_hz: most messages a second; 0 for all.
            length: most messages that wait for the reader.
            timeout_s: longest wait for a message, after which DeadlineExceeded is raised.
        """
        return self._messages(self.topic(topic, message_class, rate_hz, length=length, timeout_s=timeout_s))

    async def _messages(self, subscription: Subscription[M]) -> AsyncIterator[M]:
        async with subscription as stream:
            async for message in stream:
                yield message

    async def publish(self, topic: str, message: Message) -> None:
        """Publish a message of :mod:`armbridge_client.messages` on any topic, below the arm's name."""
        await self.connection.publish(f"{self._prefix}{topic}", message)

    def jog(self, command_timeout_s: float = COMMAND_TIMEOUT_S) -> AsyncJog:
        """Steer with velocities: ``async with arm.jog() as jog``, and repeat ``await jog.tip((0.05, 0.0, 0.0))``.

        Args:
            command_timeout_s: time after the last command until the arm brakes, 0.02 to 0.25.
        """
        return AsyncJog(self.connection, self._prefix, command_timeout_s)

    def chunks(self) -> AsyncChunks:
        """Follow a policy's joint targets: ``async with arm.chunks() as chunks``, then ``await chunks.send(...)``."""
        return AsyncChunks(self.connection, self._prefix)

    # Control and confirmation.

    async def take_control(self) -> str:
        """Take the control lease, which the first motion takes as well.

        Raises:
            ControlledByOther: another client has the lease.
        """
        return await self._trigger("/arm/take_control", CALL_TIMEOUT_S)

    async def release_control(self) -> str:
        """Give the control lease back; with an admin's token also the lease of another client."""
        return await self._trigger("/arm/release_control", CALL_TIMEOUT_S)

    async def control(self, timeout_s: float = 5.0) -> Control:
        """Return the client that controls the arm."""
        async with self.topic("/arm/control", DiagnosticStatus, timeout_s=timeout_s) as statuses:
            status = await statuses.__anext__()
        values = {pair.key: pair.value for pair in status.values}
        return Control(status.hardware_id, float(values.get("free_in_s") or 0.0), status.message)

    async def waiting_goal(self, timeout_s: float = 5.0) -> WaitingGoal | None:
        """Return the goal that waits for an approval or a confirmation; None without one (docs/goals.md)."""
        async with self.connection.subscribe(
            "/moveit_goal_approval", DiagnosticStatus, timeout_s=timeout_s
        ) as requests:
            request = await requests.__anext__()
        values = {pair.key: pair.value for pair in request.values}
        if not request.hardware_id:
            return None
        proposed, duration_s = values.get("proposed") != "false", float(values.get("duration_s") or 0.0)
        return WaitingGoal(
            request.hardware_id, values.get("client", ""), proposed, values.get("summary", ""), duration_s
        )

    async def approve(self, goal_id: str) -> None:
        """Approve a goal that waits, such as a proposed goal of a language model; needs the role operate."""
        await self.connection.publish("/moveit_goal_approve", String(goal_id))

    async def discard(self, goal_id: str) -> None:
        """End a goal of any client, waiting or in progress."""
        await self.connection.publish("/moveit_goal_cancel", String(goal_id))

    async def set_confirm_mode(self, *, on: bool) -> str:
        """Make every goal wait for a confirmation; needs the role admin."""
        return (await self.connection.carry_out("/moveit_goal_confirm_mode", SetBoolRequest(on))).message

    # Switches.

    async def set_speed_limit(self, share: float) -> str:
        """Limit all motions of all clients to a share of the joints' velocity limits, 0.01 to 1."""
        request = SetSpeedLimitRequest(share)
        return (await self.connection.carry_out(f"{self._prefix}/arm/set_speed_limit", request)).message

    async def pause(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Come to rest on the path, and wait there for :meth:`resume`."""
        return await self._trigger("/arm/pause", timeout_s)

    async def resume(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Go on after a pause."""
        return await self._trigger("/arm/resume", timeout_s)

    async def step_back(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Go back along the path, at most to its start, and wait there."""
        return await self._trigger("/arm/step_back", timeout_s)

    async def stop(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Stop the arm along its path, and end the goals of all clients; return when the arm stands still.

        Every role may stop.
        """
        return await self._trigger("/arm/stop", timeout_s)

    def stop_soon(self) -> None:
        """Send a stop from the event loop's thread, without waiting: for signal handlers of ``loop``."""
        self.connection.send_soon({"op": "call_service", "service": f"{self._prefix}/arm/stop"})

    async def emergency_stop(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Switch torque off at once: the arm falls, or holds by the server's setting ``arm.on_emergency_stop``."""
        return await self._trigger("/arm/emergency_stop", timeout_s)

    async def enable(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Make a relaxed arm hold its position."""
        return await self._trigger("/arm/enable", timeout_s)

    async def relax(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Lower the torque, so that the arm sinks and can be moved by hand: hold the arm."""
        return await self._trigger("/arm/relax", timeout_s)

    async def park(self, timeout_s: float = MOTION_TIMEOUT_S) -> str:
        """Move to the rest pose around the scene, and relax the arm there."""
        return await self._trigger("/arm/park", timeout_s)

    async def reset_fault(self, timeout_s: float = SWITCH_TIMEOUT_S) -> str:
        """Clear a fault whose cause is gone."""
        return await self._trigger("/arm/reset_fault", timeout_s)

    async def call(self, service: str, request: Service[Response], timeout_s: float = CALL_TIMEOUT_S) -> Response:
        """Call any service, below the arm's name, with a request of :mod:`armbridge_client.messages`."""
        return await self.connection.call(f"{self._prefix}{service}", request, timeout_s)

    def topic(
        self, topic: str, message_class: type[M], rate_hz: float = 0.0, *, length: int = 1, timeout_s: float = 5.0
    ) -> Subscription[M]:
        """Subscribe to any topic, below the arm's name: ``async with arm.topic(...) as messages``.

        Args:
            rate_hz: most messages a second; 0 for all.
            length: most messages that wait for their reader; older ones are dropped.
            timeout_s: longest wait for a message.
        """
        return self.connection.subscribe(f"{self._prefix}{topic}", message_class, rate_hz, length, timeout_s)

    async def _trigger(self, service: str, timeout_s: float) -> str:
        return (await self.connection.carry_out(f"{self._prefix}{service}", TriggerRequest(), timeout_s)).message

    async def _named_rad(self, name: str) -> dict[str, float]:
        states = await self.named_states.all()
        # The server ignores case and blanks as well; it refuses an unknown name with a suggestion.
        found = states.get(name) or states.get(name.strip().lower()) or {}
        # The server lists the states of one group; other arms of this kind have the same joints under their names.
        return {self._joint(self._shared_name(joint)): position for joint, position in found.items()}

    def _qualified(self, goal: GoalTarget) -> GoalTarget:
        """Return a goal for the names that all arms share: with this arm's joints and frame."""
        joints, at = goal.joints, goal.pose
        if not self.name:
            return goal
        names = [self._joint(name) for name in joints.name]
        header = Header(frame_id=at.header.frame_id or self.info.frame)
        pose = at if at == PoseStamped() else PoseStamped(header, at.pose)
        return GoalTarget(goal.named, JointState(name=names, position=joints.position), pose)

    def _group(self, joints: Sequence[str]) -> str:
        """Return the smallest planning group of the arm that has joints; empty for the only arm, as the server does."""
        if not self.name:
            return ""
        having = [name for name, group in self.info.groups.items() if joints and set(joints) <= set(group)]
        return min(having, key=lambda name: len(self.info.groups[name]), default=self.info.group)

    def _joint(self, name: str) -> str:
        """Return the full name of a joint, which may be named without the arm's name."""
        return name if not self.name or name != self._shared_name(name) else f"{self.name}_{name}"

    def _shared_name(self, name: str) -> str:
        """Return the name of a joint without the name of its arm."""
        arms = (arm for arm in self.connection.arms if arm and name.startswith(f"{arm}_"))
        return name.removeprefix(f"{next(arms, '')}_")
