"""Feetech's serial bus servos: port, packets, registers, survey, and switching torque on and off."""
