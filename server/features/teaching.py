"""Motions that people teach, and their replay."""

from __future__ import annotations

import os

from robot.messages import ArmState
from server.features.context import ServerContext
from server.lifecycle import Feature
from server.moveit.named_states import default_path
from server.teaching.motion_files import MotionFiles
from server.teaching.replay import ReplayAction
from server.teaching.services import Teaching


class TaughtMotions(Feature):
    """Recording of motions, and the action that replays them."""

    name = "teaching"

    def __init__(self, context: ServerContext) -> None:
        planning, graph, robot = context.planning, context.graph, context.planning.robot
        # In a folder beside the named states.
        self.motions = MotionFiles(default_path("motions", robot, os.environ).with_suffix(""), robot)
        self._teaching = Teaching(graph, robot, self.motions, planning.pool, planning.scene_state, planning.current)
        ReplayAction(graph, robot, self.motions, context.goals.queue, planning.problems)

    async def stop(self) -> None:
        await self._teaching.close()

    def on_state(self, arm: str, state: ArmState) -> None:
        if not arm:
            self._teaching.take_state(state)

    @property
    def observes_states(self) -> bool:
        return self._teaching.recording
