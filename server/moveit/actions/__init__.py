"""Actions that move the arm: those of MoveIt's move_group, and ros2_control's FollowJointTrajectory."""
