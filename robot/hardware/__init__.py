"""Actuators of an arm behind one interface: Feetech's servos on a serial port or emulated, and the ideal arm."""
