"""The arm process: the state machine, its guards and sequences, 100 times a second."""
