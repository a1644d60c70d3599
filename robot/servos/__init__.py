"""The servo bus: a serial port, packets, registers, and what the servos report."""
