"""Commissioning of an arm: scan, calibration, diagnosis, and experiments on the servos."""
