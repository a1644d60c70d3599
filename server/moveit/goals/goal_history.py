"""The last goals of all clients: their answers, what was asked, the planned motions, and problem files of them."""

import asyncio
import json
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from planners.files import problem_file
from planners.problem import PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE, Scene
from server.errors import ServiceError
from server.execution.goal import Answer, Goal
from server.execution.motions import Performed
from server.execution.queue import GoalListener
from server.graph.permissions import LOOKING
from server.graph.providers import CompleteResponse
from server.graph.services import Answered
from server.graph.topics import Graph
from server.moveit.goals.goal_topics import final_status
from server.moveit.messages import Message
from server.moveit.requests.planning_context import PlanningContext
from server.moveit.trajectories import to_messages

MAX_GOALS = 100

# Scenes of 10 000 objects take megabytes; goals in older ones keep the rest of their record.
MAX_SCENES = 10

# A goal's message with a whole scene or trajectory is longer; people read the beginning.
MAX_ASKED_CHARACTERS = 20_000


@dataclass(frozen=True)
class GoalRecord:
    """Record of an answered goal."""

    stamp_s: float
    status: Message
    asked: Mapping[str, Any]
    performed: Performed  # without the scene
    failure: PlanningFailure
    scene: Scene | None  # in which it was planned; None once it is forgotten


class GoalHistory(GoalListener):
    """Records of the last goals, and the services that tell them; contacts for which goals failed are displayed."""

    def __init__(self, graph: Graph, planning: PlanningContext, wall_clock: Callable[[], float]) -> None:
        self._robot = planning.robot
        self._planning = planning
        self._wall_clock = wall_clock
        self._records: OrderedDict[str, GoalRecord] = OrderedDict()
        node = graph.node("goal history")
        node.offer("/armbridge/goal_history", "armbridge_msgs/srv/GetGoalHistory", self._history, rule=LOOKING)
        node.offer("/armbridge/goal_record", "armbridge_msgs/srv/GetGoalRecord", self._record, rule=LOOKING)

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        """Keep the record of a goal, unless its answer is for one client alone, or no news of a stream."""
        self._planning.display.contacts_of(answer.details)
        if goal.request.only_for is not None or goal.unlogged:
            return
        performed = answer.performed
        self._records[goal.goal_id] = GoalRecord(
            self._wall_clock(),
            final_status(goal, answer, self._robot),
            goal.request.message,
            replace(performed, scene=EMPTY_SCENE),
            PlanningFailure(answer.code, answer.message),
            performed.scene,
        )
        while len(self._records) > MAX_GOALS:
            self._records.popitem(last=False)
        # The scenes of the newest goals alone are kept.
        newest: set[int] = set()
        for kept_id, kept in reversed(self._records.items()):
            if kept.scene is None:
                continue
            newest.add(id(kept.scene))
            if len(newest) > MAX_SCENES:
                newest.discard(id(kept.scene))
                self._records[kept_id] = replace(kept, scene=None)

    def _history(self, _request: dict[str, Any]) -> dict[str, Any]:
        records = self._records.values()
        return {"stamps": [each.stamp_s for each in records], "goals": [each.status for each in records]}

    async def _record(self, request: dict[str, Any]) -> Answered:
        goal_id = request["goal_id"]
        record = self._records.get(goal_id)
        if record is None:
            raise ServiceError(f"goal_id: {goal_id[:40]!r} is not among the last {MAX_GOALS} goals that were answered")
        text, performed = json.dumps(record.asked, default=str)[:MAX_ASKED_CHARACTERS], record.performed
        return CompleteResponse(
            {
                "success": True,
                "message": "",
                "asked": text,
                "planned": await to_messages(performed.planned, self._robot.root_link),
                "duration_s": performed.duration_s,
                "summary": performed.summary if performed.planned else "",
                "planning_time_s": performed.planning_time_s,
                "problem_name": "",
                "problem": "",
                **await self._file(goal_id, record),
            }
        )

    async def _file(self, goal_id: str, record: GoalRecord) -> dict[str, str]:
        problem = record.performed.problem
        if not isinstance(problem, PlanningProblem):
            reason = "no problem file: the goal was refused before planning, follows a path, or brought its own motion"
            return {"message": reason}
        if record.scene is None:
            return {"message": f"no problem file: the scene has changed more than {MAX_SCENES} times since"}
        name = f"goal-{goal_id}-{record.failure.code.name}"
        # A scene of 10 000 objects takes tens of milliseconds.
        text = await asyncio.to_thread(problem_file.text, name, problem, record.scene, self._robot, record.failure)
        return {"problem_name": f"{name}.json", "problem": text}
