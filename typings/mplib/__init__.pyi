# The part of MPlib 0.2.1 that benchmarks/mplib_peer.py uses.
from collections.abc import Sequence
from typing import Any

from mplib.collision_detection import fcl

class Pose:
    def __init__(self, p: Any = ..., q: Any = ...) -> None: ...

class PlanningWorld:
    def add_object(self, fcl_obj: fcl.FCLObject) -> None: ...
    def attach_object(
        self, name: str, p_geom: fcl.CollisionGeometry, art_name: str, link_id: int, pose: Pose, touch_links: list[str]
    ) -> None: ...

class AllowedCollisionMatrix:
    def set_entry(self, name1: str, name2: str, allowed: bool) -> None: ...

class ArticulatedModel:
    def get_name(self) -> str: ...

class Planner:
    planning_world: PlanningWorld
    acm: AllowedCollisionMatrix
    robot: ArticulatedModel
    user_joint_names: list[str]
    link_name_2_idx: dict[str, int]
    def __init__(
        self,
        urdf: str,
        move_group: str,
        *,
        srdf: str,
        use_convex: bool,
        joint_vel_limits: Sequence[float],
        joint_acc_limits: Sequence[float],
    ) -> None: ...
    def plan_qpos(
        self, goal_qposes: list[Any], current_qpos: Any, *, time_step: float, rrt_range: float, planning_time: float
    ) -> dict[str, Any]: ...
