"""Composition root: makes every part of the server, starts them in order, and stops them in reverse."""

import asyncio
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import uvloop

from planners.interface import Planners
from planners.pool import PlannerPool
from planners.shared_pool import SharedPlanners
from robot.arm import CLOSE_LIMIT_S
from robot.arm_group import moves, states_of
from robot.messages import Mode
from robot.processes import StartedChild
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Access
from server.arm.arms import Arms, ServedArm, read_arms
from server.arm.calibrating import Recalibrated
from server.arm.setup import Description, check_parameters
from server.arrival import arrival_epoch, arrived_in
from server.config import Settings, SimulationSettings
from server.errors import StartError
from server.execution.monitors import ARM_START_TIMEOUT_S
from server.features.arms import (
    ArmControl,
    CommissioningOfArms,
    PolicyChunks,
    SimulatedTime,
    resumed,
    teaching_of,
    teleoperation_of,
    with_calibration,
)
from server.features.clients import Clients
from server.features.context import context_of
from server.features.monitoring import Logs, Monitoring, Recording
from server.features.moveit import ArmGoals, MoveGroup, PlanningScene, Servo
from server.features.parking import Parkings
from server.features.physics import physics_of
from server.features.suspension import Suspension
from server.gateway.http import HOW_TO_BUILD_PAGE, page_is_built
from server.graph.topics import Graph
from server.installation import PAGE_DIRECTORY
from server.interfaces import load_registry
from server.lifecycle import (
    BackgroundTask,
    DiskThreads,
    Feature,
    Part,
    on_hangup,
    start_in_order,
    stop_in_reverse,
    stop_signals,
    unless_ended,
)
from server.monitoring.memory import SWITCH_INTERVAL_S, CollectorPolicy, MemoryKeeper
from server.monitoring.systemd import SystemdNotifier
from server.zenoh.settings import check_installed

if TYPE_CHECKING:
    from server.zenoh.bridge import Bridge

log = logging.getLogger("armbridge")

# Longest stop of all parts together, without the arm's end [s].
STOP_TOTAL_S = 2.6

# Far more than there are places of files: a disk that never answers holds one thread for each place at most.
DISK_THREADS = 32

# More than the arm's handle gives its process [s].
ARM_STOP_S = CLOSE_LIMIT_S + 10.0


@dataclass(frozen=True)
class Inherited:
    """Parts that the process which has forked this server has made for several servers."""

    description: Description
    planners: Path


def serve(settings: Settings, arm_process: StartedChild | None = None, inherited: Inherited | None = None) -> None:
    """Run the server until SIGINT or SIGTERM; raises ConfigurationError or StartError."""
    # Read once: systemd's variables are gone from the environment then, and a new start goes on notifying.
    notifier = SystemdNotifier.from_environment()

    async def run(settings: Settings) -> None:
        asyncio.get_running_loop().set_default_executor(DiskThreads(DISK_THREADS))
        app = App(settings, arm_process, inherited, notifier=notifier)
        while (following := await app.run()) is not None:
            settings, recalibrated = following
            app = App(settings, inherited=inherited, recalibrated=recalibrated, notifier=notifier)

    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        uvloop.run(run(settings))
    finally:
        notifier.close()


class App:
    """The server: its context, and the list of its features; made in the event loop in which it runs."""

    def __init__(
        self,
        settings: Settings,
        arm_process: StartedChild | None = None,
        inherited: Inherited | None = None,
        recalibrated: Recalibrated | None = None,
        notifier: SystemdNotifier | None = None,
    ) -> None:
        files = read_arms(settings, None if inherited is None else inherited.description)
        if recalibrated is not None:
            files = resumed(files, recalibrated)
        # An arm whose clock is faster than the machine's gives the time of all stamps.
        simulated = settings.simulation.rate != 1.0
        self.graph = Graph(
            load_registry(settings.server.interfaces),
            wall_clock=(lambda: self._arms.whole.arm.state.stamp_s) if simulated else time.time,
            relay_unknown_types=settings.server.relay_unknown_types,
            unregister_timeout_s=settings.server.unregister_timeout_s,
        )
        self._arms = Arms(files, self.graph, arm_process)
        robot = self._arms.whole.robot
        check_parameters(settings.moveit, robot)
        self._pool: Planners = (
            PlannerPool(robot, settings.planning.workers, settings.planning.memory_limit_bytes)
            if inherited is None
            else SharedPlanners(inherited.planners)
        )
        context = self._context = context_of(settings, self.graph, (self._arms.whole, self._arms.each), self._pool)
        self._restart = asyncio.Event()
        self._recalibrated: Recalibrated | None = None

        # Parts that refuse wrong settings come first; they do nothing before their start.
        self._clients = Clients(context)
        self.bridge = _bridge_of(settings, self.graph, context.access)
        # Ahead of the features that latch messages; its file is opened when nothing can refuse the start any more.
        self._recording = Recording(context)
        self._monitoring = Monitoring(context, self._clients, self._recording.recorder, self.bridge, notifier)
        self._collector = CollectorPolicy(keeps_frozen=inherited is not None)
        shared = inherited is not None
        commissioning = CommissioningOfArms(context, self._start_again, recalibrated, shared_calibration=shared)
        parkings = Parkings(context)
        self._simulated_time = [SimulatedTime(context)] if simulated else []
        self._physics = physics_of(context)
        self._cameras: list[Feature] = []
        if self._physics:
            # Imported when it is needed: most servers render nothing.
            from server.features.cameras import cameras_of

            self._cameras = cameras_of(context, self._physics)
        motions = MoveGroup(context), ArmGoals(context), teaching_of(context), context.goals
        goals = *motions, Servo(context), teleoperation_of(context), PolicyChunks(context)
        self.features = self._in_order_of_start(commissioning, parkings, goals)
        self._arms.connect([each for each in self.features if isinstance(each, Feature)])

    def _in_order_of_start(
        self, commissioning: CommissioningOfArms, parkings: Parkings, goals: Sequence[Feature]
    ) -> tuple[Feature | Part, ...]:
        """Return all features and parts in the order of their start.

        They stop in reverse: goals and the arm first, which is brought to its end state; then the clients; then what
        nothing needs any more.
        """
        arm, queue = self._arms.whole.arm, self._context.goals.queue
        zenoh = None if self.bridge is None else BackgroundTask("zenoh", self.bridge.run)
        return (
            # The recorder has taken messages since it was made, and is stopped last.
            self._recording,
            Logs(self._context),
            self._monitoring,
            *([] if zenoh is None else [Part("other machines", stop=zenoh.stop, deadline_s=0.4)]),
            # Restored before anybody can see it, and written when nobody can change it any more.
            PlanningScene(self._context),
            *self._simulated_time,
            *self._physics,
            ArmControl(self._context),
            Suspension(self._context),
            # The port before the processes: when the port is taken, no process and no arm is needed.
            self._clients,
            Part("planners", self._pool.start, self._pool.close, 0.4),
            # It has its own limits, by its own clock: a simulated arm is slow where the machine is busy.
            Part("the arm", arm.launch, lambda: arm.close(arrival_epoch()), ARM_STOP_S, beyond_total=True),
            parkings,
            *goals,
            commissioning,
            # Not before the goals: what other machines may command or stop is known by the rules of its names.
            *([] if zenoh is None else [Part("zenoh", start=zenoh.start)]),
            # Clients are answered from here on; goals that they send wait for the arm.
            Part("connections", self._clients.listener.open),
            Part("the arm's first state", self._wait_for_arm),
            # Loaded meanwhile: a client of a ready server need not wait for them.
            Part("the planners' first plans", self._wait_for_planners),
            *parkings.last_clients,
            *self._cameras,
            BackgroundTask("memory", MemoryKeeper(self._collector, lambda: not (queue.busy() or moves(arm))).run),
            # A start that was refused leaves no file.
            Part("the recording's file", self._recording.open_file),
        )

    async def run(self) -> tuple[Settings, Recalibrated] | None:
        """Serve until a signal, and stop what was started; a second signal hurries the stop.

        Returns the settings of the start that is to follow at once, after a calibration; None for the end.
        """
        ending, hurry = stop_signals()
        listener = self._clients.listener
        on_hangup(listener.reload_certificate, ending.set)
        started: list[Part | Feature] = []
        try:
            if await unless_ended(ending, start_in_order(self.features, started)):
                self._monitoring.monitor.notify_started()
                log.info("%s", self._ready_sentence())
                if not page_is_built(PAGE_DIRECTORY):
                    log.info("%s", HOW_TO_BUILD_PAGE)
                await unless_ended(ending, self._restart.wait())
            log.info("stopping")
        finally:
            restarts = self._restart.is_set() and not ending.is_set()
            self._monitoring.monitor.notify_stopping(restarts=restarts)
            with arrived_in(STOP_EPOCHS.present):
                await stop_in_reverse(started, STOP_TOTAL_S, hurry)
            self._collector.stop()
        log.info("stopped")
        if ending.is_set() or self._recalibrated is None:
            return None
        # At the same place for its clients.
        settings = with_calibration(self._context.settings, self._recalibrated)
        place = settings.server.model_copy(update={"port": listener.port, "tcp_port": listener.tcp_port})
        left = replace(self._recalibrated, left=states_of(self._arms.whole.arm))
        return settings.model_copy(update={"server": place}), left

    def _start_again(self, recalibrated: Recalibrated) -> None:
        """Have the server start again with a calibration: everything made with the old one is made again."""
        self._recalibrated = recalibrated
        self._restart.set()

    async def _wait_for_arm(self) -> None:
        # Nothing moves yet that could wait for it.
        self._collector.start()
        try:
            await self._arms.whole.arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError as error:
            raise StartError(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s") from error

    async def _wait_for_planners(self) -> None:
        refusal = await self._pool.wait_until_loaded()
        if refusal is not None:
            raise StartError(f"the planners cannot load the robot: {refusal}")

    def _ready_sentence(self) -> str:
        simulation = self._context.settings.simulation
        arms = "; ".join(_arm_sentence(each, simulation) for each in self._arms.each)
        listener = self._clients.listener
        page = f"{listener.page_url} (page), " if page_is_built(PAGE_DIRECTORY) else ""
        raw_tcp = f"{listener.tcp_url} (rosbridge over TCP), " if listener.tcp_url is not None else ""
        return (
            f"armbridge is ready: {listener.url} (rosbridge), {raw_tcp}{page}{arms}, "
            f"planners in processes {', '.join(str(pid) for pid in self._pool.pids) or 'of their own, shared'}"
        )


def _bridge_of(settings: Settings, graph: Graph, access: Access) -> "Bridge | None":
    """Return the bridge that the settings ask for; None if zenoh is off."""
    if settings.zenoh.mode == "off":
        return None
    check_installed(settings.zenoh)
    # Imported when it is needed: zenoh is an extra, and few servers use it.
    from server.zenoh.bridge import Bridge

    return Bridge(graph, settings.zenoh, access, settings.server.limits.max_message_bytes)


def _arm_sentence(served: ServedArm, simulation: SimulationSettings) -> str:
    arm, settings, description = served.arm, served.settings, served.description
    bus = f"on {settings.serial}" if settings.serial is not None else "simulated"
    kinds = ["ideal"] if description.calibration is None else []
    if simulation.kind == "physics":
        kinds += ["physics", *([] if simulation.world is None else [f"world {simulation.world}"])]
    if kinds and settings.serial is None:
        bus += f" ({', '.join(kinds)})"
    if arm.state.mode is Mode.DISCONNECTED:
        bus += f", NOT CONNECTED ({arm.state.reason})"
    elif arm.state.mode is not Mode.HOLDING:
        bus += f", {arm.state.mode.name} ({arm.state.fault or arm.state.reason or 'not enabled'})"
    pids = ", ".join(map(str, arm.pids))
    return f"{served.name or description.robot.name} arm {bus} (process {pids}, 100 Hz)"
