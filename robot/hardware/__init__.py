"""Hardware interface of an arm: Feetech's servos on a serial port or emulated, and the ideal arm."""
