"""Dynamixel servos of the X series (protocol 2.0) as hardware of the controller."""
