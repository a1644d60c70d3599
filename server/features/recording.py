"""The recording of all messages, and the marks of its episodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from server.config import RecordingSettings
from server.datasets.marking import EpisodeServices
from server.features.context import ServerContext
from server.graph.topics import Graph
from server.lifecycle import Feature

if TYPE_CHECKING:
    from server.recording.recorder import Recorder


class Recording(Feature):
    """The recorder, where the settings name a file.

    Attributes:
        recorder: takes messages from its construction on; None to record nothing.
    """

    name = "the recording"
    deadline_s = 0.8

    def __init__(self, context: ServerContext) -> None:
        self.recorder = open_recorder(context.settings.recording, context.graph, context.planning.robot.name)
        EpisodeServices(context.graph, self._records)

    async def open_file(self) -> None:
        """Open the file."""
        if self.recorder is not None:
            self.recorder.start()

    async def stop(self) -> None:
        """Write the last messages, also the messages of the stop."""
        if self.recorder is not None:
            await self.recorder.close()

    def _records(self) -> bool:
        return self.recorder is not None and not self.recorder.ended


def open_recorder(settings: RecordingSettings, graph: Graph, robot_name: str) -> Recorder | None:
    """Begin to take messages for the recording, if the settings name a file; `Recorder.start` opens it."""
    if settings.file is None:
        return None
    # Imported when it is needed: most servers record nothing, and start without the library.
    from server.recording.files import check_path
    from server.recording.recorder import Recorder

    check_path(settings.file)
    return Recorder(graph, settings.file, settings.limit_mb, settings.keep_files, {"robot": robot_name})
