"""Geometry of the robot and its surroundings: kinematics and collision by pinocchio and coal."""
