"""moveit_msgs/MotionSequenceRequest: motions one after the other, each from where the one before ends."""

from __future__ import annotations

from planners.problem import MoveItErrorCode
from server.moveit.requests.context import Message
from server.moveit.requests.refusals import refusals_as_data, refused

# Each item is planned on its own, in milliseconds mostly, in seconds at worst.
MAX_ITEMS = 50


@refusals_as_data
def requests_of(sequence: Message) -> list[Message]:
    """The moveit_msgs/MotionPlanRequest of a sequence's items, in their order.

    The arm comes to rest after each, so a blend radius is refused. Only the first item may say where it starts.

    Args:
        sequence: a moveit_msgs/MotionSequenceRequest.
    """
    items = sequence["items"]
    if not 1 <= len(items) <= MAX_ITEMS:
        raise _invalid(f"items has {len(items)} entries; 1 to {MAX_ITEMS} are allowed")
    for index, item in enumerate(items):
        if item["blend_radius"] != 0.0:
            raise _invalid(
                f"items[{index}].blend_radius must be 0 m, not {item['blend_radius']:g}: corners are not rounded, the"
                " arm comes to rest at the end of each item",
                index,
            )
        if index > 0 and item["req"]["start_state"]["joint_state"]["name"]:
            raise _invalid(
                f"items[{index}].req.start_state must be empty: the item begins where the one before ends", index
            )
    return [item["req"] for item in items]


def _invalid(message: str, index: int | None = None) -> Exception:
    details = {} if index is None else {"item": index}
    return refused(MoveItErrorCode.INVALID_MOTION_PLAN, message, **details)
