"""Where the robot and its surroundings are, and what touches what: pinocchio and coal."""
