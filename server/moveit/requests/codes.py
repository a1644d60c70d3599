"""The planners' answers as moveit_msgs/MoveItErrorCodes."""

from __future__ import annotations

import math
from typing import Any

from planners.problem import Deviation, MoveItErrorCode, PlanningFailure

# A deviation below these is what a servo arm has anyway [m], [rad].
TOLD_POSITION_M = 0.001
TOLD_ORIENTATION_RAD = 0.01

# Who says it; MoveIt puts the name of the pipeline's stage there.
SOURCE = "armbridge"


def error_code(code: MoveItErrorCode, message: str = "", source: str = SOURCE) -> dict[str, Any]:
    """A moveit_msgs/MoveItErrorCodes.

    Args:
        code: the value.
        message: one sentence.
        source: who says it.
    """
    return {"val": int(code), "message": message, "source": source}


def success(*notes: str) -> dict[str, Any]:
    """The code of a success, with what the caller should know all the same."""
    return error_code(MoveItErrorCode.SUCCESS, "; ".join(note for note in notes if note))


def failure_code(failure: PlanningFailure) -> dict[str, Any]:
    """The code of a failure, with its sentence."""
    return error_code(failure.code, failure.message)


def deviation_note(deviation: Deviation) -> str:
    """What of the goal could not be had, as a sentence; empty when all could."""
    said = []
    if deviation.position_m > TOLD_POSITION_M:
        said.append(f"the position is {1000.0 * deviation.position_m:.1f} mm off")
    if deviation.orientation_rad > TOLD_ORIENTATION_RAD:
        said.append(
            f"the orientation is {math.degrees(deviation.orientation_rad):.1f} degrees off, the nearest there is"
        )
    return " and ".join(said)
