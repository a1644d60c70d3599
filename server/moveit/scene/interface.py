"""Everything by which clients see and change the planning scene."""

from __future__ import annotations

from robot.description.model import RobotModel
from server.execution.current_state import CurrentState
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.assumed import AssumedStates
from server.moveit.scene.geometry_files import GeometryFiles
from server.moveit.scene.monitored import MonitoredScene
from server.moveit.scene.services import SceneServices
from server.moveit.scene.state import SceneState
from server.moveit.scene.topics import SceneTopics


class SceneInterface:
    """The scene's topics and services.

    Args:
        graph: where they are.
        robot: the arm.
        state: the scene.
        assumed: where clients take the joints to be.
        parameters: how often changes are told, and where files of geometry are.
    """

    def __init__(
        self,
        graph: Graph,
        robot: RobotModel,
        state: SceneState,
        assumed: AssumedStates,
        parameters: MoveItParameters,
    ) -> None:
        node = Node("planning_scene")
        self._monitored = MonitoredScene(graph, node, robot, state, parameters.publish_planning_scene_hz)
        self._parts = (
            SceneTopics(graph, node, state),
            SceneServices(graph, node, robot, state, assumed),
            GeometryFiles(graph, node, state, parameters.geometry_directory),
            self._monitored,
        )

    def open(self, current: CurrentState) -> None:
        """Begin to listen, answer and tell.

        Args:
            current: where the joints are.
        """
        for part in self._parts:
            part.open(current)

    def close(self) -> None:
        """Tell no more."""
        self._monitored.close()
