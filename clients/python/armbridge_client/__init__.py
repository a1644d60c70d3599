"""Client of an armbridge server: moves robot arms, and reports why not.

from armbridge_client import connect

with connect("ws://127.0.0.1:9090") as arm:
arm.move_to(x=0.25, y=0.0, z=0.12)
"""

from armbridge_client.arm import Arm, Gripper, Plan, connect
from armbridge_client.async_arm import AsyncArm, connect_async
from armbridge_client.async_gripper import AsyncGripper, Grip
from armbridge_client.connection import ServerInfo, after_stop
from armbridge_client.errors import (
    ArmError,
    ConnectError,
    ConnectionLost,
    ControlledByOther,
    DeadlineExceeded,
    GoalRefused,
    NotArmbridge,
    NotAuthenticated,
    NotPermitted,
    RequestRefused,
    ServerUnreachable,
    WrongVersion,
)
from armbridge_client.interface import ArmInfo
from armbridge_client.motion import AsyncPlan, Motion
from armbridge_client.targets import State, Target, WaitingGoal, pose

__all__ = [
    "Arm",
    "ArmError",
    "ArmInfo",
    "AsyncArm",
    "AsyncGripper",
    "AsyncPlan",
    "ConnectError",
    "ConnectionLost",
    "ControlledByOther",
    "DeadlineExceeded",
    "GoalRefused",
    "Grip",
    "Gripper",
    "Motion",
    "NotArmbridge",
    "NotAuthenticated",
    "NotPermitted",
    "Plan",
    "RequestRefused",
    "ServerInfo",
    "ServerUnreachable",
    "State",
    "Target",
    "WaitingGoal",
    "WrongVersion",
    "after_stop",
    "connect",
    "connect_async",
    "pose",
]
