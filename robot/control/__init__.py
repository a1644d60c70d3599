"""Arm process: state machine, guards and order sequences of one arm, in a control loop of 100 Hz."""
