"""Composition root: makes every part of the server, starts them in order, and stops them in reverse."""

from __future__ import annotations

import asyncio
import functools
import logging
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import uvloop

from planners.interface import Planners
from planners.pool import PlannerPool
from planners.shared_pool import SharedPlanners
from robot.arm import CLOSE_LIMIT_S, Arm
from robot.arm_group import ArmGroup
from robot.arm_interface import ArmInterface
from robot.description.servo_table import HardwareTable
from robot.errors import OrderRefused
from robot.messages import ArmHealth, ArmState, Mode, Order
from robot.processes import StartedChild
from server.access.authorization import Access
from server.access.control_lease import ControlServices
from server.access.one_time_tokens import OneTimeTokenService
from server.arm.calibrating import CalibrationProcedure, Recalibrated, calibration_file, check_state_rate
from server.arm.commissioning import Commissioning, Procedure
from server.arm.named_arms import NamedArms, joined_robot, read_arms
from server.arm.services import ArmPace, ArmServices
from server.arm.setup import Description, arm_config, check_parameters
from server.arm.topics import ArmStateTopics, JointStates, states_are_observed
from server.arm.verifying import VerificationProcedure
from server.config import ArmRole, RecordingSettings, Settings
from server.datasets.marking import EpisodeServices
from server.errors import StartError
from server.execution.monitors import ARM_START_TIMEOUT_S
from server.execution.parking import LastClient, Parking
from server.execution.queue import RunningGoal
from server.gateway.http import HOW_TO_BUILD_PAGE, HttpHandler, Route, page_is_built
from server.gateway.listener import Listener
from server.graph.topics import Graph
from server.installation import PAGE_DIRECTORY
from server.interfaces import load_registry
from server.lifecycle import BackgroundTask, Part, first_of, start_in_order, stop_in_reverse, stop_signals, unless_ended
from server.monitoring.fault_files import FaultFiles
from server.monitoring.health import Sources
from server.monitoring.log_ring import LogRing
from server.monitoring.memory import SWITCH_INTERVAL_S, CollectorPolicy, MemoryKeeper
from server.monitoring.monitor import Monitor
from server.monitoring.ros_topics import Diagnostics, Rosout, offer_level_services
from server.monitoring.servo_history import ServoHistory
from server.monitoring.systemd import SystemdNotifier, on_debug_signal, on_hangup
from server.moveit.arm_goals import ArmGoals
from server.moveit.interface import MoveItInterface
from server.moveit.named_states import data_directory
from server.rosapi import RosApi
from server.zenoh.bridge import bridge_of

if TYPE_CHECKING:
    from server.recording.recorder import Recorder

log = logging.getLogger("armbridge")

# Longest stop of all parts together, but for the arm's end [s].
STOP_TOTAL_S = 2.6

# More than the arm's handle gives its process [s].
ARM_STOP_S = CLOSE_LIMIT_S + 10.0

# Source of parking, in log lines and reports.
LAST_CLIENT = "arm.on_last_client"

# Planning the way to the rest pose takes milliseconds; a planner may be working on something else [s].
PREPARING_S = 4.0


@dataclass(frozen=True)
class Inherited:
    """Parts of a server that the process which has forked it made for several.

    Attributes:
        description: the arm by its files.
        planners: path of the socket of the planners' host.
    """

    description: Description
    planners: Path


def serve(settings: Settings, arm_process: StartedChild | None = None, inherited: Inherited | None = None) -> None:
    """Run the server until SIGINT or SIGTERM.

    Args:
        settings: everything that can be chosen.
        arm_process: the arm's process, if it was started ahead.
        inherited: parts that are made already; None for a server on its own.

    Raises:
        ConfigurationError: settings that contradict each other or the robot.
        StartError: a part that cannot start, such as a port in use.
    """
    # Read once: systemd's variables are gone from the environment then, and a new start goes on notifying.
    notifier = SystemdNotifier.from_environment()

    async def run() -> None:
        app = App(settings, arm_process, inherited, notifier=notifier)
        while (start := await app.run()) is not None:
            app = App(start.settings, inherited=inherited, recalibrated=start.recalibrated, notifier=notifier)

    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        uvloop.run(run())
    finally:
        notifier.close()


@dataclass(frozen=True)
class NewStart:
    """Start of the server in place of one that has ended: the arm was calibrated.

    Attributes:
        settings: everything that can be chosen.
        recalibrated: the new calibration.
    """

    settings: Settings
    recalibrated: Recalibrated


class App:
    """The server and its parts; made in the event loop in which it runs.

    Args:
        settings: everything that can be chosen.
        arm_process: the arm's process, if it was started ahead.
        inherited: parts that are made already; None for a server on its own.
        recalibrated: calibration that the server before this one has written; None for the first.
        notifier: notifier of systemd; None for a server that is not its service.
    """

    def __init__(
        self,
        settings: Settings,
        arm_process: StartedChild | None = None,
        inherited: Inherited | None = None,
        recalibrated: Recalibrated | None = None,
        notifier: SystemdNotifier | None = None,
    ) -> None:
        files = read_arms(settings) if inherited is None else {}
        if inherited is not None:
            self._description = inherited.description
        elif files:
            robot = joined_robot(files)
            self._description = Description(robot.name, robot, HardwareTable(), None)
        else:
            self._description = Description.read(settings.arm)
        robot = self._description.robot
        check_parameters(settings.moveit, robot)
        self._settings = settings
        graph = self._graph = Graph(
            load_registry(settings.server.interfaces),
            relay_unknown_types=settings.server.relay_unknown_types,
            unregister_timeout_s=settings.server.unregister_timeout_s,
        )
        # The goal queue is among the parts below; a lease is asked for when clients drive.
        access = Access(
            settings.access,
            busy=lambda: self._moveit.running,
            arms={name: functools.partial(self._running_of, name) for name in files},
        )

        # What refuses wrong settings, and what other parts use; none of it does anything before its start.
        routes: dict[str, Route] = {}
        self._listener = Listener(
            graph,
            settings.server,
            HttpHandler(robot, routes=routes),
            access,
            takes_goals_along=settings.goals.on_disconnect == "stop",
        )
        self._bridge = bridge_of(settings.zenoh, graph, access, settings.server.limits.max_message_bytes)

        def observed() -> bool:
            return states_are_observed(graph) or self._moveit.teaching.recording or self._moveit.teleoperation.active

        # One arm by itself, or several by name.
        self._arms: NamedArms | None = None
        self._arm: Arm | ArmGroup
        if files:
            self._arms = NamedArms(graph, files, self._on_arm_state, self._on_states, self._on_health, observed)
            self._arm = self._arms.group
        else:
            config = arm_config(settings, self._description)
            if recalibrated is not None:
                resumed = config.hardware.resumed(recalibrated.position_rad, driven=False)
                config = replace(config, hardware=resumed)
            self._arm = Arm(config, self._on_state, self._on_health, arm_process, observed=observed)
        self._pool: Planners = (
            PlannerPool(robot, settings.planning.workers, settings.planning.memory_limit_bytes)
            if inherited is None
            else SharedPlanners(inherited.planners)
        )

        # Ahead of the parts that latch messages; its file is opened when nothing can refuse the start any more.
        self._log_ring = LogRing()
        self._recorder = open_recorder(settings.recording, graph, robot.name)
        EpisodeServices(graph, lambda: self._recorder is not None and not self._recorder.ended)
        self._joint_states = JointStates(graph)
        self._arm_state = ArmStateTopics(graph, robot, self._arm.state)
        diagnostics = settings.diagnostics
        self._fault_files = FaultFiles(
            diagnostics.directory(data_directory(os.environ)), diagnostics.fault_files, self._log_ring, robot.name
        )
        self._diagnostics = Diagnostics(graph, robot.name, lambda: self._fault_files.latest)
        self._history = ServoHistory(graph)
        rosapi = RosApi(graph, params=access.params)
        self._moveit = MoveItInterface(graph, robot, settings, rosapi.parameters.keep, self._arm, self._pool)
        self._parking = self._last_client = None
        if isinstance(self._arm, Arm):
            parking = self._parking = Parking(
                self._arm,
                robot,
                settings.arm,
                settings.moveit,
                self._pool,
                self._moveit.scene,
                self._moveit.queue,
            )
            self._last_client = LastClient(
                settings.arm,
                drivers=lambda: len(access.drivers),
                busy=lambda: not self._nothing_moves(),
                park=lambda: parking.park(LAST_CLIENT),
                relax=lambda: self._arm.order(Order.RELAX),
            )
        ArmServices(graph, self._arm, self._moveit.stop, None if self._parking is None else self._parking.park)
        self._goals_of: dict[str, ArmGoals] = {}
        for name, arm in {} if self._arms is None else self._arms.arms.items():
            limit = arm.files.settings.guards.gripper_torque_limit
            leads = arm.files.settings.role is ArmRole.LEADER
            goals = self._moveit.add_arm(arm.graph, name, arm.files.description.robot, arm.arm, limit, leads=leads)
            arm.open(goals.stop, access.leases_of_arms[name])
            self._goals_of[name] = goals
        ArmPace(graph, self._arm)
        self._inherits = inherited is not None
        self._next: NewStart | None = None
        self._start_anew = asyncio.Event()
        ended = None if recalibrated is None else recalibrated.ended
        self._commissioning = Commissioning(graph, self._commission, ended)
        self._control = ControlServices(graph, access.lease)
        OneTimeTokenService(graph, access.one_time_tokens, access.tokens, lambda: self._listener.page_urls_elsewhere)
        offer_level_services(graph)
        self._log_ring.offer(graph)
        self._rosout = Rosout(graph, asyncio.get_running_loop())

        sources = Sources(
            traffic=self._listener.traffic,
            refused_connections=self._listener.refused_connections,
            goal_counters=self._moveit.goal_counters,
            queue=self._moveit.queue,
            arm=self._arm,
            planners=self._pool,
            recorder=self._recorder,
            zenoh=self._bridge,
        )
        self._collector = CollectorPolicy(keeps_frozen=inherited is not None)
        self._memory = MemoryKeeper(self._collector, self._nothing_moves)
        self._monitor = Monitor(sources, notifier or SystemdNotifier())
        routes.update(self._monitor.routes)

    async def run(self) -> NewStart | None:
        """Start, serve until a signal, stop; whatever was started is stopped, also when a later part fails.

        A second signal hurries the stop.

        Returns:
            The start that is to follow at once, after a calibration; None for the end.
        """
        ending, hurry = stop_signals()
        on_hangup(self._listener.reload_certificate, ending.set)
        on_debug_signal()
        # The recorder has taken messages since it was made, and is stopped last.
        started = [Part("the recording", stop=self._close_recording, deadline_s=0.8)]
        try:
            if await unless_ended(ending, start_in_order(self._parts(), started)):
                self._tell_start()
                await first_of(ending, self._start_anew)
            log.info("stopping")
        finally:
            self._monitor.notify_stopping(starts_anew=self._start_anew.is_set() and not ending.is_set())
            await stop_in_reverse(started, STOP_TOTAL_S, hurry)
            self._collector.stop()
        log.info("stopped")
        return None if ending.is_set() else self._next

    def _commission(self, procedure: str, name: str) -> Procedure:
        """Make a procedure.

        Raises:
            RobotError: it cannot begin.
        """
        if not isinstance(self._arm, Arm):
            raise OrderRefused("one of several arms is calibrated and verified by a server of its own")
        if busy := self._moveit.queue.busy:
            raise OrderRefused(f"the arm is in use: {busy}")
        if procedure == "calibrate":
            if self._inherits:
                raise OrderRefused("the arms of a classroom have one calibration together, which is not changed here")
            check_state_rate(self._settings.arm.joint_state_rate_hz)
            file, in_use = calibration_file(name, self._description)
            trims_rad = self._settings.arm.zero_offset_rad
            return CalibrationProcedure(
                self._arm, self._description, file, trims_rad, self._moveit.stop, self._use, in_use=in_use
            )
        if procedure == "verify":
            calibration, moveit = self._description.calibration, self._moveit
            joints = () if calibration is None else calibration.joints
            ends = frozenset(joint.joint for joint in joints if joint.servo.zero == "ends")
            return VerificationProcedure(self._arm, self._description.robot, ends, moveit.go_to, moveit.queue.cancel)
        raise OrderRefused(f"there is no procedure {procedure[:80]!r}, but calibrate and verify")

    def _use(self, recalibrated: Recalibrated) -> None:
        """Start anew with a calibration: everything that was made with the old one is made again."""
        settings, listener = self._settings, self._listener
        # At the same place for its clients, and relaxed: nobody has said that the arm may be switched on.
        arm = settings.arm.model_copy(update={"calibration": recalibrated.file, "start_enabled": False})
        place = settings.server.model_copy(update={"port": listener.port, "tcp_port": listener.tcp_port})
        self._next = NewStart(settings.model_copy(update={"arm": arm, "server": place}), recalibrated)
        self._start_anew.set()

    def _parts(self) -> list[Part]:
        """List the parts in the order of their start.

        They stop in reverse: goals and the arm first, which is brought to its end state; then the clients; then what
        nothing needs any more.
        """
        monitor = BackgroundTask("monitor", self._monitor.run)
        diagnostics = BackgroundTask("diagnostics", self._diagnostics.run)
        memory = BackgroundTask("memory", self._memory.run)
        message_types = BackgroundTask("message types", self._graph.message_types.compile_waiting)
        parts = [
            Part("the monitor", monitor.start, monitor.stop),
            # Restored before anybody can see it, and written when nobody can change it any more.
            Part("the planning scene", self._moveit.restore_scene, self._moveit.keep_scene, 0.4),
            # The port before the processes: none of them, and no arm, is needed when it is taken.
            Part("clients", self._listener.bind, self._close_clients, 0.6),
            Part("planners", self._pool.start, self._pool.close, 0.4),
            Part("diagnostics", diagnostics.start, diagnostics.stop),
            # It has its own limits, by its own clock: a simulated arm is slow where the machine is busy.
            Part("the arm", self._arm.launch, self._arm.close, ARM_STOP_S, beyond_total=True),
            *self._way_to_rest_pose(),
            Part("goals", self._start_goals, self._moveit.close, 1.1),
            Part("commissioning", stop=self._commissioning.close),
            # Clients are answered from here on; goals that they send wait for the arm.
            Part("connections", self._listener.open),
            Part("the arm's first state", self._wait_for_arm),
            # Loaded meanwhile; whoever is told that the server is ready need not wait for them.
            Part("the planners' first plans", self._wait_for_planners),
            *self._parts_of_parking(),
            Part("memory", memory.start, memory.stop),
            # Ready without them: whoever comes first waits for a type of his own, at most 20 ms.
            Part("message types", message_types.start, message_types.stop),
            # A start that was refused leaves no file.
            Part("the recording's file", self._open_recording),
        ]
        if self._bridge is not None:
            bridge = BackgroundTask("zenoh", self._bridge.run)
            parts.insert(1, Part("other machines", bridge.start, bridge.stop, 0.4))
        return parts

    def _way_to_rest_pose(self) -> list[Part]:
        if self._parking is None:
            return []
        prepare = self._parking.prepare_exit
        return [Part("the way to the rest pose", stop=prepare, deadline_s=PREPARING_S, beyond_total=True)]

    def _parts_of_parking(self) -> list[Part]:
        if self._parking is None or self._last_client is None:
            return []
        parking = BackgroundTask("parking", self._parking.run)
        last_client = BackgroundTask("the last client", self._last_client.run)
        return [
            Part("parking", parking.start, parking.stop),
            Part("the last client", last_client.start, last_client.stop),
        ]

    async def _start_goals(self) -> None:
        self._moveit.start()

    async def _wait_for_arm(self) -> None:
        # Nothing moves yet that could wait for it.
        self._collector.start()
        try:
            await self._arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError as error:
            raise StartError(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s") from error

    async def _wait_for_planners(self) -> None:
        refusal = await self._pool.wait_until_loaded()
        if refusal is not None:
            raise StartError(f"the planners cannot load the robot: {refusal}")

    async def _close_clients(self) -> None:
        self._control.close()
        if self._arms is not None:
            self._arms.close()
        await self._listener.close()

    async def _open_recording(self) -> None:
        if self._recorder is not None:
            self._recorder.start()

    async def _close_recording(self) -> None:
        """Write the last messages, those of the stop among them."""
        if self._recorder is not None:
            await self._recorder.close()
        await self._fault_files.close()
        self._rosout.close()
        self._log_ring.close()

    def _nothing_moves(self) -> bool:
        return not self._moveit.queue.busy and self._arm.state.mode is not Mode.MOVING

    def _running_of(self, arm: str) -> RunningGoal | None:
        return self._goals_of[arm].running

    def _on_states(self, state: ArmState, read: ArmState) -> None:
        """Take the state of several arms.

        Args:
            state: of all joints, where they are known.
            read: of those that are read at present.
        """
        self._joint_states.publish(read)
        self._take_state(state)

    def _on_arm_state(self, name: str, state: ArmState) -> None:
        """Take the state of one of several arms; a leader's is followed without waiting for those of the others."""
        self._goals_of[name].take_state(state)
        self._moveit.teleoperation.take_leader_state(name, state)

    def _on_state(self, state: ArmState) -> None:
        self._joint_states.publish(state)
        self._take_state(state)

    def _take_state(self, state: ArmState) -> None:
        self._arm_state.take_state(state, self._arm.last_stop)
        self._diagnostics.take_state(state)
        self._history.take_state(state)
        self._fault_files.take_state(state)
        self._moveit.take_state(state)
        self._commissioning.take_state(state)

    def _on_health(self, health: ArmHealth) -> None:
        self._arm_state.take_health(health)
        self._diagnostics.take_health(health)
        self._history.take_health(health)
        self._fault_files.take_health(health)
        self._monitor.take_health(health)
        self._commissioning.take_health(health)

    def _tell_start(self) -> None:
        self._monitor.notify_started()
        log.info("%s", self._what_runs_where())
        if not page_is_built(PAGE_DIRECTORY):
            log.info("%s", HOW_TO_BUILD_PAGE)

    def _what_runs_where(self) -> str:
        if self._arms is not None:
            told = "; ".join(
                _what_arm_runs(arm.arm, arm.files.settings.serial, name, arm.files.description)
                for name, arm in self._arms.arms.items()
            )
        else:
            told = _what_arm_runs(self._arm, self._settings.arm.serial, self._description.robot.name, self._description)
        shown = f"{self._listener.page_url} (page), " if page_is_built(PAGE_DIRECTORY) else ""
        raw_tcp = self._listener.tcp_url
        shown_tcp = f"{raw_tcp} (rosbridge over TCP), " if raw_tcp is not None else ""
        return (
            f"armbridge is ready: {self._listener.url} (rosbridge), {shown_tcp}{shown}{told}, "
            f"planners in processes {', '.join(str(pid) for pid in self._pool.pids) or 'of their own, shared'}"
        )


def _what_arm_runs(arm: ArmInterface, serial: str | None, name: str, description: Description) -> str:
    """Return what to tell at the start about an arm."""
    bus = f"on {serial}" if serial is not None else "simulated"
    if description.calibration is None:
        bus += " (ideal)"
    if arm.state.mode is Mode.DISCONNECTED:
        bus += f", NOT CONNECTED ({arm.state.reason})"
    elif arm.state.mode is not Mode.HOLDING:
        bus += f", {arm.state.mode.name} ({arm.state.fault or arm.state.reason or 'not enabled'})"
    pids = ", ".join(map(str, arm.pids))
    return f"{name} arm {bus} (process {pids}, 100 Hz)"


def open_recorder(settings: RecordingSettings, graph: Graph, robot_name: str) -> Recorder | None:
    """Begin to take messages for the recording, if the settings name a file; `Recorder.start` opens it.

    Args:
        settings: the section ``recording``.
        graph: what is recorded.
        robot_name: for whoever reads the file.

    Raises:
        ConfigurationError: at its path is something else than a file, or its folder cannot be written to.
    """
    if settings.file is None:
        return None
    # Imported when it is needed: most servers record nothing, and start without the library.
    from server.recording.files import check_path
    from server.recording.recorder import Recorder

    check_path(settings.file)
    return Recorder(graph, settings.file, settings.limit_mb, settings.keep_files, {"robot": robot_name})
