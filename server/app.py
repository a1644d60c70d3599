"""The composition root: makes every part, starts them in order, and ends them in reverse."""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
import time
from dataclasses import dataclass

import uvloop

from planners.pool import PlannerPool
from protocol.registry import Registry
from robot import model
from robot.arm import Arm
from robot.calibration import Calibration
from robot.errors import RobotError
from robot.limits import within_calibration
from robot.messages import ArmConfig, Mode
from robot.model import RobotModel
from server.config import ArmSettings, Settings
from server.emulated_bus import EmulatedBus
from server.errors import ConfigurationError, StartError
from server.gateway.listener import Listener
from server.goal_queue import GoalQueue
from server.graph import Graph
from server.joint_states import JointStates
from server.moveit.execution import GoalExecutor
from server.moveit.failed_goals import FailedGoals
from server.moveit.goal_topics import GoalTopics
from server.moveit.goals import GoalTranslator, MotionRequest
from server.moveit.parameters import MoveItParameters
from server.rosapi.api import RosApi
from server.rosout import Rosout

log = logging.getLogger("armbridge")

# Opening the bus, checking six servos and raising torque takes 0.7 s; a machine under load takes longer.
ARM_START_TIMEOUT_S = 15.0

# The queue waits this long for the arm to brake; the arm process has its own deadline after that.
QUEUE_CLOSE_TIMEOUT_S = 1.0

BYTES_PER_MB = 1_000_000


def serve(settings: Settings) -> None:
    """Run the server until SIGINT or SIGTERM.

    Raises:
        ConfigurationError: settings that contradict each other or the robot.
        StartError: a part that cannot start, such as a port in use.
    """
    uvloop.run(App(settings).run())


@dataclass(frozen=True)
class Description:
    """The arm by its files: the robot within its calibration."""

    robot: RobotModel
    calibration: Calibration

    @classmethod
    def read(cls, settings: ArmSettings) -> Description:
        """Read the files named in the settings, or the built-in ones.

        Raises:
            ConfigurationError: a file that cannot be used.
        """
        try:
            if settings.urdf is not None and settings.srdf is not None:
                robot = model.load(settings.urdf, settings.srdf)
            else:
                robot = model.builtin()
            calibration = Calibration.load(settings.calibration) if settings.calibration else Calibration.nominal()
            return cls(within_calibration(robot, calibration), calibration)
        except RobotError as error:
            raise ConfigurationError(str(error)) from error


class App:
    """The server: parts in the order of their start.

    Args:
        settings: everything that can be chosen.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        description = Description.read(settings.arm)
        check_parameters(settings.moveit, description.robot)
        self._description = description
        registry = Registry.load()
        self._graph = Graph(registry, relay_unknown_types=settings.server.relay_unknown_types)
        self._rosapi = RosApi(self._graph, self._graph.services, self._graph.actions, registry, time.time)
        self._rosout: Rosout | None = None
        self._joint_states = JointStates(self._graph)
        self._goal_topics = GoalTopics(self._graph, GoalTranslator(description.robot, settings.moveit))
        self._listener = Listener(self._graph, settings.server.host, settings.server.port)
        self._pool = PlannerPool(
            description.robot, settings.planning.workers, settings.planning.memory_limit_mb * BYTES_PER_MB
        )
        self._failed_goals = (
            FailedGoals(settings.planning.save_failed_goals, description.robot, time.time)
            if settings.planning.save_failed_goals is not None
            else None
        )
        self._emulated_bus = (
            EmulatedBus(settings.emulator, settings.arm.calibration) if settings.arm.serial is None else None
        )
        self._arm: Arm | None = None
        self._queue: GoalQueue[MotionRequest] | None = None

    async def run(self) -> None:
        """Start, serve until a signal, stop; whatever was started is stopped, also when a later part fails."""
        ending = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, ending.set)
        try:
            await self._start()
            # What lives as long as the server need not be looked at by every collection.
            gc.collect()
            gc.freeze()
            log.info("%s", self._what_runs_where())
            await ending.wait()
            log.info("stopping")
        finally:
            await self._stop()
        log.info("stopped")

    async def _start(self) -> None:
        self._rosout = Rosout(self._graph, asyncio.get_running_loop())
        self._rosout.open()
        self._rosapi.open()
        # The port first: nothing else needs to start, and no arm to be switched on, when it is taken.
        await self._listener.bind()
        await self._pool.start()
        port = self._settings.arm.serial if self._emulated_bus is None else await self._emulated_bus.start()
        config = ArmConfig(
            self._description.robot,
            self._description.calibration,
            str(port),
            self._settings.arm.joint_state_rate_hz,
        )
        self._joint_states.open()
        self._arm = Arm(config, self._joint_states.publish)
        try:
            await self._arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError as error:
            raise StartError(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s") from error
        self._queue = GoalQueue(
            GoalExecutor(self._arm, self._pool, self._settings.moveit, self._failed_goals),
            self._settings.goals.policy,
            self._settings.goals.capacity,
            self._goal_topics.on_progress,
            self._goal_topics.on_answer,
        )
        self._queue.start()
        self._goal_topics.open(self._queue)
        await self._listener.open()

    async def _stop(self) -> None:
        """The arm first; then the sockets; then the processes that nothing needs any more."""
        if self._queue is not None:
            await self._queue.close(QUEUE_CLOSE_TIMEOUT_S)
        if self._arm is not None:
            await self._arm.close()
        await self._listener.close()
        await self._pool.close()
        if self._emulated_bus is not None:
            await self._emulated_bus.close()
        if self._rosout is not None:
            self._rosout.close()

    def _what_runs_where(self) -> str:
        arm = self._arm
        if arm is None:
            raise AssertionError("told before the start")
        bus = "simulated" if self._emulated_bus is not None else f"on {self._settings.arm.serial}"
        if arm.state.mode is Mode.DISCONNECTED:
            bus += f", NOT CONNECTED ({arm.state.reason})"
        return (
            f"armbridge is ready: ws://{self._settings.server.host}:{self._listener.port} (rosbridge), "
            f"{self._description.robot.name} arm {bus} (process {arm.pid}, 100 Hz), "
            f"planners in processes {', '.join(str(pid) for pid in self._pool.pids)}"
        )


def check_parameters(parameters: MoveItParameters, robot: RobotModel) -> None:
    """Hold the parameters against the robot.

    Raises:
        ConfigurationError: a group, link or frame that the robot does not have.
    """
    group, link, frame = (
        parameters.group_name,
        parameters.end_effector_link,
        parameters.planning_frame.lstrip("/"),
    )
    if group not in robot.groups:
        raise ConfigurationError(
            f"moveit.group_name: there is no group {group!r}; the SRDF has {', '.join(robot.groups)}"
        )
    if link and link not in robot.links:
        raise ConfigurationError(
            f"moveit.end_effector_link: there is no link {link!r}; the URDF has {', '.join(robot.links)}"
        )
    if frame and frame != robot.root_link:
        raise ConfigurationError(f"moveit.planning_frame: must be the root link {robot.root_link!r}, not {frame!r}")
