"""Inverse kinematics: from goals to configurations by placo, and from velocities of frames to joint velocities."""
