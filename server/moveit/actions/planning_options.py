"""moveit_msgs/PlanningOptions: what besides the motion a goal of MoveGroup or MoveGroupSequence asks for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure

Message: TypeAlias = Mapping[str, Any]

# MoveIt's number of attempts when none is given.
DEFAULT_ATTEMPTS = 5

# Bounds, so that no goal goes on for ever.
MAX_ATTEMPTS = 100
MAX_DELAY_S = 10.0


@dataclass(frozen=True)
class Options:
    """What the options ask for.

    Attributes:
        plan_only: whether nothing is to move.
        attempts: how often is planned at most.
        delay_s: pause between attempts [s].
        scene_diff: moveit_msgs/PlanningScene to plan in on top of the present one; None for none.
        warnings: what was left out of account, a sentence each.
    """

    plan_only: bool
    attempts: int
    delay_s: float
    scene_diff: Message | None
    warnings: tuple[str, ...]


def options_of(message: Message) -> Options | PlanningFailure:
    """Read the options."""
    delay_s = float(message["replan_delay"])
    if not (math.isfinite(delay_s) and 0.0 <= delay_s <= MAX_DELAY_S):
        return PlanningFailure(
            MoveItErrorCode.FAILURE,
            f"planning_options.replan_delay must be from 0 to {MAX_DELAY_S:g} s, not {delay_s:g}",
            {"replan_delay": str(delay_s)},
        )
    attempts = message["replan_attempts"] if message["replan_attempts"] > 0 else DEFAULT_ATTEMPTS
    warnings = ("look_around is ignored: there is no sensor to look with",) if message["look_around"] else ()
    diff = message["planning_scene_diff"]
    return Options(
        plan_only=message["plan_only"],
        attempts=min(attempts, MAX_ATTEMPTS) if message["replan"] else 1,
        delay_s=delay_s,
        scene_diff={**diff, "is_diff": True} if changes_something(diff) else None,
        warnings=warnings,
    )


def changes_something(scene: Message) -> bool:
    """Whether a moveit_msgs/PlanningScene says anything of what a plan depends on.

    One that is left out has ``is_diff`` false, and must not be taken for an empty world.
    """
    return bool(
        scene["world"]["collision_objects"]
        or scene["robot_state"]["attached_collision_objects"]
        or scene["allowed_collision_matrix"]["entry_names"]
        or scene["allowed_collision_matrix"]["default_entry_names"]
        or scene["link_padding"]
        or scene["link_scale"]
        or scene["fixed_frame_transforms"]
    )
