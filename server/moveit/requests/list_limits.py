"""Limits of the lists in requests of MoveIt's clients; no client's own lists come near."""

from __future__ import annotations

from server.graph.list_limits import ListLimits
from server.moveit.requests.planning_problems import MAX_ITEMS, MAX_LINKS
from server.moveit.trajectories import MAX_POINTS

# Of all motions of a sequence together: for each item of the longest one, two constraints on poses and ten on joints.
MAX_POSE_CONSTRAINTS = 2 * MAX_ITEMS
MAX_JOINT_CONSTRAINTS = 10 * MAX_ITEMS

# Of attached objects, which come with every request of some clients. A tool's mesh for collisions has some thousands.
MAX_ATTACHED_TRIANGLES = 10_000

# Longer paths are planned in parts; this one takes the planners a second.
MAX_WAYPOINTS = 1_000

_POSE_LISTS = (
    "Constraints.position_constraints",
    "Constraints.orientation_constraints",
    "Constraints.visibility_constraints",
    "BoundingVolume.primitives",
    "BoundingVolume.primitive_poses",
    "BoundingVolume.meshes",
    "BoundingVolume.mesh_poses",
    "MotionPlanRequest.goal_constraints",
    "PositionIKRequest.pose_stamped_vector",
)

PLANNING_LIMITS = ListLimits(
    {
        **{f"moveit_msgs/msg/{name}": MAX_POSE_CONSTRAINTS for name in _POSE_LISTS},
        "moveit_msgs/msg/Constraints.joint_constraints": MAX_JOINT_CONSTRAINTS,
        "moveit_msgs/msg/MotionSequenceRequest.items": MAX_ITEMS,
        "moveit_msgs/msg/PositionIKRequest.ik_link_names": MAX_LINKS,
        "moveit_msgs/srv/GetCartesianPath_Request.waypoints": MAX_WAYPOINTS,
        "moveit_msgs/srv/GetPositionFK_Request.fk_link_names": MAX_LINKS,
        "shape_msgs/msg/Mesh.triangles": MAX_ATTACHED_TRIANGLES,
        "shape_msgs/msg/Mesh.vertices": 3 * MAX_ATTACHED_TRIANGLES,
    }
)

# Positions, velocities and accelerations of eight joints.
TRAJECTORY_LIMITS = ListLimits({"trajectory_msgs/msg/JointTrajectory.points": MAX_POINTS}, 24 * MAX_POINTS)
