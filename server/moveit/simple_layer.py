"""The simple layer as a whole: goals by topic, named states, checks of goals, confirm mode."""

from __future__ import annotations

import os
from collections.abc import Callable

from planners.pool import PlannerPool
from robot.description.model import RobotModel
from server.config import Settings
from server.goal_queue import Answer, GoalQueue, Progress, QueuedGoal
from server.graph.topics import Graph
from server.moveit.confirmation import Confirmation
from server.moveit.current_state import CurrentState
from server.moveit.goal_checks import GoalChecks, ShownScene
from server.moveit.goal_reports import GoalReports
from server.moveit.goal_topics import GoalTopics
from server.moveit.goals import GoalTranslator, Resolve
from server.moveit.motions import Motion
from server.moveit.named_states import NamedStates
from server.moveit.named_states_file import NamedStatesFile, default_path
from server.moveit.named_states_services import NamedStatesServices


class SimpleLayer:
    """What a client needs that knows no MoveIt.

    Args:
        graph: where topics and services are.
        robot: the arm.
        settings: everything that can be chosen.

    Attributes:
        confirmation: the gate between plan and motion.
    """

    def __init__(self, graph: Graph, robot: RobotModel, settings: Settings) -> None:
        self._graph = graph
        self._robot = robot
        self._parameters = settings.moveit
        file = NamedStatesFile(settings.goals.named_states_file or default_path(robot, os.environ))
        self._states = NamedStates(robot, settings.moveit.group_name, file.load(), file.save)
        goals = settings.goals
        self.confirmation = Confirmation(graph, wanted=goals.confirm, timeout_s=goals.confirm_timeout_s)
        self._topics = GoalTopics(graph, robot, self.confirmation)

    def open(
        self, queue: GoalQueue[Motion], pool: PlannerPool, current: CurrentState, resolve: Resolve, scene: ShownScene
    ) -> None:
        """Begin to take requests.

        Args:
            queue: where goals go.
            pool: checks goals.
            current: where the arm is.
            resolve: knows the frames.
            scene: what is in the way.
        """
        present = current.positions_rad
        translator = GoalTranslator(self._robot, self._parameters, self._states, resolve, present)
        self.confirmation.open()
        self._topics.open(queue, translator)
        NamedStatesServices(self._graph, self._robot, self._states).open(current)
        reports = GoalReports(self._robot, self._parameters, translator.tip)
        GoalChecks(self._graph, reports).open(translator, present, pool, scene)

    @property
    def on_progress(self) -> Callable[[QueuedGoal[Motion], Progress], None]:
        """Takes the news of goals."""
        return self._topics.on_progress

    @property
    def on_answer(self) -> Callable[[QueuedGoal[Motion], Answer], None]:
        """Takes the ends of goals."""
        return self._topics.on_answer
