"""MoveIt's planning scene: what stands around the robot and what it holds, as its clients say and ask it."""
