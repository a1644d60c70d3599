"""Write ``armbridge_client/messages.py`` from the server's type tables, in the repository of the server.

The client knows the types below and the types of their fields. ``ONLY`` restricts large types to the fields that the
client uses: the server completes messages with defaults, and the client ignores other fields.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from protocol.registry import Field, MessageType, Registry
from server.features.clients import type_hashes

TARGET = Path(__file__).parent / "armbridge_client" / "messages.py"

MESSAGES = (
    "armbridge_msgs/ActionChunk",
    "armbridge_msgs/ActionChunkAnswer",
    "armbridge_msgs/TeachState",
    "armbridge_msgs/TeleopState",
    "control_msgs/JointJog",
    "control_msgs/JointTrajectoryControllerState",
    "diagnostic_msgs/DiagnosticStatus",
    "geometry_msgs/TwistStamped",
    "moveit_msgs/KinematicSolverInfo",
    "moveit_msgs/MoveItErrorCodes",
    "moveit_msgs/PlanningScene",
    "moveit_msgs/ServoStatus",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/JointState",
    "std_msgs/Bool",
    "std_msgs/Empty",
    "std_msgs/Float64",
    "std_msgs/String",
)
SERVICES = (
    "armbridge_msgs/BeginTeaching",
    "armbridge_msgs/CheckGoals",
    "armbridge_msgs/CheckMotion",
    "armbridge_msgs/DeleteMotion",
    "armbridge_msgs/DeleteScene",
    "armbridge_msgs/EndTeaching",
    "armbridge_msgs/ListMotions",
    "armbridge_msgs/ListScenes",
    "armbridge_msgs/LoadScene",
    "armbridge_msgs/MoveitGoal",
    "armbridge_msgs/RenameMotion",
    "armbridge_msgs/SaveScene",
    "armbridge_msgs/SetBody",
    "armbridge_msgs/SetBodyPose",
    "armbridge_msgs/SetSpeedLimit",
    "armbridge_msgs/StartEpisode",
    "armbridge_msgs/StartTeleop",
    "armbridge_msgs/StepSimulation",
    "armbridge_msgs/TrimMotion",
    "moveit_msgs/ApplyPlanningScene",
    "moveit_msgs/DeleteRobotStateFromWarehouse",
    "moveit_msgs/GetCartesianPath",
    "moveit_msgs/GetMotionPlan",
    "moveit_msgs/GetPlanningScene",
    "moveit_msgs/GetPositionFK",
    "moveit_msgs/SaveRobotStateToWarehouse",
    "rosapi_msgs/TopicsForType",
    "std_srvs/SetBool",
    "std_srvs/Trigger",
)
ACTIONS = (
    "armbridge_msgs/MoveitGoal",
    "armbridge_msgs/ReplayMotion",
    "control_msgs/GripperCommand",
    "moveit_msgs/ExecuteTrajectory",
)
ONLY = {
    "control_msgs/msg/JointTrajectoryControllerState": ("joint_names", "reference"),
    "moveit_msgs/msg/AttachedCollisionObject": ("link_name", "object", "touch_links"),
    "moveit_msgs/msg/CollisionObject": (
        "header",
        "pose",
        "id",
        "primitives",
        "primitive_poses",
        "meshes",
        "mesh_poses",
        "operation",
    ),
    "moveit_msgs/msg/Constraints": ("joint_constraints", "position_constraints", "orientation_constraints"),
    "moveit_msgs/msg/PlanningScene": ("robot_state", "allowed_collision_matrix", "world", "is_diff"),
    "moveit_msgs/msg/PlanningSceneWorld": ("collision_objects",),
    "moveit_msgs/msg/MotionPlanRequest": (
        "goal_constraints",
        "group_name",
        "max_velocity_scaling_factor",
        "max_acceleration_scaling_factor",
    ),
    "moveit_msgs/srv/GetCartesianPath_Request": (
        "header",
        "group_name",
        "link_name",
        "waypoints",
        "max_step",
        "avoid_collisions",
        "max_velocity_scaling_factor",
        "max_acceleration_scaling_factor",
    ),
    "moveit_msgs/srv/GetCartesianPath_Response": ("solution", "fraction", "error_code"),
    "moveit_msgs/srv/GetPositionFK_Request": ("header", "fk_link_names", "robot_state"),
    "moveit_msgs/srv/SaveRobotStateToWarehouse_Request": ("name",),
    "moveit_msgs/msg/MotionPlanResponse": ("trajectory", "error_code"),
    "moveit_msgs/msg/RobotState": ("joint_state", "attached_collision_objects", "is_diff"),
    "moveit_msgs/msg/RobotTrajectory": ("joint_trajectory",),
    "shape_msgs/msg/SolidPrimitive": ("type", "dimensions"),
}
PRIMITIVES = {"bool": "bool", "float32": "float", "float64": "float", "string": "str", "wstring": "str"}

HEAD = '''"""Message types as dataclasses, made by generate_messages.py from the server's type tables: do not edit.

Names of services and actions have the endings Request, Response, Goal, Result and Feedback.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

from armbridge_client.wire import Action, Message, Service
'''


class Generator:
    """Classes for message types, each behind the classes of its fields."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._classes: dict[str, str] = {}

    def text(self) -> str:
        """Return the module's text before it is formatted."""
        for name in MESSAGES:
            self._add(self._registry.message(name))
        for name in SERVICES:
            service = self._registry.service(name)
            self._add(service.request, f"Service[{self._add(service.response)}]")
        for name in ACTIONS:
            action = self._registry.action(name)
            result, feedback = self._add(action.result), self._add(action.feedback)
            self._add(action.goal, f"Action[{result}, {feedback}]")
        hashes = type_hashes(self._registry)
        roots = [self._registry.canonical(name) for name in MESSAGES]
        roots += [self._registry.canonical(name, "srv") for name in SERVICES]
        roots += [self._registry.canonical(name, "action") for name in ACTIONS]
        table = "\n".join(f"    {name!r}: {hashes[name]!r}," for name in roots)
        about = "# Hashes of the types and of all types in them, as the server lists them."
        return HEAD + "\n\n".join(self._classes.values()) + f"\n{about}\nTYPES = {{\n{table}\n}}\n"

    def _add(self, message: MessageType, base: str = "Message") -> str:
        name = class_name(message.name)
        if message.name in self._classes:
            return name
        only = ONLY.get(message.name)
        fields = [each for each in message.fields if only is None or each.name in only]
        lines = [self._field(each) for each in fields]
        type_name = message.name.rpartition("_")[0] if base != "Message" else message.name
        head = [
            "@dataclass(repr=False)",
            f"class {name}({base}):",
            f'    """{message.name}."""',
            "",
            f'    TYPE: ClassVar[str] = "{type_name}"',
        ]
        self._classes[message.name] = "\n".join((*head, *lines)) + "\n"
        if name == "MoveItErrorCodes":
            codes = [f"    {each.name} = {each.value}" for each in message.constants]
            self._classes["codes"] = "\n".join(
                ("class MoveItErrorCode(IntEnum):", '    """Values of moveit_msgs/MoveItErrorCodes."""', "", *codes, "")
            )
        return name

    def _field(self, row: Field) -> str:
        declared = PRIMITIVES.get(row.base, "int") if row.primitive else self._add(self._registry.message(row.base))
        if row.array is not None:
            if row.base in ("uint8", "byte"):
                return f'    {row.name}: bytes = b""'
            return f"    {row.name}: list[{declared}] = field(default_factory=list[{declared}])"
        if not row.primitive:
            return f"    {row.name}: {declared} = field(default_factory={declared})"
        zero = {"bool": False, "str": "", "float": 0.0}.get(declared, 0)
        value = zero if row.default is None else row.default
        return f"    {row.name}: {declared} = {value!r}"


def class_name(canonical: str) -> str:
    """Return the class of a type: ``GetMotionPlanRequest`` for ``moveit_msgs/srv/GetMotionPlan_Request``."""
    return canonical.rpartition("/")[2].replace("_", "")


def generated() -> str:
    """Return the module's text."""
    command = ["ruff", "format", "--line-length", "120", "--stdin-filename", str(TARGET), "-"]
    text = Generator(Registry.load()).text()
    return subprocess.run(  # noqa: S603 - its own interpreter
        [sys.executable, "-m", *command], input=text, capture_output=True, text=True, check=True, timeout=60
    ).stdout


if __name__ == "__main__":
    TARGET.write_text(generated())
