"""Parking: planned, checked motions to the arm's rest pose, where it can be relaxed without sinking far.

A motion for a client goes through the goal queue. For the end of the server the arm process has to know the way by
itself: whenever the arm has come to rest somewhere, or the scene has changed, the way from there is planned in the
background and kept in the arm process (:meth:`robot.arm.Arm.keep_parking`).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, replace

from planners.goals import JointGoal
from planners.problem import MoveItErrorCode, Plan, PlanningProblem
from robot.arm import CLOSE_LIMIT_S, Arm
from robot.description.model import RobotModel
from robot.messages import PARKING_TIMEOUT_S, CommandDone, EndState, Mode, Order, ParkingPlan
from robot.stop_epochs import STOP_EPOCHS, STOPPED_SINCE
from server.arm.services import trigger_response
from server.arrival import is_stopped
from server.config import ArmSettings
from server.errors import ConfigurationError
from server.execution.goal import GoalPolicy, GoalRequest
from server.execution.monitors import CurrentState
from server.execution.motions import PlannedMotion, Positions
from server.execution.queue import GoalQueue
from server.features.context import ArmContext, ServerContext
from server.graph.node import Node
from server.graph.permissions import SWITCHING
from server.lifecycle import BackgroundTask, Feature
from server.moveit.messages import Message

log = logging.getLogger("armbridge.parking")

PARK = "/arm/park"

# Source of parking, in log lines and reports.
LAST_CLIENT = "arm.on_last_client"

# Planning the way to the rest pose takes milliseconds; a planner may be working on something else [s].
PREPARING_S = 4.0

# Interval of looking for a new place or another scene [s].
CHECK_S = 0.2

# Planning a way that is only kept may take this long; most take some milliseconds [s].
PLANNING_TIME_S = 2.0

# Goals farther from the start of the kept way than this are another place: half the tolerance of the arm process [rad].
SAME_PLACE_RAD = 0.005

# Braking takes a second at most.
REST_TIMEOUT_S = 2.0

# States come at 50 Hz, or at 1 Hz from an arm that is set so.
STATE_POLL_S = 0.02
STATE_POLLS = 60


@dataclass(frozen=True)
class RestPose:
    """Pose in which an arm is parked."""

    state: str
    group: str
    positions_rad: Mapping[str, float]


def rest_pose(robot: RobotModel, settings: ArmSettings) -> RestPose | None:
    """Return the arm's rest pose; None for an arm that has none."""
    name = settings.park_state or robot.park_state
    groups = sorted(robot.named_states, key=lambda group: group != robot.default_group)
    for group in groups:
        if name in robot.named_states[group]:
            return RestPose(name, group, robot.named_states[group][name])
    if settings.park_state is not None:
        known = sorted({state for states in robot.named_states.values() for state in states})
        raise ConfigurationError(
            f"arm.park_state: the SRDF has no state {name!r}, but {', '.join(known) or 'none at all'}"
        )
    return None


class Parking:
    """Parking of one arm, and the service for it.

    Attributes:
        name: of one of several arms; empty for a lone arm.
        leads: True for an arm that is moved by hand.
    """

    def __init__(self, arm: Arm, context: ArmContext) -> None:
        settings, planning = context.served.settings, context.planning
        self.name, self.leads = context.served.name, context.served.leads
        self._arm = arm
        self._context = context
        self._robot = context.robot
        self._pose = rest_pose(context.robot, settings)
        self._problems = planning.problems
        self._pool = planning.pool
        self._scene = planning.scene_state
        self._queue = context.goals.queue
        self._current = CurrentState(arm, context.robot)
        self._all_joints = planning.current
        self._parks_at_end = EndState.PARK in (settings.on_exit, settings.on_server_lost)
        self._parks_on_exit = settings.on_exit is EndState.PARK
        self._place: _Place | None = None
        self._keeps = False
        self._parked: set[asyncio.Task[CommandDone]] = set()
        if self._parks_at_end and self._pose is None:
            log.warning("%s Where it is to be parked at the end, it is relaxed.", self._no_pose)
        self._scene.on_change(self._on_scene_change)
        context.graph.offer(Node("arm services"), PARK, "std_srvs/Trigger", self._serve, rule=SWITCHING)

    def _serve(self, _request: Message) -> Awaitable[Message]:
        return trigger_response(self.park(self._context.graph.resolve(PARK)))

    @property
    def _no_pose(self) -> str:
        return (
            f"The arm cannot be parked: its SRDF has no state {self._robot.park_state!r}; name one by arm.park_state, "
            "or by park in the table [planning] of its robot.toml."
        )

    # Parking now.

    def park(self, source: str) -> asyncio.Future[CommandDone]:
        """End all goals, move the arm to its rest pose, and relax it there.

        Args:
            source: service, or reason, that asks for it.

        Returns:
            Future of the answer. An arm that does not come to its rest pose goes on holding.
        """
        pose = self._pose
        refused = self._no_pose if pose is None else STOPPED_SINCE if is_stopped(self._arm.last_stop) else ""
        if pose is None or refused:
            answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
            answered.set_result(CommandDone(0, done=False, message=refused))
            return answered
        self._context.stop(f"the arm is parked by {source}")
        # Goals of others end by a stop; the way to the rest pose is requested after it.
        task = asyncio.create_task(self._park(source, pose, STOP_EPOCHS.present), name="park the arm")
        self._parked.add(task)
        task.add_done_callback(self._parked.discard)
        # The motion goes on when the caller does not wait any longer.
        return asyncio.shield(task)

    async def _park(self, source: str, pose: RestPose, epoch: int) -> CommandDone:
        joints = frozenset(self._robot.groups[pose.group].joints)
        # Motions outside the queue, as of the gripper, end too before the way is planned.
        await self._arm.rest(REST_TIMEOUT_S)
        motion = PlannedMotion((self._problem,), joints)
        goal = self._queue.submit(GoalRequest(source, motion, policy=GoalPolicy.QUEUE, epoch=epoch))
        answer = await goal.answered
        if answer.code is not MoveItErrorCode.SUCCESS:
            log.warning("%s: the arm is not parked: %s", source, answer.message)
            return CommandDone(0, done=False, message=f"the arm is not parked: {answer.message}")
        if is_stopped(self._arm.last_stop, epoch):
            return CommandDone(0, done=False, message=f"the arm is at its rest pose, and holds: {STOPPED_SINCE}")
        relaxed = await self._arm.order(Order.RELAX)
        log.info("%s: the arm is at its rest pose %s; %s", source, pose.state, relaxed.message)
        if not relaxed.done:
            return relaxed
        return CommandDone(0, done=True, message=f"the arm is at its rest pose {pose.state!r}, and relaxed")

    def _problem(self, start_rad: Positions) -> PlanningProblem:
        if self._pose is None:
            raise AssertionError("a way to no pose is planned")
        group = self._robot.groups[self._pose.group]
        goal = JointGoal(self._pose.positions_rad, self._context.parameters.joint_tolerance)
        return self._problems.goal(group, goal, start_rad)

    # The way that the arm process keeps for its end.

    async def run(self) -> None:
        """Keep the way from where the arm holds up to date, until cancelled; return at once where none is needed."""
        while self._parks_at_end and self._pose is not None:
            await asyncio.sleep(CHECK_S)
            if not self._queue.busy() and self._pool.idle_count and self._is_due:
                await self._plan()

    async def prepare_exit(self) -> None:
        """Have the arm process know the way from where the arm has come to rest, before the server ends."""
        if not self._parks_on_exit or self._pose is None:
            return
        await self._arm.rest(REST_TIMEOUT_S)
        # The end of a motion may come ahead of the state that shows where the arm holds.
        for _ in range(STATE_POLLS):
            if self._arm.state.mode is not Mode.MOVING:
                break
            await asyncio.sleep(STATE_POLL_S)
        if self._is_due:
            await self._plan()

    async def close_arm(self) -> None:
        """End the process of an arm that is parked at its end, which takes it to its rest pose."""
        if self._parks_on_exit:
            await self._arm.close()

    @property
    def _is_due(self) -> bool:
        """True when the arm holds where the way was not planned yet in the present scene."""
        place = self._here()
        return place is not None and not place.same_as(self._place)

    def _here(self) -> _Place | None:
        if self._arm.state.mode is not Mode.HOLDING or (held_rad := self._current.positions_rad()) is None:
            return None
        return _Place(held_rad, self._scene.scene.version, self._arm.pid, self._arm.state.pace.speed_limit)

    async def _plan(self) -> None:
        """Plan the way from where the arm holds, and have the arm process keep it if it still holds there."""
        place = self._here()
        if place is None:
            return
        # Several arms are obstacles to each other.
        problem = self._problem({**(self._all_joints.positions_rad() or {}), **place.held_rad})
        bounded = replace(problem, allowed_time_s=min(problem.allowed_time_s, PLANNING_TIME_S))
        plan = await self._pool.ask(bounded, self._scene.scene)
        if place.version != self._scene.scene.version:
            return
        # Also after a failure: the way is not planned again before something has changed.
        self._place = place
        if not isinstance(plan, Plan):
            log.warning(
                "no way to the rest pose from here, where the arm would be relaxed at its end: %s", plan.message
            )
            self._forget()
            return
        if plan.trajectory.duration_s > PARKING_TIMEOUT_S:
            log.warning(
                "the way to the rest pose takes %.1f s from here, above the limit of %g s: the arm would be relaxed at "
                "its end; raise moveit.max_velocity_scaling and the speed limit",
                plan.trajectory.duration_s,
                PARKING_TIMEOUT_S,
            )
        self._arm.keep_parking(ParkingPlan(plan.trajectory, place.held_rad))
        self._keeps = True
        log.debug("the way to the rest pose is known: %.2f s", plan.trajectory.duration_s)

    def _on_scene_change(self) -> None:
        # Before anything else happens: the server may be lost at any time.
        self._place = None
        self._forget()

    def _forget(self) -> None:
        if self._keeps:
            self._arm.keep_parking(None)
            self._keeps = False


@dataclass(frozen=True)
class _Place:
    """Place from which a way was planned.

    Attributes:
        pid: process id of the arm process, which keeps the way.
        speed_limit: of the arm, which decides on the duration.
    """

    held_rad: Mapping[str, float]
    version: int
    pid: int | None
    speed_limit: float

    def same_as(self, other: _Place | None) -> bool:
        if other is None or (self.version, self.pid, self.speed_limit) != (
            other.version,
            other.pid,
            other.speed_limit,
        ):
            return False
        return all(abs(value - other.held_rad[name]) <= SAME_PLACE_RAD for name, value in self.held_rad.items())


class LastClient:
    """Parks or relaxes the arm some time after the last client that may drive has left."""

    def __init__(
        self,
        arm: Arm,
        settings: ArmSettings,
        drivers: Collection[object],
        queue: GoalQueue,
        parking: Parking,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm = arm
        self._policy = settings.on_last_client
        self._delay_s = settings.last_client_delay_s
        self._drivers = drivers
        self._queue = queue
        self._parking = parking
        self._clock = clock
        self._present = False
        self._left_s: float | None = None

    async def run(self) -> None:
        """Watch until cancelled; return at once for the policy ``nothing``."""
        while self._policy != "nothing":
            await asyncio.sleep(CHECK_S)
            if self.due():
                await self._act()

    def due(self) -> bool:
        """Return True, once, when the time has come: nobody has come back, and no goal moves any more."""
        if self._drivers:
            self._present, self._left_s = True, None
            return False
        if self._present:
            self._present, self._left_s = False, self._clock()
            log.info("the last client that may drive has left; arm.on_last_client = %r", self._policy)
        if self._left_s is None or self._clock() - self._left_s < self._delay_s:
            return False
        if self._queue.busy() or self._arm.state.mode is Mode.MOVING:
            return False
        self._left_s = None
        return True

    async def _act(self) -> None:
        log.info("nobody who may drive is connected: the arm is to %s", self._policy)
        if self._policy == "park":
            parked = await self._parking.park(LAST_CLIENT)
            if parked.done:
                return
            if self._drivers:
                log.warning("%s; a client is connected again, and the arm holds", parked.message)
                return
            log.warning("%s; it is relaxed where it is", parked.message)
        relaxed = await self._arm.order(Order.RELAX)
        log.info("nobody who may drive is connected: %s", relaxed.message)


class Parkings(Feature):
    """Parking of each arm. At the end of the server each arm that is to be parked gets its way to the rest pose."""

    name = "the way to the rest pose"
    deadline_s = PREPARING_S
    beyond_total = True

    def __init__(self, context: ServerContext) -> None:
        self._parkings: list[Parking] = []
        self._several = len(context.single_arms) > 1
        self._keeping: list[BackgroundTask] = []
        self.last_clients: list[BackgroundTask] = []
        for each, arm in context.single_arms:
            parking, settings = Parking(arm, each), each.served.settings
            self._parkings.append(parking)
            # The ways of several arms depend on each other: they are planned at the end alone.
            if not self._several:
                self._keeping.append(BackgroundTask("parking", parking.run))
            if settings.on_last_client != "nothing":
                last_client = LastClient(arm, settings, context.access.drivers, context.goals.queue, parking)
                self.last_clients.append(BackgroundTask("the last client", last_client.run))
        if self._several:
            self.deadline_s = len(self._parkings) * (PREPARING_S + CLOSE_LIMIT_S)
            context.whole.graph.offer(Node("arm services"), PARK, "std_srvs/Trigger", self._park_each, rule=SWITCHING)

    async def _park_each(self, _request: Message) -> Message:
        """Park the arms one after the other: on their ways at the same time they could wait for each other."""
        done = {each.name: await each.park(PARK) for each in self._parkings if not each.leads}
        said = "; ".join(f"{name}: {one.message}" for name, one in done.items())
        return {"success": all(one.done for one in done.values()), "message": said}

    async def start(self) -> None:
        for each in self._keeping:
            await each.start()

    async def stop(self) -> None:
        await asyncio.gather(*(each.stop() for each in self._keeping))
        for each in self._parkings:
            await each.prepare_exit()
            if self._several:
                # The next arm's way is planned around this one at its rest pose.
                await each.close_arm()
