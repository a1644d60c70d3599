"""Arm process: state machine, guards and order sequences of one arm, in a control loop of 100 Hz.

PortLost passes through every layer to the loop, which opens the hardware again.
"""
