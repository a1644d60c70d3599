"""The composition root: makes every part, starts them in order, and ends them in reverse."""

from __future__ import annotations

import asyncio
import gc
import logging
import time
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any

import uvloop

from planners.pool import PlannerPool
from protocol.registry import Registry
from robot.arm import Arm
from robot.messages import ArmHealth, ArmState, EndState, Mode
from robot.processes import StartedChild
from server.access.authorization import Access
from server.access.control_lease import ControlServices
from server.arm.services import ArmPace, ArmServices
from server.arm.setup import Description, arm_config, check_parameters
from server.arm.topics import ArmStateTopics, JointStates
from server.config import RecordingSettings, Settings
from server.errors import StartError
from server.execution.current_state import ARM_START_TIMEOUT_S
from server.gateway.http import HOW_TO_BUILD_PAGE, PAGE_DIRECTORY, HttpHandler, page_is_built
from server.gateway.listener import Listener, ListenerSettings
from server.graph.topics import Graph
from server.lifecycle import Step, stop_in_order, stop_signals, unless_ended
from server.monitoring.monitor import Monitor
from server.monitoring.ros_topics import Diagnostics, Rosout, offer_level_services
from server.monitoring.systemd import SystemdNotifier, on_debug_signal, on_hangup
from server.moveit.interface import MoveItInterface
from server.rosapi import RosApi
from server.timers import call_later
from server.zenoh.bridge import bridge_of

if TYPE_CHECKING:
    from server.recording.recorder import Recorder

log = logging.getLogger("armbridge")

# What the end of the server may take in all, and each of its steps [s]; an arm that relaxes takes its time besides.
STOP_TOTAL_S = 2.6
RELAXING_S = 2.5


def serve(settings: Settings, arm_process: StartedChild | None = None) -> None:
    """Run the server until SIGINT or SIGTERM.

    Args:
        settings: everything that can be chosen.
        arm_process: the arm's process, if it was started ahead.

    Raises:
        ConfigurationError: settings that contradict each other or the robot.
        StartError: a part that cannot start, such as a port in use.
    """
    uvloop.run(App(settings, arm_process).run())


class App:
    """The server: parts in the order of their start.

    Args:
        settings: everything that can be chosen.
        arm_process: the arm's process, if it was started ahead.
    """

    def __init__(self, settings: Settings, arm_process: StartedChild | None = None) -> None:
        self._settings = settings
        description = Description.read(settings.arm)
        check_parameters(settings.moveit, description.robot)
        self._description = description
        registry = Registry.load()
        self._graph = Graph(
            registry,
            relay_unknown_types=settings.server.relay_unknown_types,
            unregister_timeout_s=settings.server.unregister_timeout_s,
        )
        offer_level_services(self._graph)
        self._monitor = Monitor(SystemdNotifier.from_environment())
        access = self._access = Access(settings.access)
        self._control = ControlServices(self._graph, access.lease, time.monotonic, call_later)
        self._rosapi = RosApi(self._graph, params=access.params)
        self._rosout: Rosout | None = None
        self._recorder: Recorder | None = None
        self._joint_states = JointStates(self._graph)
        self._arm_state = ArmStateTopics(self._graph, description.robot)
        self._diagnostics = Diagnostics(self._graph, description.robot.name)
        self._arm_services = ArmServices(self._graph)
        self._arm_pace = ArmPace(self._graph)
        self._listener = Listener(
            self._graph,
            settings.server.host,
            settings.server.port,
            HttpHandler(description.robot, routes=self._monitor.routes),
            takes_goals_along=settings.goals.on_disconnect == "stop",
            settings=ListenerSettings.from_settings(settings.server, settings.access, access.tokens),
            access=access,
            limits=settings.server.limits.limits(),
        )
        planning = settings.planning
        self._pool = PlannerPool(description.robot, planning.workers, planning.memory_limit_bytes)
        self._bridge = bridge_of(settings.zenoh, self._graph, access, settings.server.limits.max_message_bytes)
        self._arm = Arm(arm_config(settings, description), self._on_state, self._on_health, arm_process)
        self._moveit = MoveItInterface(
            self._graph, description.robot, settings, self._rosapi.parameters.keep, self._arm, self._pool
        )
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def run(self) -> None:
        """Start, serve until a signal, stop; whatever was started is stopped, also when a later part fails.

        A second signal hurries the stop.
        """
        ending, hurry = stop_signals()
        on_hangup(self._listener.reload_certificate, ending.set)
        on_debug_signal()
        try:
            if await unless_ended(ending, self._start()):
                self._tell_start()
                await ending.wait()
            log.info("stopping")
        finally:
            self._monitor.notify_stopping()
            await stop_in_order(self._steps_of_stop(), self._stop_total_s(), hurry)
            await self._end_task("monitor")
            self._monitor.close()
        log.info("stopped")

    def _tell_start(self) -> None:
        self._monitor.notify_started()
        log.info("%s", self._what_runs_where())
        if not page_is_built(PAGE_DIRECTORY):
            log.info("%s", HOW_TO_BUILD_PAGE)

    async def _start(self) -> None:
        self._rosout = Rosout(self._graph, asyncio.get_running_loop())
        self._run_task("monitor", self._monitor.run())
        self._recorder = open_recorder(self._settings.recording, self._graph, self._description.robot.name)
        # The port first: nothing else needs to start, and no arm to be switched on, when it is taken.
        await self._listener.bind()
        # Interpreters start and load while the server opens its parts. Clients are answered from then on, and what they
        # want to be moved waits for the arm.
        await self._arm.launch()
        self._open_parts()
        self._monitor_parts()
        await self._listener.open()
        if self._bridge is not None:
            self._run_task("zenoh", self._bridge.run())
        await self._pool.start()
        # What lives as long as the server need not be looked at by every collection. Nothing moves yet that could wait.
        gc.collect()
        gc.freeze()
        try:
            await self._arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError as error:
            raise StartError(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s") from error

    def _open_parts(self) -> None:
        self._joint_states.open()
        self._arm_state.open()
        self._run_task("diagnostics", self._diagnostics.run())
        self._arm_state.take_state(self._arm.state)
        self._moveit.start()
        self._arm_services.open(self._arm, self._moveit.stop)
        self._arm_pace.open(self._arm)
        self._control.open(lambda: self._moveit.queue.busy)

    def _monitor_parts(self) -> None:
        """Monitor all parts that are open now."""
        sources = self._monitor.sources
        sources.traffic, sources.arm, sources.planners = self._listener.traffic, self._arm, self._pool
        sources.refused_connections = self._listener.refused_connections
        sources.goal_counters, sources.queue = self._moveit.goal_counters, self._moveit.queue
        sources.recorder, sources.zenoh = self._recorder, self._bridge

    def _on_state(self, state: ArmState) -> None:
        self._joint_states.publish(state)
        self._arm_state.take_state(state)
        self._diagnostics.take_state(state)
        self._moveit.take_state(state)

    def _on_health(self, health: ArmHealth) -> None:
        self._arm_state.take_health(health)
        self._diagnostics.take_health(health)
        self._monitor.sources.arm_health = health

    def _run_task(self, name: str, running: Coroutine[Any, Any, None]) -> None:
        task = self._tasks[name] = asyncio.create_task(running, name=name)
        task.add_done_callback(_log_failure)

    async def _end_task(self, name: str) -> None:
        """Cancel a task, if it was started, and wait for its end."""
        task = self._tasks.pop(name, None)
        if task is not None:
            task.cancel()
            await asyncio.wait([task])

    def _steps_of_stop(self) -> list[Step]:
        """The arm first, brought to its end state; then the clients; then what nothing needs any more."""
        relaxing_s = RELAXING_S if self._settings.arm.on_exit is EndState.RELAX else 0.0
        return [
            Step("goals", self._moveit.close, 1.1),
            Step("the arm", self._arm.close, 0.8 + relaxing_s),
            Step("clients", self._close_clients, 0.6),
            Step("other machines", lambda: self._end_task("zenoh"), 0.4),
            Step("the recording", self._close_recorder, 0.8),
            Step("planners", self._pool.close, 0.4),
        ]

    def _stop_total_s(self) -> float:
        relaxing = self._settings.arm.on_exit is EndState.RELAX
        return STOP_TOTAL_S + RELAXING_S if relaxing else STOP_TOTAL_S

    async def _close_clients(self) -> None:
        self._control.close()
        await self._end_task("diagnostics")
        await self._listener.close()

    async def _close_recorder(self) -> None:
        if self._recorder is not None:
            await self._recorder.close()
        if self._rosout is not None:
            self._rosout.close()

    def _what_runs_where(self) -> str:
        arm, serial = self._arm, self._settings.arm.serial
        bus = f"on {serial}" if serial is not None else "simulated"
        if self._description.calibration is None:
            bus += " (ideal)"
        if arm.state.mode is Mode.DISCONNECTED:
            bus += f", NOT CONNECTED ({arm.state.reason})"
        elif arm.state.mode is not Mode.HOLDING:
            bus += f", {arm.state.mode.name} ({arm.state.fault or arm.state.reason or 'not enabled'})"
        shown = f"{self._listener.page_url} (page), " if page_is_built(PAGE_DIRECTORY) else ""
        return (
            f"armbridge is ready: {self._listener.url} (rosbridge), {shown}"
            f"{self._description.robot.name} arm {bus} (process {arm.pid}, 100 Hz), "
            f"planners in processes {', '.join(str(pid) for pid in self._pool.pids)}"
        )


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        log.error("%s failed", task.get_name(), exc_info=task.exception())


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

    return Recorder(graph, settings.file, settings.limit_mb, settings.keep_files, {"robot": robot_name})
