"""Robot descriptions: URDF and SRDF, limits and kinematics, and the SO-101 follower as package data."""
