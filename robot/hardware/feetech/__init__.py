"""Feetech's serial bus servos: port, packets, registers, and how they are surveyed, switched on and relaxed."""
