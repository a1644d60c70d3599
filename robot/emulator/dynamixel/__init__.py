"""Emulated Dynamixel servos of the X series, inside the arm process."""
