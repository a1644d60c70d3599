"""What the messages on ``/moveit_goal_*`` ask for: pure translation into motions to plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from planners.goals import Goal, JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Pose
from robot.description.model import RobotModel
from server.moveit.motions import PlannedMotion, Positions
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import composed, read_pose

Message: TypeAlias = Mapping[str, Any]

# Pose of a frame in the root link, for positions of the joints [rad].
Resolve: TypeAlias = Callable[[str, Positions], Pose | PlanningFailure]


class GoalTranslator:
    """Reads goal messages for one robot.

    Args:
        robot: the arm.
        parameters: how goals are planned, and group, link, frame and tolerances of the goals.
        states: the named states.
        resolve: knows the frames.
        present: position of every movable joint now [rad], None while it is not known.

    Attributes:
        tip: the link that pose goals are for.
    """

    def __init__(
        self,
        robot: RobotModel,
        parameters: MoveItParameters,
        states: NamedStates,
        resolve: Resolve,
        present: Callable[[], Positions | None],
    ) -> None:
        self._parameters = parameters
        self._states = states
        self._resolve = resolve
        self._present = present
        self._group = robot.groups[parameters.group_name]
        self.tip = parameters.end_effector_link or self._group.tip_link

    def named(self, message: Message) -> PlannedMotion | PlanningFailure:
        """A named state of the group, from a std_msgs/String; case and blanks do not matter."""
        found = self._states.find(message["data"])
        if found is None:
            names = self._states.names
            text = f"there is no named target {message['data']!r}; known are: {', '.join(names) or 'none'}"
            nearest = self._states.nearest_name(message["data"])
            return _invalid(text, known=names, **({} if nearest is None else {"nearest_name": nearest}))
        name, positions_rad = found
        goal_rad = {joint: value for joint, value in positions_rad.items() if joint in self._group.joints}
        if not goal_rad:
            return _invalid(f"the named target {name!r} has no joint of group {self._group.name}", name=name)
        return self._motion(lambda _start_rad: JointGoal(goal_rad, self._parameters.joint_tolerance))

    def joints(self, message: Message) -> PlannedMotion | PlanningFailure:
        """Joint positions, from a sensor_msgs/JointState; joints that are not named keep their position."""
        names, positions = message["name"], message["position"]
        if len(names) != len(positions):
            return _invalid(f"name has {len(names)} entries and position {len(positions)}; they must be as many")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            return _invalid(f"the joint {repeated[0]} is named more than once")
        known = {name: value for name, value in zip(names, positions, strict=True) if name in self._group.joints}
        if not known:
            return _invalid(
                f"no joint of group {self._group.name} is named; it has {', '.join(self._group.joints)}",
                known=list(self._group.joints),
            )
        for name, value in known.items():
            if not math.isfinite(value):
                return _invalid(f"joint {name}: position must be a finite number, not {value}", joint=name)
        ignored = [name for name in names if name not in known]
        warning = f"ignored joints that are not in group {self._group.name}: {', '.join(ignored)}"
        goal = JointGoal(known, self._parameters.joint_tolerance)
        return self._motion(lambda _start_rad: goal, (warning,) if ignored else ())

    def pose(self, message: Message) -> PlannedMotion | PlanningFailure:
        """The position of a geometry_msgs/PoseStamped; five joints cannot choose an orientation as well.

        A frame that moves with the arm is taken where it is when the goal's turn comes.
        """
        frame = self._frame(message)
        point = message["pose"]["position"]
        for axis in "xyz":
            if not math.isfinite(point[axis]):
                return _invalid(f"pose.position.{axis} must be a finite number, not {point[axis]}")
        pose = Pose((float(point["x"]), float(point["y"]), float(point["z"])))

        def goal(start_rad: Positions) -> Goal | PlanningFailure:
            placed = self._resolve(frame, start_rad)
            if isinstance(placed, PlanningFailure):
                return placed
            return PositionGoal(self.tip, composed(placed, pose).position_m, self._parameters.position_tolerance)

        # A frame that is not known is told at once, not when the goal's turn comes.
        present_rad = self._present()
        refusal = None if present_rad is None else self._resolve(frame, present_rad)
        return refusal if isinstance(refusal, PlanningFailure) else self._motion(goal)

    def pose_in_root(self, message: Message, positions_rad: Positions) -> Pose | PlanningFailure:
        """The whole pose of a geometry_msgs/PoseStamped in the root link, for positions of the joints [rad]."""
        pose = read_pose(message["pose"], "pose")
        if isinstance(pose, PlanningFailure):
            return pose
        placed = self._resolve(self._frame(message), positions_rad)
        return placed if isinstance(placed, PlanningFailure) else composed(placed, pose)

    def _frame(self, message: Message) -> str:
        frame: str = message["header"]["frame_id"] or self._parameters.planning_frame
        return frame

    def _motion(
        self, goal: Callable[[Positions], Goal | PlanningFailure], warnings: tuple[str, ...] = ()
    ) -> PlannedMotion:
        def problem(start_rad: Positions) -> PlanningProblem | PlanningFailure:
            wanted = goal(start_rad)
            return wanted if isinstance(wanted, PlanningFailure) else self._problem(wanted, start_rad)

        return PlannedMotion((problem,), warnings=warnings)

    def _problem(self, goal: Goal, start_rad: Positions) -> PlanningProblem:
        parameters = self._parameters
        return PlanningProblem(
            group=parameters.group_name,
            start_rad=start_rad,
            goal=goal,
            velocity_scaling=parameters.max_velocity_scaling,
            acceleration_scaling=parameters.max_acceleration_scaling,
            allowed_time_s=parameters.allowed_planning_time,
            attempts=parameters.num_planning_attempts,
            planner_id=parameters.planner_id,
            optimization_time_s=parameters.optimization_time,
        )


def _invalid(message: str, **details: Any) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, details)
