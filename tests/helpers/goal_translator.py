"""A reader of goal messages for the built-in arm, in an empty scene, with one state saved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robot.description import model
from server.moveit.goal_messages import GoalTranslator
from server.moveit.named_states import NamedStates, Positions
from server.moveit.parameters import MoveItParameters, PlannerParameters
from server.moveit.requests.planning_problems import ProblemBuilder
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState

ROBOT = model.builtin()
HOME_RAD: Mapping[str, float] = {joint.name: 0.0 for joint in ROBOT.movable_joints}


async def keep_nothing(_states: Mapping[str, Positions]) -> None:
    """States live as long as the test."""


@dataclass
class At:
    """An arm that is somewhere, as `server.execution.current_state.CurrentState`."""

    present_rad: Mapping[str, float] | None

    def positions_rad(self) -> Mapping[str, float] | None:
        return self.present_rad


def translator(present_rad: Mapping[str, float] | None = HOME_RAD, **parameters: Any) -> GoalTranslator:
    """Reads goals of an arm that is somewhere."""
    states = NamedStates(ROBOT, "arm", {"Mine": {"elbow_flex": 0.4, "gripper": 1.0}}, keep_nothing)
    frames = Frames(ROBOT, SceneState(ROBOT))
    configured = MoveItParameters(**parameters)
    problems = ProblemBuilder(ROBOT, frames, PlannerParameters(configured))
    return GoalTranslator(ROBOT, configured, states, frames, At(present_rad), problems)


TRANSLATOR = translator()
