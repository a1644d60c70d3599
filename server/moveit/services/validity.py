"""``/check_state_validity``: is a state within limits, free, and do constraints hold there?"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import Any

from planners.goals import Constraints
from planners.problem import MoveItErrorCode, StateAnswer, StateQuestion
from planners.scene import Scene
from robot.description.model import RobotModel
from server.graph.node import Node
from server.moveit.requests.constraints import path_constraints_of
from server.moveit.requests.context import Message
from server.moveit.requests.refusals import required
from server.moveit.services.planning_context import PlanningContext

log = logging.getLogger("armbridge.moveit")

# moveit_msgs/ContactInformation's body types.
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = 0, 1, 2


async def check_state_validity(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:
    """Tell all that is wrong with a state; the response of moveit_msgs/GetStateValidity.

    Raises:
        RefusedError: a state, group or constraint that cannot be asked about.
    """
    group = context.group(request["group_name"])
    positions_rad = context.positions_rad(request["robot_state"], caller)
    scene = context.scene_of(request["robot_state"], positions_rad)
    reading = context.request_context(group, positions_rad)
    constraints = required(path_constraints_of(request["constraints"], reading, "constraints"))
    state = required(await context.pool.ask(StateQuestion(group.name, positions_rad), scene))
    results = [
        _result(required(await context.pool.ask(StateQuestion(group.name, positions_rad, one), scene)))
        for one in _singly(constraints)
    ]
    for problem in state.problems:
        log.info("/check_state_validity: %s", problem.message)
    pairs = [pair for problem in state.problems for pair in problem.details.get("pairs", ())]
    context.display.contacts(pairs)
    return {
        "valid": state.valid and all(result["result"] for result in results),
        "contacts": [_contact(pair, context.robot, scene) for pair in pairs],
        "constraint_result": results,
    }


def _singly(constraints: Constraints) -> Iterator[Constraints]:
    """Each constraint alone, in MoveIt's order of results."""
    yield from (Constraints(joints=(one,)) for one in constraints.joints)
    yield from (Constraints(positions=(one,)) for one in constraints.positions)
    yield from (Constraints(orientations=(one,)) for one in constraints.orientations)


def _result(answer: StateAnswer) -> dict[str, Any]:
    """The moveit_msgs/ConstraintEvalResult: how far beyond its tolerance a constraint is, 0 where it holds."""
    for problem in answer.problems:
        if problem.code is MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED:
            log.info("/check_state_validity: %s", problem.message)
            return {"result": False, "distance": _distance(problem.details)}
    return {"result": True, "distance": 0.0}


def _distance(details: Mapping[str, Any]) -> float:
    """By how much a constraint does not hold [m], [rad]."""
    if "beyond_m" in details or "beyond_rad" in details:
        return float(details.get("beyond_m", 0.0) or details.get("beyond_rad", 0.0))
    position = details["position_rad"]
    return float(max(details["lower_rad"] - position, position - details["upper_rad"], 0.0))


def _contact(pair: Mapping[str, Any], robot: RobotModel, scene: Scene) -> dict[str, Any]:
    held = {attached.object.name for attached in scene.attached}

    def body_type(name: str) -> int:
        if name in robot.links:
            return ROBOT_LINK
        return ROBOT_ATTACHED if name in held else WORLD_OBJECT

    return {
        "header": {"frame_id": robot.root_link},
        "position": dict(zip("xyz", pair["point_m"], strict=True)),
        "normal": dict(zip("xyz", pair["normal"], strict=True)),
        "depth": pair["depth_m"],
        "contact_body_1": pair["first"],
        "body_type_1": body_type(pair["first"]),
        "contact_body_2": pair["second"],
        "body_type_2": body_type(pair["second"]),
    }
