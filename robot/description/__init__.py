"""Robot descriptions: URDF and SRDF, limits and kinematics, and the built-in arms as package data."""
