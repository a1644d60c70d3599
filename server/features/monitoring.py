"""Monitoring and recording: health, diagnostics, logs, histories, files about faults, and the recording of messages."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING

from robot.messages import ArmHealth, ArmState
from server.datasets.marking import EpisodeServices
from server.features.clients import Clients
from server.features.context import ServerContext
from server.lifecycle import BackgroundTask, Feature
from server.monitoring.fault_files import FaultFiles
from server.monitoring.health import Sources
from server.monitoring.log_ring import LogRing
from server.monitoring.monitor import Monitor
from server.monitoring.ros_topics import Diagnostics, Rosout, offer_level_service
from server.monitoring.servo_history import ServoHistory
from server.monitoring.systemd import SystemdNotifier
from server.moveit.named_states import data_directory

if TYPE_CHECKING:
    from server.recording.recorder import Recorder
    from server.zenoh.bridge import Bridge


class Logs(Feature):
    """The log as a topic, by services, and in files about faults; it stops last, and so has the lines of the stop."""

    name = "the logs"
    deadline_s = 0.4

    def __init__(self, context: ServerContext) -> None:
        graph, diagnostics, robot = context.graph, context.settings.diagnostics, context.planning.robot
        self._ring = LogRing()
        self._ring.offer(graph)
        self._rosout = Rosout(graph, asyncio.get_running_loop())
        offer_level_service(graph)
        directory = diagnostics.directory(data_directory(os.environ))
        self._fault_files = FaultFiles(directory, diagnostics.fault_files, self._ring, robot.name)
        condition = Diagnostics(graph, robot.name, lambda: self._fault_files.latest)
        self._observers = condition, ServoHistory(graph), self._fault_files
        self._publishing = BackgroundTask("diagnostics", condition.run)

    async def start(self) -> None:
        await self._publishing.start()

    async def stop(self) -> None:
        await self._publishing.stop()
        await self._fault_files.close()
        self._rosout.close()
        self._ring.close()

    def on_state(self, arm: str, state: ArmState) -> None:
        if not arm:
            for each in self._observers:
                each.take_state(state)

    def on_health(self, arm: str, health: ArmHealth) -> None:
        if not arm:
            for each in self._observers:
                each.take_health(health)


class Monitoring(BackgroundTask):
    """Health of the server: over HTTP, as metrics, and for systemd."""

    def __init__(
        self,
        context: ServerContext,
        clients: Clients,
        recorder: Recorder | None,
        bridge: Bridge | None,
        notifier: SystemdNotifier | None,
    ) -> None:
        self._sources = Sources(
            traffic=clients.listener.traffic,
            goal_counters=context.goals.counters,
            queue=context.goals.queue,
            arm=context.whole.arm,
            planners=context.planning.pool,
            recorder=recorder,
            zenoh=bridge,
        )
        self.monitor = Monitor(self._sources, notifier or SystemdNotifier())
        super().__init__("the monitor", self.monitor.run)
        clients.routes.update(self.monitor.routes)

    def on_health(self, arm: str, health: ArmHealth) -> None:
        if not arm:
            self._sources.arm_health = health


class Recording(Feature):
    """The recorder, which takes messages from its construction on; None where the settings name no file."""

    name = "the recording"
    deadline_s = 0.8

    def __init__(self, context: ServerContext) -> None:
        graph, settings = context.graph, context.settings.recording
        # A recording has the time of the arm where that is faster than the machine's.
        clock = graph.message_types.wall_clock if context.settings.simulation.rate != 1.0 else None
        self.recorder: Recorder | None = None
        if settings.file is not None:
            # Imported when it is needed: most servers record nothing, and start without the library.
            from server.recording.files import check_path
            from server.recording.recorder import Recorder

            check_path(settings.file)
            self.recorder = Recorder(graph, settings.file, settings, clock)
        self._looking = BackgroundTask("episodes", EpisodeServices(graph, self._records, clock).run)

    async def open_file(self) -> None:
        if self.recorder is not None:
            self.recorder.start()
        await self._looking.start()

    async def stop(self) -> None:
        """Write the last messages, also the messages of the stop."""
        await self._looking.stop()
        if self.recorder is not None:
            await self.recorder.close()

    def _records(self) -> bool:
        return self.recorder is not None and not self.recorder.ended
