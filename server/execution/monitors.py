"""Monitors of execution: the arm's current state, its readiness, and the scene around a motion in progress."""

import asyncio
import logging
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeAlias

from planners.interface import Planners
from planners.problem import ConcurrencyQuestion, MoveItErrorCode, PlanningFailure, RecheckAnswer, RecheckQuestion
from planners.scene import EMPTY_SCENE
from protocol.messages import Stamp
from robot.arm_group import AnyArm, ArmGroup, states_of
from robot.description.model import RobotModel
from robot.messages import Mode
from server.errors import RefusedError, refused

log = logging.getLogger("armbridge.execution")

# Services that refusals name as the remedy.
ENABLE, RESET_FAULT = "/arm/enable", "/arm/reset_fault"

# Starting an interpreter, opening the bus, checking six servos and raising torque takes 1.2 s. Where other programs use
# every core, it has taken more than 15 s.
ARM_START_TIMEOUT_S = 60.0


class CurrentState:
    """Current joint positions."""

    def __init__(self, arm: AnyArm, robot: RobotModel) -> None:
        self._arm = arm
        self._frame = robot.root_link

    def positions_rad(self) -> dict[str, float] | None:
        """Return the position of every movable joint [rad]; None while they are unknown.

        These are the positions that the arm holds, not those it droops to: a motion from there starts without a step.
        """
        state = self._arm.state
        positions = state.position_rad if state.goal_rad is None else state.goal_rad
        if positions is None:
            return None
        return dict(zip(state.joint_names, positions.tolist(), strict=True))

    def speed_limit(self, joint_names: Collection[str]) -> float:
        """Return the share of the velocity limits that motions of some joints may use."""
        return self._arm.part(joint_names).state.pace.speed_limit

    @property
    def stamp_s(self) -> float:
        """Time of the latest state [s since the epoch]; of the arm's clock where that is faster than the machine's."""
        return self._arm.state.stamp_s

    def message(self) -> dict[str, Any]:
        """Return them as a moveit_msgs/RobotState without attached objects; without joints while they are unknown."""
        return state_message(self.positions_rad() or {}, self._frame, self.stamp_s)


def state_message(positions_rad: dict[str, float], frame: str, stamp_s: float) -> dict[str, Any]:
    """Return the moveit_msgs/RobotState of joints that stand still."""
    stamp = Stamp.from_seconds(stamp_s).as_message()
    header = {"stamp": stamp, "frame_id": frame}
    return {
        "joint_state": {
            "header": header,
            "name": list(positions_rad),
            "position": list(positions_rad.values()),
            "velocity": [],
            "effort": [],
        },
        "multi_dof_joint_state": {"header": header, "joint_names": [], "transforms": [], "twist": [], "wrench": []},
        "attached_collision_objects": [],
        "is_diff": False,
    }


def check_ready(arm: AnyArm) -> None:
    """Check that a motion can begin now; a refusal names one of several arms, and the service of this arm."""
    states, age_s = states_of(arm), arm.state_age_s
    for name, state in states.items():
        if state.mode is Mode.DISCONNECTED:
            message = f"{title_of(name)} is not connected: {state.reason}"
            raise refused(MoveItErrorCode.COMMUNICATION_FAILURE, message)
    if age_s > arm.state_max_age_s:
        raise refused(
            MoveItErrorCode.ROBOT_STATE_STALE,
            f"the last state of the arm is {age_s:.1f} s old (limit {arm.state_max_age_s:g} s)",
        )
    leaders = arm.leaders if isinstance(arm, ArmGroup) else frozenset[str]()
    for name, state in states.items():
        # While a leader is relaxed, it keeps no other arm from moving.
        if name not in leaders or state.mode is not Mode.RELAXED:
            title, prefix = title_of(name), name and f"/{name}"
            if state.fault is not None:
                text = f"{title} has a fault: {state.fault} The service that resets it is {prefix}{RESET_FAULT}."
                raise refused(MoveItErrorCode.CONTROL_FAILED, text)
            if state.mode is Mode.CONNECTED or state.goal_rad is None:
                reason = state.reason or "its servos are being checked"
                raise refused(MoveItErrorCode.COMMUNICATION_FAILURE, f"{title} is not ready: {reason}")
            if state.mode is Mode.RELAXED:
                text = f"{title} is relaxed: enable it by the service {prefix}{ENABLE} first"
                raise refused(MoveItErrorCode.CONTROL_FAILED, text)


def title_of(name: str) -> str:
    """Return the words for an arm in a sentence, from its name, which is empty for a lone arm."""
    return f"the arm {name}" if name else "the arm"


class CurrentScene:
    """Current planning scene as planners have it; another object, with another version, after every change."""

    def __init__(self) -> None:
        self.scene = EMPTY_SCENE
        self._callbacks: list[Callable[[], None]] = []

    def on_change(self, callback: Callable[[], None]) -> None:
        """Have this called after every change, also after those that planners do not see."""
        self._callbacks.append(callback)

    def changed(self) -> None:
        for callback in self._callbacks:
            callback()


# Asked together about one motion: it is free if all answers are.
Questions: TypeAlias = Sequence[RecheckQuestion | ConcurrencyQuestion]


class SceneMonitor:
    """Monitor of one motion at a time.

    A planner that does not answer in time is asked again for as long as the arm may be silent: a busy machine keeps
    both from the cores.
    """

    def __init__(self, pool: Planners, scene: CurrentScene, retry_for_s: float, clock: Callable[[], float]) -> None:
        self._pool, self._scene = pool, scene
        self._retry_for_s, self._clock = retry_for_s, clock
        self._checked_version = 0
        self._questions: Callable[[], Questions] | None = None
        self._on_contact: Callable[[PlanningFailure], None] = lambda _contact: None
        self._task: asyncio.Task[None] | None = None
        scene.on_change(self._on_change)

    async def check(self, questions: Callable[[], Questions]) -> None:
        until_s = self._clock() + self._retry_for_s
        while True:
            scene = self._scene.scene
            answer: RecheckAnswer | PlanningFailure = RecheckAnswer(None)
            for question in questions():
                answer = await self._pool.ask(question, scene)
                if isinstance(answer, PlanningFailure) or answer.contact is not None:
                    break
            late = isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT
            if not late or self._clock() >= until_s:
                break
        self._checked_version = scene.version
        if isinstance(answer, PlanningFailure):
            message = f"the motion cannot be checked for contacts: {answer.message}"
            raise refused(MoveItErrorCode.COLLISION_CHECKING_UNAVAILABLE, message, **answer.details)
        if answer.contact is not None:
            raise RefusedError(answer.contact)

    def start(
        self, version: int, questions: Callable[[], Questions], on_contact: Callable[[PlanningFailure], None]
    ) -> None:
        """Monitor a motion until :meth:`stop`, or until it is not free: then call ``on_contact`` once, and stop."""
        self._checked_version, self._questions, self._on_contact = version, questions, on_contact
        self._on_change()

    def stop(self) -> None:
        self._questions = None
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _on_change(self) -> None:
        if self._questions is not None and self._task is None:
            self._task = asyncio.create_task(self._check_changes(), name="check the rest of the motion")

    async def _check_changes(self) -> None:
        """Check until the scene no longer changes meanwhile."""
        try:
            while self._questions is not None and self._scene.scene.version != self._checked_version:
                await self.check(self._questions)
        except RefusedError as error:
            if self._questions is not None:
                self._questions = None
                log.warning("the scene has changed: %s", error)
                self._on_contact(error.failure)
        self._task = None
