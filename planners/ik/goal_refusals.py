"""Refusals of goals that have no solution, with the figures that were found."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planners.checks import check_start_contact, contact_failure
from planners.geometry.collision import CollidingPair
from planners.goals import AxisGoal, ConstraintGoal, PoseGoal, PositionGoal
from planners.ik.constraints import Violation
from planners.ik.goal_checks import in_words
from planners.problem import Deviation, MoveItErrorCode, PlanningFailure

TaskGoal = PositionGoal | AxisGoal | PoseGoal | ConstraintGoal


def goal_in_collision(pairs: Sequence[CollidingPair]) -> PlanningFailure:
    """Return the failure of a goal that holds in contact only."""
    return contact_failure(MoveItErrorCode.GOAL_IN_COLLISION, "in the goal these would touch", pairs)


def goal_violates(violations: Sequence[Violation]) -> PlanningFailure:
    """Return the failure of a goal that violates the constraints."""
    return _violated(MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS, "the goal violates the constraints", violations)


def check_start_place(pairs: Sequence[CollidingPair], violations: Sequence[Violation]) -> PlanningFailure | None:
    """Check for contact at the start, of which there may be shallow ones, and for violated path constraints."""
    refusal = check_start_contact(pairs)
    if refusal is not None or not violations:
        return refusal
    return _violated(
        MoveItErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, "the start violates the path constraints", violations
    )


def none_of(failures: Sequence[PlanningFailure]) -> PlanningFailure:
    """Return the failure of several alternatives: the message of the first, and all of them in the details."""
    first = failures[0]
    others = [{"code": int(failure.code), "message": failure.message} for failure in failures]
    message = f"no alternative of {len(failures)} can be reached; the first: {first.message}"
    return PlanningFailure(first.code, message, {**first.details, "alternatives": others})


def out_of_reach(
    goal: TaskGoal, nearest_m: Sequence[float], nearest: Deviation, violations: Sequence[Violation]
) -> PlanningFailure:
    """Return the failure of a goal that no configuration meets.

    ``nearest_m`` is the position of the link in the configuration that comes nearest, shape (3,) [m]; ``nearest`` is
    the deviation there, and ``violations`` are the conditions that do not hold there.
    """
    if isinstance(goal, ConstraintGoal):
        return _violated(
            MoveItErrorCode.NO_IK_SOLUTION,
            "no configuration meets all constraints; in the nearest one",
            violations,
        )
    point = [round(float(value), 4) for value in nearest_m]
    details = {"nearest_m": point, "distance_m": nearest.position_m, "orientation_rad": nearest.orientation_rad}
    degrees = math.degrees(nearest.orientation_rad)
    if isinstance(goal, PositionGoal) or nearest.position_m > goal.tolerance_m:
        any_will_do = isinstance(goal, PositionGoal) or (isinstance(goal, PoseGoal) and not goal.strict)
        orientation = "whatever its orientation" if any_will_do else "in the orientation asked for"
        sentence = f"cannot reach {in_words(goal.position_m)} m, {orientation}: the nearest point it can reach is"
        sentence += f" {in_words(point)} m, {100.0 * nearest.position_m:.1f} cm away"
    else:
        sentence = f"reaches {in_words(goal.position_m)} m, but not in the orientation asked for:"
        sentence += f" the nearest one there is {degrees:.1f}° off"
    return PlanningFailure(
        MoveItErrorCode.NO_IK_SOLUTION, f"{goal.link!r} {sentence}", {**details, "tolerance_m": goal.tolerance_m}
    )


def out_of_time(
    goal: TaskGoal, failure: PlanningFailure, nearest_m: Sequence[float], nearest: Deviation
) -> PlanningFailure:
    """Add the nearest point so far to the failure of a search that was ended; arguments as :func:`out_of_reach`."""
    if isinstance(goal, ConstraintGoal):
        return failure
    point = [round(float(value), 4) for value in nearest_m]
    message = (
        f"{failure.message}; the nearest point so far is {in_words(point)} m, {100.0 * nearest.position_m:.1f} cm away"
    )
    return PlanningFailure(
        failure.code, message, {**failure.details, "nearest_m": point, "distance_m": nearest.position_m}
    )


def _violated(code: MoveItErrorCode, what: str, violations: Sequence[Violation]) -> PlanningFailure:
    sentences = "; ".join(violation.sentence for violation in violations)
    return PlanningFailure(code, f"{what}: {sentences}", {"violations": [dict(v.details) for v in violations]})
