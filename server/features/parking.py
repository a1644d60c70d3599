"""Parking: planned, checked motions to the arm's rest pose, where it can be relaxed without sinking far.

A motion for a client goes through the goal queue. For the end of the server the arm process has to know the way by
itself: whenever the arm has come to rest somewhere, or the scene has changed, the way from there is planned in the
background and kept in the arm process (:meth:`robot.arm.Arm.keep_parking`).
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import time
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from planners.goals import JointGoal
from planners.problem import ConcurrencyQuestion, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from robot.arm import CLOSE_LIMIT_S, Arm
from robot.arm_group import states_of
from robot.description.model import RobotModel
from robot.messages import PARKING_TIMEOUT_S, ArmState, CommandDone, EndState, Mode, Order, ParkingPlan
from robot.stop_epochs import STOP_EPOCHS, STOPPED_SINCE
from server.arm.interface import sentence_of
from server.arrival import arrival_epoch, is_stopped
from server.config import ArmSettings
from server.errors import ConfigurationError, RefusedError, ServiceError, refused, required
from server.execution.goal import Goal, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import PlannedMotion, Positions
from server.execution.queue import GoalListener
from server.features.context import ArmContext, ServerContext
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

# An arm this far from the start of its kept way is at another place: half the tolerance of the arm process [rad].
SAME_PLACE_RAD = 0.005

# Braking takes a second at most.
REST_TIMEOUT_S = 2.0


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
        raise ConfigurationError(f"arm.park_state: the SRDF has no state {name!r}, but {', '.join(known) or 'none'}")
    return None


class ArmParking:
    """Parking of one arm, and the service for it."""

    def __init__(self, arm: Arm, context: ArmContext) -> None:
        settings = context.served.settings
        self.arm, self.context = arm, context
        self._pose = rest_pose(context.robot, settings)
        # True for an arm that parks at the end of the server.
        self.parks_on_exit = settings.on_exit is EndState.PARK and self._pose is not None
        # True for an arm that parks without the server.
        self.parks_when_lost = settings.on_server_lost is EndState.PARK and self._pose is not None
        self._keeps = False
        self._parked: set[asyncio.Task[CommandDone]] = set()
        if self._pose is None and EndState.PARK in (settings.on_exit, settings.on_server_lost):
            log.warning("%s Instead of being parked at the end, it is relaxed.", self._no_pose)
        context.graph.node("arm services").offer(PARK, "std_srvs/Trigger", self._serve, rule=SWITCHING)

    def _serve(self, _request: Message) -> Awaitable[str]:
        return sentence_of(self.park(self.context.graph.resolve(PARK)))

    @property
    def _no_pose(self) -> str:
        return (
            f"The arm cannot be parked: its SRDF has no state {self.context.robot.park_state!r}; name one by "
            "arm.park_state, or by park in the table [planning] of its robot.toml."
        )

    # Parking now.

    def park(self, source: str) -> asyncio.Future[CommandDone]:
        """End all goals, move the arm to its rest pose, and relax it there; an arm that does not reach it holds."""
        pose = self._pose
        refused = self._no_pose if pose is None else STOPPED_SINCE if is_stopped(self.arm.last_stop) else ""
        if pose is None or refused:
            answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
            answered.set_result(CommandDone(0, done=False, message=refused))
            return answered
        self.context.stop(f"the arm is parked by {source}")
        # That stop ends the goals of others; the way to the rest pose is requested after it.
        task = asyncio.create_task(self._park(source, pose, STOP_EPOCHS.present), name="park the arm")
        self._parked.add(task)
        task.add_done_callback(self._parked.discard)
        # The motion goes on when the caller does not wait any longer.
        return asyncio.shield(task)

    async def _park(self, source: str, pose: RestPose, epoch: int) -> CommandDone:
        joints = frozenset(self.context.robot.groups[pose.group].joints)
        # Motions outside the queue, as of the gripper, end too before the way is planned.
        await self.arm.rest(REST_TIMEOUT_S)
        motion = PlannedMotion((self._way(),), joints)
        goal = self.context.goals.queue.submit(GoalRequest(source, motion, policy=GoalPolicy.QUEUE, epoch=epoch))
        answer = await goal.answered
        if answer.code is not MoveItErrorCode.SUCCESS:
            log.warning("%s: the arm is not parked: %s", source, answer.message)
            return CommandDone(0, done=False, message=f"the arm is not parked: {answer.message}")
        if is_stopped(self.arm.last_stop, epoch):
            return CommandDone(0, done=False, message=f"the arm is at its rest pose, and holds: {STOPPED_SINCE}")
        relaxed = await self.arm.order(Order.RELAX)
        log.info("%s: the arm is at its rest pose %s; %s", source, pose.state, relaxed.message)
        if not relaxed.done:
            return relaxed
        return CommandDone(0, done=True, message=f"the arm is at its rest pose {pose.state!r}, and relaxed")

    def _way(self) -> Callable[[Positions], PlanningProblem]:
        if self._pose is None:
            raise AssertionError("a way to no pose is planned")
        group = self.context.robot.groups[self._pose.group]
        goal = JointGoal(self._pose.positions_rad, self.context.parameters.joint_tolerance)
        return self.context.planning.problems.goal_step(group, goal)

    # The way that the arm process keeps for its end.

    async def prepare_exit(self) -> None:
        """Have the arm process know the way from where the arm has come to rest, before the server ends."""
        await self.arm.rest(REST_TIMEOUT_S)
        positions_rad = self.context.planning.current.positions_rad()
        if not self.holds or positions_rad is None:
            return
        try:
            self.keep(await self.plan_way(positions_rad), positions_rad)
        except RefusedError as error:
            log.warning("no way to the rest pose from here, where the arm is relaxed: %s", error)

    @property
    def holds(self) -> bool:
        return self.arm.state.mode is Mode.HOLDING

    async def plan_way(self, start_rad: Positions) -> Plan:
        """Plan the way to the rest pose from positions of all joints [rad], or raise RefusedError."""
        problem = self._way()(start_rad)
        bounded = replace(problem, allowed_time_s=min(problem.allowed_time_s, PLANNING_TIME_S))
        scene_state = self.context.planning.scene_state
        scene = scene_state.scene
        plan = await self.context.planning.pool.ask(bounded, scene)
        if isinstance(plan, PlanningFailure):
            name = self.context.name
            raise refused(plan.code, f"{name}: {plan.message}" if name else plan.message)
        if scene.version != scene_state.scene.version:
            code = MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
            raise refused(code, "the scene has changed meanwhile")
        return plan

    def keep(self, plan: Plan, start_rad: Positions) -> None:
        if plan.trajectory.duration_s > PARKING_TIMEOUT_S:
            log.warning(
                "the way to the rest pose takes %.1f s from here, above the limit of %g s: the arm would be relaxed at "
                "its end; raise moveit.max_velocity_scaling and the speed limit",
                plan.trajectory.duration_s,
                PARKING_TIMEOUT_S,
            )
        held_rad = {joint.name: start_rad[joint.name] for joint in self.context.robot.movable_joints}
        self.arm.keep_parking(ParkingPlan(plan.trajectory, held_rad))
        self._keeps = True
        log.debug("the way to the rest pose is known: %.2f s", plan.trajectory.duration_s)

    def forget(self) -> None:
        if self._keeps:
            self.arm.keep_parking(None)
            self._keeps = False


class KeptWays:
    """Ways of the arms to their rest poses, which the arm processes keep for their end: all or none.

    Without the server nobody coordinates several arms. So their ways are kept while all of them rest, and if no two
    ways can touch. The process of a lone arm keeps its way also in a motion, whose path it goes back.
    """

    def __init__(self, parkings: Sequence[ArmParking], context: ServerContext) -> None:
        self._parkings = parkings
        self._arm, self._planning, self._queue = context.whole.arm, context.planning, context.goals.queue
        self._place: _Place | None = None
        # At once: the server may be lost at any time.
        self._planning.scene_state.on_change(self.forget)

    async def run(self) -> None:
        """Keep the ways up to date, until cancelled; return at once where none is needed."""
        while self._parkings:
            await asyncio.sleep(CHECK_S)
            place = self._here()
            if place is None or place.same_as(self._place) or self._queue.busy() or not self._planning.pool.idle_count:
                continue
            await self._plan(place)

    @property
    def current(self) -> bool:
        """True while all arms rest where the ways were planned, in the present scene."""
        place = self._here()
        return place is not None and place.same_as(self._place)

    def check_rest(self) -> None:
        """Forget all ways when an arm is no longer where they were planned, or is moving."""
        if self._place is not None and not self.current:
            self.forget()

    def forget(self) -> None:
        self._place = None
        for each in self._parkings:
            each.forget()

    def end(self) -> None:
        """Leave the ways to the end of the server, which has the arms parked one after the other."""
        self._place = None

    def _here(self) -> _Place | None:
        """Return where all arms rest; None while one of them moves or is not read."""
        states = states_of(self._arm)
        held_rad = self._planning.current.positions_rad()
        if held_rad is None or any(state.mode is Mode.MOVING for state in states.values()):
            return None
        arms = zip(self._arm.pids, (state.mode for state in states.values()), strict=False)
        return _Place(held_rad, self._planning.scene_state.scene.version, tuple(arms), self._arm.state.pace.speed_limit)

    async def _plan(self, place: _Place) -> None:
        refusal, plans = "", dict[ArmParking, Plan]()
        try:
            plans = await self._plans(place)
        except RefusedError as error:
            refusal = str(error)
        if (now := self._here()) is None or not now.same_as(place):
            return
        # Also after a failure: the ways are not planned again before something has changed.
        self._place = place
        if refusal:
            log.warning("no way to the rest pose is kept; here an arm would be relaxed at its end: %s", refusal)
        for each in self._parkings:
            if each in plans:
                each.keep(plans[each], place.held_rad)
            else:
                each.forget()

    async def _plans(self, place: _Place) -> dict[ArmParking, Plan]:
        """Plan the ways of the arms that hold; raise RefusedError if one has no plan, or two meet."""
        scene = self._planning.scene_state.scene
        plans = {each: await each.plan_way(place.held_rad) for each in self._parkings if each.holds}
        for first, second in itertools.combinations((plan.trajectory for plan in plans.values()), 2):
            moving = {*first.joint_names, *second.joint_names}
            others_rad = {name: value for name, value in place.held_rad.items() if name not in moving}
            question = ConcurrencyQuestion(first, second, others_rad)
            if contact := required(await self._planning.pool.ask(question, scene)).contact:
                raise RefusedError(contact)
        return plans


@dataclass(frozen=True)
class _Place:
    """Place from which ways were planned: also each arm process with its mode, and the speed limit."""

    held_rad: Mapping[str, float]
    version: int
    arms: tuple[tuple[int | None, Mode], ...]
    speed_limit: float

    def same_as(self, other: _Place | None) -> bool:
        if other is None or replace(self, held_rad=other.held_rad) != other:
            return False
        return all(abs(value - other.held_rad[name]) <= SAME_PLACE_RAD for name, value in self.held_rad.items())


class LastClient:
    """Parks or relaxes the arm some time after the last client that may drive has left."""

    def __init__(
        self, parking: ArmParking, drivers: Collection[object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        settings, self._queue = parking.context.served.settings, parking.context.goals.queue
        self._policy, self._delay_s = settings.on_last_client, settings.last_client_delay_s
        self._parking, self._arm, self._drivers, self._clock = parking, parking.arm, drivers, clock
        self._present = False
        self._left_s: float | None = None
        self._left_epoch = 0  # stop epoch in which a driver was there last

    async def run(self) -> None:
        while True:
            await asyncio.sleep(CHECK_S)
            if self.due():
                await self._act()

    def due(self) -> bool:
        """Return True, once, when the time has come: nobody has come back, and no goal moves any more."""
        if self._drivers:
            self._present, self._left_epoch = True, STOP_EPOCHS.present
            return False
        if self._present:
            self._present, self._left_s = False, self._clock()
            log.info("the last client that may drive has left; in %g s: %s", self._delay_s, self._policy)
        if self._left_s is None or self._clock() - self._left_s < self._delay_s:
            return False
        if self._queue.busy() or self._arm.state.mode is Mode.MOVING:
            return False
        self._left_s = None
        return True

    async def _act(self) -> None:
        log.info("no client that may drive is connected; arm.on_last_client = %r", self._policy)
        if self._policy == "park":
            if is_stopped(self._arm.last_stop, self._left_epoch):
                log.warning("a stop came after the last client had left: the arm holds")
                return
            parking = self._parking.park(LAST_CLIENT)
            last_stop = self._arm.last_stop  # by which parking has ended all else
            parked = await parking
            if parked.done:
                return
            stopped = self._arm.last_stop != last_stop
            if stopped or self._drivers:
                why = "the arm was stopped" if stopped else "a client is connected again"
                log.warning("%s; %s: the arm holds", parked.message, why)
                return
            log.warning("%s; it is relaxed where it is", parked.message)
        relaxed = await self._arm.order(Order.RELAX)
        log.info("no client that may drive is connected: %s", relaxed.message)


class Parkings(Feature, GoalListener):
    """Parking of each arm. At the end of the server each arm that parks gets its way to the rest pose."""

    name = "the way to the rest pose"
    deadline_s = PREPARING_S
    beyond_total = True

    def __init__(self, context: ServerContext) -> None:
        self._parkings: list[ArmParking] = []
        self._several = len(context.single_arms) > 1
        self.last_clients: list[BackgroundTask] = []
        for each, arm in context.single_arms:
            self._parkings.append(parking := ArmParking(arm, each))
            if each.served.settings.on_last_client != "nothing":
                last_client = LastClient(parking, context.access.drivers)
                self.last_clients.append(BackgroundTask("the last client", last_client.run))
        keeping = [
            each for each in self._parkings if each.parks_when_lost or (each.parks_on_exit and not self._several)
        ]
        self._kept = KeptWays(keeping, context)
        self._keeping = BackgroundTask("parking", self._kept.run)
        if self._several:
            context.goals.queue.listeners.append(self)
            self.deadline_s = len(self._parkings) * (PREPARING_S + CLOSE_LIMIT_S)
            context.whole.graph.node("arm services").offer(PARK, "std_srvs/Trigger", self._park_each, rule=SWITCHING)

    async def _park_each(self, _request: Message) -> str:
        """Park the arms one after the other: on their ways at the same time they could wait for each other."""
        arms = [each for each in self._parkings if not each.context.served.leads]
        ends = {each.context.name: await each.park(PARK) for each in arms}
        sentence = "; ".join(f"{name}: {end.message}" for name, end in ends.items())
        if not all(end.done for end in ends.values()):
            raise ServiceError(sentence)
        return sentence

    async def start(self) -> None:
        await self._keeping.start()

    def on_state(self, arm: str, _state: ArmState) -> None:
        if self._several and not arm:
            self._kept.check_rest()

    def on_progress(self, _goal: Goal, progress: Progress) -> None:
        """Forget the ways that were planned before a motion of one of several arms."""
        if progress.state is GoalState.EXECUTING:
            self._kept.forget()

    async def stop(self) -> None:
        await self._keeping.stop()
        known = self._kept.current
        self._kept.end()
        for each in self._parkings:
            if each.parks_on_exit and (self._several or not known):
                await each.prepare_exit()
            if each.parks_on_exit and self._several:
                # It goes to its rest pose, around which the next arm's way is planned.
                await each.arm.close(arrival_epoch())
