"""The built-in arm: URDF, SRDF, joint limits and convex hulls of the SO-101 follower, as package data."""
