"""Teaching by clients: the services under ``/teach/`` and the topic of the recording in progress."""

import asyncio
import functools
import logging
from typing import Any

import numpy as np

from planners.problem import Plan, PlanningFailure
from robot.description.model import RobotModel
from robot.messages import ArmState, Mode
from robot.trajectory import Vector
from server.errors import ServiceError
from server.graph.permissions import CONFIGURING, LOOKING, PLANNING, WORKING
from server.graph.providers import CompleteResponse
from server.graph.topics import Graph
from server.lifecycle import Feature
from server.moveit.messages import Message
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.requests.planning_problems import TRAJECTORY_LIMITS
from server.teaching.taught_motion import (
    MAX_DURATION_S,
    MotionFiles,
    TaughtMotion,
    from_message,
    of_recording,
    read_speed,
    to_message,
)

log = logging.getLogger("armbridge.teaching")

STATE_TOPIC = "/teach/state"
BEGIN = "/teach/begin"
END = "/teach/end"
DISCARD = "/teach/discard"

# Ten minutes of six joints are timed and checked in half a second on a quiet machine.
CHECK_TIME_S = 10.0

# Smoothing takes a tenth of a second, and so does a memory card; the server's stop has little more [s].
CLOSE_TIMEOUT_S = 0.6

# The state of a recording is published as often as people read it [s].
SHOWN_EVERY_S = 0.2

_HELD_BY_HAND = "the arm is relaxed, and nothing compensates its weight: hold it all the time"
_DRIVEN = (
    "the arm is driven: its commanded positions are recorded; /arm/relax lets a hand move it, which has to hold it"
)

# The arm's states come at most at this rate; of more the rest is left out.
MAX_RATE_HZ = 100.0


class TeachingRecorder:
    """Recording of some joints: of the arm's measured positions while it is relaxed, else of its commanded ones.

    Time is the control loop's, which a simulated arm on a busy machine does not outrun.
    """

    def __init__(self, name: str, joint_names: tuple[str, ...]) -> None:
        self.name = name
        self.joint_names = joint_names
        self._time_s: list[float] = []
        self._positions_rad: list[Vector] = []

    @property
    def duration_s(self) -> float:
        return self._time_s[-1] - self._time_s[0] if self._time_s else 0.0

    @property
    def points(self) -> int:
        return len(self._time_s)

    @property
    def samples(self) -> tuple[Vector, Vector]:
        """Times, shape (n,) [s], and positions, shape (n, joints) [rad]."""
        return np.array(self._time_s), np.array(self._positions_rad).reshape(len(self._time_s), len(self.joint_names))

    def take_state(self, state: ArmState) -> str:
        """Record a state; return the reason for which the recording ends with it, empty to go on."""
        if state.fault is not None:
            return f"the arm has a fault: {state.fault}"
        if state.mode is Mode.DISCONNECTED or state.position_rad is None:
            return f"the arm is not connected: {state.reason}" if state.reason else "the arm is not connected"
        if self._time_s and state.clock_s < self._time_s[-1]:
            return "the arm was started again"
        if self._time_s and state.clock_s - self._time_s[-1] < 0.5 / MAX_RATE_HZ:
            return ""
        if self._time_s and state.clock_s - self._time_s[0] > MAX_DURATION_S:
            return f"a recording lasts {MAX_DURATION_S:g} s at most"
        held_rad = state.goal_rad if state.torque_enabled and state.goal_rad is not None else state.position_rad
        self._time_s.append(state.clock_s)
        self._positions_rad.append(held_rad[[state.joint_names.index(name) for name in self.joint_names]])
        return ""


def joints_to_teach(robot: RobotModel, group: str) -> tuple[str, ...]:
    """Return the joints to record: a group's joints; without a name the default group's and the gripper's."""
    if group:
        if group not in robot.groups:
            raise ServiceError(f"group: must be one of {', '.join(robot.groups)}, not {group[:80]!r}")
        return robot.groups[group].joints
    joints = robot.groups[robot.default_group].joints
    gripper = robot.gripper.joints if robot.gripper is not None else ()
    return (*joints, *(name for name in gripper if name not in joints))


class Teaching(Feature):
    """Records motions, one at a time, and keeps them by name."""

    name = "teaching"
    deadline_s = CLOSE_TIMEOUT_S + 0.1

    def __init__(self, graph: Graph, planning: PlanningContext, motions: MotionFiles) -> None:
        self._planning, self._robot, self._motions = planning, planning.robot, motions
        self._node = graph.node("teaching")
        self._recorder: TeachingRecorder | None = None
        self._state: ArmState | None = None
        self._closing, self._reading = False, asyncio.Lock()
        self._shown_at_s = 0.0
        self._message = f"{BEGIN} begins a recording"
        # The recording that is being made a motion.
        self._finishing: asyncio.Task[dict[str, Any]] | None = None
        self._node.advertise(STATE_TOPIC, "armbridge_msgs/TeachState", latch=True)
        # To record moves nothing; a client that teaches may also drive.
        offer = functools.partial(self._node.offer, limits=TRAJECTORY_LIMITS)
        offer(BEGIN, "armbridge_msgs/srv/BeginTeaching", self._begin, rule=WORKING)
        offer(END, "armbridge_msgs/srv/EndTeaching", self._end, rule=WORKING)
        offer(DISCARD, "std_srvs/srv/Trigger", self._discard, rule=WORKING)
        offer("/teach/get", "armbridge_msgs/srv/GetMotion", self._get, rule=LOOKING)
        offer("/teach/check", "armbridge_msgs/srv/CheckMotion", self._check, rule=PLANNING)
        offer("/teach/save", "armbridge_msgs/srv/SaveMotion", self._save, rule=CONFIGURING)
        offer("/teach/delete", "armbridge_msgs/srv/DeleteMotion", motions.delete_for, rule=CONFIGURING)
        offer("/teach/rename", "armbridge_msgs/srv/RenameMotion", self._rename, rule=CONFIGURING)
        offer("/teach/trim", "armbridge_msgs/srv/TrimMotion", self._trim, rule=CONFIGURING)
        offer("/teach/list", "armbridge_msgs/srv/ListMotions", motions.list_for, rule=LOOKING)
        self._show()

    @property
    def observes_states(self) -> bool:
        return self._recorder is not None

    def on_state(self, arm: str, state: ArmState) -> None:
        """Record the latest state of all joints; end a recording that cannot go on."""
        if arm:
            return
        self._state = state
        recorder = self._recorder
        if recorder is None:
            return
        reason = recorder.take_state(state)
        if reason:
            log.warning("the recording of %r ends: %s", recorder.name, reason)
            self._finish(recorder, f"{reason}; ")
        elif abs(state.clock_s - self._shown_at_s) >= SHOWN_EVERY_S:
            self._shown_at_s = state.clock_s
            self._show()

    async def stop(self) -> None:
        """End the recording, and wait until it is saved; it is not checked, which may take seconds."""
        self._closing = True
        if self._recorder is not None:
            self._finish(self._recorder, "the server is ending; ")
        if self._finishing is not None:
            await asyncio.wait([self._finishing], timeout=CLOSE_TIMEOUT_S)

    # Recording.

    async def _begin(self, request: Message) -> str:
        self._check_idle()
        joints = joints_to_teach(self._robot, request["group"])
        state = self._state
        if state is None or state.position_rad is None:
            raise ServiceError("the arm is not connected: there is nothing to record")
        if state.fault is not None:
            raise ServiceError(f"the arm has a fault, after which no recording begins: {state.fault}")
        await self._motions.check_new(request["name"])
        # Another client may have begun while the disk was asked.
        self._check_idle()
        self._recorder = TeachingRecorder(request["name"], joints)
        self._message = _DRIVEN if state.torque_enabled else _HELD_BY_HAND
        self._show()
        log.info("recording of the motion %r begins", request["name"])
        return f"{', '.join(joints)} are recorded for at most {MAX_DURATION_S:g} s; {self._message}"

    def _check_idle(self) -> None:
        if self._recorder is not None:
            raise ServiceError(f"the motion {self._recorder.name!r} is being recorded: call {END} or {DISCARD} first")
        if self._finishing is not None and not self._finishing.done():
            raise ServiceError("the recording before is still being saved: call again")

    async def _end(self, _request: Message) -> dict[str, Any]:
        if self._recorder is None:
            raise ServiceError(f"nothing is recorded; {self._message}")
        # The motion is saved also when the caller leaves meanwhile.
        return await asyncio.shield(self._finish(self._recorder, ""))

    def _discard(self, _request: Message) -> str:
        if self._recorder is None:
            raise ServiceError(f"nothing is recorded; {self._message}")
        name, self._recorder = self._recorder.name, None
        self._message = f"the recording of {name!r} is discarded"
        self._show()
        return self._message

    def _finish(self, recorder: TeachingRecorder, reason: str) -> asyncio.Task[dict[str, Any]]:
        """End a recording; return the task that makes it a motion and answers as ``/teach/end``."""
        self._recorder = None
        self._message = f"{reason}the motion {recorder.name!r} is being saved"
        self._show()
        self._finishing = asyncio.create_task(self._make_motion(recorder, reason), name="saving a taught motion")
        return self._finishing

    async def _make_motion(self, recorder: TeachingRecorder, reason: str) -> dict[str, Any]:
        answer: dict[str, Any] = {"success": False, "duration_s": 0.0, "points": 0}
        try:
            time_s, positions_rad = recorder.samples
            motion, away_rad = await asyncio.to_thread(
                of_recording, recorder.joint_names, time_s, positions_rad, self._robot
            )
            await self._motions.save(recorder.name, motion)
            found = await self._checked(motion)
            text = (
                f"{reason}the motion {recorder.name!r} is saved: {motion.duration_s:.2f} s, {len(motion.time_s)} points"
                f" within {away_rad:.3f} rad of the recording; {found}"
            )
            answer = {"success": True, "duration_s": motion.duration_s, "points": len(motion.time_s)}
        except ServiceError as error:
            text = f"{reason}the motion {recorder.name!r} is not saved: {error}"
        except Exception:
            text = f"{reason}the motion {recorder.name!r} is not saved; the log has the cause"
            log.exception("saving the motion %r failed", recorder.name)
        log.info("%s", text)
        self._message = text
        self._show()
        return {**answer, "message": text}

    # Motions by name.

    async def _get(self, request: Message) -> CompleteResponse:
        # One at a time: the event loop, and a stop, would wait for the interpreter's lock behind each thread.
        async with self._reading:
            motion = await self._motions.load(request["name"])
            # As many points as a client may send take longer to complete than everybody may be kept waiting.
            trajectory = await asyncio.to_thread(to_message, motion)
        message = f"{motion.duration_s:.2f} s, {len(motion.time_s)} points"
        return CompleteResponse({"success": True, "message": message, "trajectory": trajectory})

    async def _check(self, request: Message) -> dict[str, Any]:
        speed = read_speed(request["speed"])
        motion = await self._motions.load(request["name"])
        answer = await self._planned(motion, speed)
        if isinstance(answer, str):
            raise ServiceError(answer)
        message = self._touches_nothing(motion, speed, answer)
        return {"success": True, "message": message, "duration_s": answer.trajectory.duration_s}

    async def _save(self, request: Message) -> str:
        name = request["name"]
        motion = await asyncio.to_thread(from_message, request["trajectory"], self._robot)
        await self._motions.save(name, motion)
        return f"the motion {name!r} is saved; {await self._checked(motion)}"

    async def _rename(self, request: Message) -> str:
        name, new_name = request["name"], request["new_name"]
        await self._motions.rename(name, new_name)
        return f"the motion {name!r} is now {new_name!r}"

    async def _trim(self, request: Message) -> dict[str, Any]:
        name = request["name"]
        motion = (await self._motions.load(name)).part(request["from_s"], request["to_s"])
        await self._motions.save(name, motion)
        message = f"the motion {name!r} lasts {motion.duration_s:.2f} s; {await self._checked(motion)}"
        return {"success": True, "message": message, "duration_s": motion.duration_s}

    async def _checked(self, motion: TaughtMotion) -> str:
        answer = await self._planned(motion, 1.0)
        return answer if isinstance(answer, str) else self._touches_nothing(motion, 1.0, answer)

    def _touches_nothing(self, motion: TaughtMotion, speed: float, plan: Plan) -> str:
        text = f"it touches nothing, and a replay takes {plan.trajectory.duration_s:.2f} s"
        slowed = motion.slowed(speed, plan.trajectory, self._robot)
        return f"{text}, {slowed}" if slowed else text

    async def _planned(self, motion: TaughtMotion, speed: float) -> Plan | str:
        """Return the plan of a replay in the present scene, or why there is none."""
        if self._closing:
            return "it was not checked: the server is ending"
        held_rad = self._planning.current.positions_rad()
        if held_rad is None:
            return "it was not checked: joint positions unknown: the arm is not connected"
        problem = motion.problem(held_rad, speed, CHECK_TIME_S)
        answer = await self._planning.pool.ask(problem, self._planning.scene_state.scene)
        if isinstance(answer, PlanningFailure):
            return f"it cannot be replayed: {answer.message}"
        return answer

    # Messages.

    def _show(self) -> None:
        message: dict[str, Any] = {"message": self._message}
        if (recorder := self._recorder) is not None:
            message |= {"recording": True, "name": recorder.name}
            message |= {"duration_s": recorder.duration_s, "points": recorder.points}
        self._node.publish(STATE_TOPIC, message)
