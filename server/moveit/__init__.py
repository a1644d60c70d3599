"""MoveIt's face: ROS messages on one side, planners and arm on the other."""
