"""Geometry of the robot and its scene: kinematics and collision by pinocchio and coal."""
