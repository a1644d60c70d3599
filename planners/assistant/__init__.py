"""Assistant that makes a robot folder of a URDF: convex parts, pairs that never touch, a draft SRDF and robot.toml."""
