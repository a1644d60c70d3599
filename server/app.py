"""The composition root: makes every part, starts them in order, and ends them in reverse."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import uvloop

from planners.pool import PlannerPool
from protocol.registry import Registry
from robot import model
from robot.arm import Arm
from robot.calibration import Calibration
from robot.calibration_files import find_calibration
from robot.errors import RobotError
from robot.limits import within_calibration
from robot.messages import ArmConfig, ArmHealth, ArmState, Mode
from robot.model import RobotModel
from server.arm_pace import ArmPace
from server.arm_services import ArmServices
from server.arm_state import ArmStateTopics
from server.config import ArmSettings, RecordingSettings, Settings
from server.diagnostics import Diagnostics
from server.emulated_bus import EmulatedBus
from server.errors import ConfigurationError, StartError
from server.gateway import page
from server.gateway.http import HttpGate
from server.gateway.listener import Listener
from server.graph import Graph
from server.joint_states import JointStates
from server.moveit.face import MoveItFace
from server.moveit.parameters import MoveItParameters
from server.rosapi.api import RosApi
from server.rosout import Rosout

if TYPE_CHECKING:
    from server.recording.recorder import Recorder

log = logging.getLogger("armbridge")

# Opening the bus, checking six servos and raising torque takes 0.7 s; a machine under load takes longer.
ARM_START_TIMEOUT_S = 15.0

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
    """The arm by its files: the robot within its calibration.

    Attributes:
        calibration_file: where the calibration was read; None for that of an ideal arm.
    """

    robot: RobotModel
    calibration: Calibration
    calibration_file: Path | None

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
            file = find_calibration(str(settings.calibration), os.environ) if settings.calibration else None
            read = Calibration.load(file) if file else Calibration.nominal()
            calibration = read.with_zero_offsets(settings.zero_offset_rad)
            return cls(within_calibration(robot, calibration), calibration, file)
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
        self._recorder: Recorder | None = None
        self._joint_states = JointStates(self._graph)
        self._arm_state = ArmStateTopics(self._graph, description.robot)
        self._diagnostics = Diagnostics(self._graph, description.robot.name)
        self._arm_services = ArmServices(self._graph)
        self._arm_pace = ArmPace(self._graph)
        self._face = MoveItFace(self._graph, description.robot, settings, self._rosapi.parameters.keep)
        self._listener = Listener(
            self._graph,
            settings.server.host,
            settings.server.port,
            HttpGate(description.robot),
            takes_goals_along=settings.goals.on_disconnect == "stop",
        )
        self._pool = PlannerPool(
            description.robot, settings.planning.workers, settings.planning.memory_limit_mb * BYTES_PER_MB
        )
        self._emulated_bus = (
            EmulatedBus(settings.emulator, description.calibration_file) if settings.arm.serial is None else None
        )
        self._arm: Arm | None = None

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
            if not page.is_built(page.PAGE_DIRECTORY):
                log.info("%s", page.HOW_TO_GET_IT)
            await ending.wait()
            log.info("stopping")
        finally:
            await self._stop()
        log.info("stopped")

    async def _start(self) -> None:
        self._rosout = Rosout(self._graph, asyncio.get_running_loop())
        self._rosout.open()
        self._rosapi.open()
        self._recorder = open_recorder(self._settings.recording, self._graph, self._description.robot.name)
        # The port first: nothing else needs to start, and no arm to be switched on, when it is taken.
        await self._listener.bind()
        await self._pool.start()
        port = self._settings.arm.serial if self._emulated_bus is None else await self._emulated_bus.start()
        self._joint_states.open()
        self._arm_state.open()
        self._diagnostics.open()
        self._arm = Arm(arm_config(self._settings.arm, self._description, str(port)), self._on_state, self._on_health)
        try:
            await self._arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError as error:
            raise StartError(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s") from error
        self._face.open(self._arm, self._pool)
        self._arm_services.open(self._arm, self._face.stop)
        self._arm_pace.open(self._arm)
        await self._listener.open()

    def _on_state(self, state: ArmState) -> None:
        self._joint_states.publish(state)
        self._arm_state.take_state(state)
        self._diagnostics.take_state(state)
        self._face.take_state(state)

    def _on_health(self, health: ArmHealth) -> None:
        self._arm_state.take_health(health)
        self._diagnostics.take_health(health)

    async def _stop(self) -> None:
        """The arm first, brought to its end state; then the sockets; then the processes that nothing needs any more."""
        await self._face.close()
        if self._arm is not None:
            await self._arm.close()
        self._diagnostics.close()
        await self._listener.close()
        await self._pool.close()
        if self._emulated_bus is not None:
            await self._emulated_bus.close()
        if self._recorder is not None:
            await self._recorder.close()
        if self._rosout is not None:
            self._rosout.close()

    def _what_runs_where(self) -> str:
        arm = self._arm
        if arm is None:
            raise AssertionError("told before the start")
        bus = "simulated" if self._emulated_bus is not None else f"on {self._settings.arm.serial}"
        if arm.state.mode is Mode.DISCONNECTED:
            bus += f", NOT CONNECTED ({arm.state.reason})"
        elif arm.state.mode is not Mode.HOLDING:
            bus += f", {arm.state.mode.name} ({arm.state.fault or arm.state.reason or 'not enabled'})"
        where = f"{self._settings.server.host}:{self._listener.port}"
        shown = f"http://{where}/ (page), " if page.is_built(page.PAGE_DIRECTORY) else ""
        return (
            f"armbridge is ready: ws://{where} (rosbridge), {shown}"
            f"{self._description.robot.name} arm {bus} (process {arm.pid}, 100 Hz), "
            f"planners in processes {', '.join(str(pid) for pid in self._pool.pids)}"
        )


def arm_config(settings: ArmSettings, description: Description, port: str) -> ArmConfig:
    """What the arm process needs to know.

    Args:
        settings: the section ``arm``.
        description: the arm by its files.
        port: its serial port.
    """
    return ArmConfig(
        robot=description.robot,
        calibration=description.calibration,
        port=port,
        state_rate_hz=settings.joint_state_rate_hz,
        start_enabled=settings.start_enabled,
        watchdog_s=settings.watchdog_s,
        on_server_lost=settings.on_server_lost,
        on_exit=settings.on_exit,
        on_emergency_stop=settings.on_emergency_stop,
        warn_temperature_c=settings.warn_temperature_c,
        slow_temperature_c=settings.slow_temperature_c,
        stop_temperature_c=settings.stop_temperature_c,
    )


def open_recorder(settings: RecordingSettings, graph: Graph, robot_name: str) -> Recorder | None:
    """Begin to record, if the settings name a file.

    Args:
        settings: the section ``recording``.
        graph: what is recorded.
        robot_name: for whoever reads the file.

    Raises:
        StartError: the file cannot be written.
    """
    if settings.file is None:
        return None
    # Imported when it is needed: most servers record nothing, and start without the library.
    from server.recording.recorder import Recorder

    recorder = Recorder(graph, settings.file, settings.limit_mb, settings.keep_files, {"robot": robot_name})
    recorder.open()
    return recorder


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
