"""The topics by which the scene is changed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from planners.problem import PlanningFailure
from protocol.errors import MessageError
from protocol.publication import Publication
from server.execution.current_state import CurrentState
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.scene.state import Positions, SceneState

log = logging.getLogger("armbridge.scene")

Apply = Callable[[Mapping[str, Any], Positions], PlanningFailure | None]


class SceneTopics:
    """Takes changes of the scene from topics; what is refused is told to the log.

    A topic does not say who speaks, so joints in a ``/planning_scene`` are passed over.

    Args:
        graph: where the topics are.
        node: who listens.
        state: the scene.
    """

    def __init__(self, graph: Graph, node: Node, state: SceneState) -> None:
        self._graph = graph
        self._node = node
        self._applied: Mapping[str, tuple[str, Apply]] = {
            "/planning_scene": ("moveit_msgs/PlanningScene", state.apply_diff),
            "/planning_scene_world": ("moveit_msgs/PlanningSceneWorld", state.apply_world),
            "/collision_object": ("moveit_msgs/CollisionObject", state.apply_object),
            "/attached_collision_object": ("moveit_msgs/AttachedCollisionObject", state.apply_held_object),
        }

    def open(self, current: CurrentState) -> None:
        """Subscribe.

        Args:
            current: where the joints are.
        """
        for topic, (type_name, apply) in self._applied.items():
            self._graph.subscribe(self._node, topic, type_name, _subscriber(topic, apply, current))


def _subscriber(topic: str, apply: Apply, current: CurrentState) -> Subscriber:
    def deliver(publication: Publication) -> None:
        failure = apply(publication.msg, current.positions_rad())
        if failure is not None:
            log.warning("%s: refused, nothing is changed: %s", topic, failure.message)

    def refused(error: MessageError) -> None:
        log.warning("%s: refused, nothing is changed: %s", topic, error)

    return Subscriber(deliver, refused)
