"""Actions that move the arm: MoveIt's move_group actions, and ros2_control's FollowJointTrajectory."""
