"""``/query_planner_interface``, ``/get_planner_params`` and ``/set_planner_params``: which planners there are."""

from __future__ import annotations

from typing import Any

from server.errors import ServiceError
from server.graph.node import Node
from server.moveit.parameters import KNOWN_KEYS
from server.moveit.requests.context import Message
from server.moveit.requests.motion_plan import OMPL, PILZ, PIPELINES, check_pipeline
from server.moveit.services.planning_context import PlanningContext

# As MoveIt's planning plugins call themselves.
INTERFACE_NAMES = {OMPL: "OMPL", PILZ: "Pilz Industrial Motion Planner"}


def query_planner_interface(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """The planners by name; the response of moveit_msgs/QueryPlannerInterfaces."""
    interfaces = [
        {"name": INTERFACE_NAMES[pipeline], "pipeline_id": pipeline, "planner_ids": list(planners)}
        for pipeline, planners in PIPELINES.items()
    ]
    return {"planner_interfaces": interfaces}


def get_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """Parameters of a planner; the response of moveit_msgs/GetPlannerParams.

    Raises:
        RefusedError: there is no such pipeline or group.
    """
    _check(context, request)
    texts = context.parameters.texts(request["group"], request["planner_config"])
    descriptions = ["" if key in KNOWN_KEYS else "kept, changes nothing" for key in texts]
    return {"params": {"keys": list(texts), "values": list(texts.values()), "descriptions": descriptions}}


def set_planner_params(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """Set parameters of a planner; the response of moveit_msgs/SetPlannerParams, which is empty.

    Raises:
        RefusedError: there is no such pipeline or group.
        ServiceError: a value that cannot be.
    """
    _check(context, request)
    keys, values = request["params"]["keys"], request["params"]["values"]
    if len(keys) != len(values):
        raise ServiceError(f"params.keys has {len(keys)} entries and params.values {len(values)}")
    replace = request["replace"]
    context.parameters.set(
        request["group"], request["planner_config"], dict(zip(keys, values, strict=True)), replace=replace
    )
    return {}


def _check(context: PlanningContext, request: Message) -> None:
    check_pipeline(request["pipeline_id"])
    if request["group"]:
        context.group(request["group"])
