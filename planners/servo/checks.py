"""What is refused of a question for velocities."""

from __future__ import annotations

import math
from collections.abc import Iterator

from planners.checks import check_group, check_start
from planners.ik.goal_checks import invalid_goal
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.servo.question import JointVelocities, ServoQuestion, TipTarget, TipTwist
from robot.description.model import RobotModel

# The tip's position has so many directions; an arm with fewer joints cannot be steered by its tip.
POSITION_DIRECTIONS = 3

# Who asks more rarely does not steer.
MAX_PERIOD_S = 0.1

# A quaternion whose length is further from 1 is none.
UNIT_TOLERANCE = 1e-3


def check_servo_question(robot: RobotModel, question: ServoQuestion) -> PlanningFailure | None:
    """Names and numbers of a question."""
    return (
        check_group(robot, question.group)
        or next(_link_flaws(robot, question), None)
        or check_start(robot, question.positions_rad)
        or next(_command_flaws(robot, question), None)
    )


def _link_flaws(robot: RobotModel, question: ServoQuestion) -> Iterator[PlanningFailure]:
    if question.link not in robot.links:
        yield PlanningFailure(
            MoveItErrorCode.INVALID_LINK_NAME,
            f"there is no link {question.link!r}; there are: {', '.join(robot.links)}",
            {"link": question.link},
        )
    joints = robot.groups[question.group].joints
    if not isinstance(question.command, JointVelocities) and len(joints) < POSITION_DIRECTIONS:
        yield PlanningFailure(
            MoveItErrorCode.INVALID_GROUP_NAME,
            f"group {question.group!r} has {len(joints)} joints; to steer a tip it takes {POSITION_DIRECTIONS}",
            {"group": question.group},
        )


def _command_flaws(robot: RobotModel, question: ServoQuestion) -> Iterator[PlanningFailure]:
    command = question.command
    match command:
        case JointVelocities():
            known = robot.groups[question.group].joints
            for name in command.velocity_rad_s:
                if name not in known:
                    yield invalid_goal(f"joint {name!r} is none of group {question.group!r}: {', '.join(known)}")
            values = list(command.velocity_rad_s.values())
        case TipTwist():
            values = [*command.linear_m_s, *command.angular_rad_s]
        case TipTarget():
            values = [*command.pose.position_m, *command.pose.orientation]
            if abs(math.hypot(*command.pose.orientation) - 1.0) > UNIT_TOLERANCE:
                yield invalid_goal(f"the target's orientation {command.pose.orientation} is no unit quaternion")
    if not 0.0 < question.period_s <= MAX_PERIOD_S:
        yield invalid_goal(f"the period must be above 0 and at most {MAX_PERIOD_S} s, not {question.period_s:g}")
    for value in (*values, *question.velocity_rad_s.values()):
        if not math.isfinite(value):
            yield invalid_goal(f"a command must be of finite numbers, not {value}")
