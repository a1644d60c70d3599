"""Interface of MoveIt: ROS messages on one side, execution, planners and arm on the other."""
